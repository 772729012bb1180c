"""What a person is told when something given to the program cannot be used."""

from __future__ import annotations


class InputError(Exception):
    """Bad input: one line naming the file, the place and the remedy. The command line exits with 2."""

    def __init__(self, where: str, what: str, remedy: str = "") -> None:
        self.where, self.what, self.remedy = where, what, remedy
        line = f"{where}: {what}" if where else what
        super().__init__(f"{line}; {remedy}" if remedy else line)


class WorkError(Exception):
    """The work could not be done on this data or device (a limit tripped, no convergence). Exits with 1."""
