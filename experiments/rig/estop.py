"""Confirmations by a person before a motor moves: the hard-wired emergency stop, and each recording of a loop."""

from __future__ import annotations

import sys
from collections.abc import Callable

from daq import InputError, Rig, WorkError

FLAG = "--estop-at-hand"
QUESTION = "This drive has no E-stop input. Is a hard-wired emergency stop, which takes its supply away, tested and " \
           "within reach? [y/N] "
MOVES = "The leg will move: hardwired emergency stop at hand, nobody within its reach (docs/safety.md)."


def confirm_estop(rig: Rig, at_hand: bool, ask: Callable[[str], str] | None = None) -> None:
    """Confirm the E-stop, unless the rig has legid's firmware or a person says that it is there (`at_hand`, or now).

    Raises `WorkError` where it is not, `InputError` where nobody can be asked.
    """
    device = rig.devices.controller
    if device is None or device.kind == "legid" or at_hand:
        return
    if ask is None and not sys.stdin.isatty():
        raise InputError(FLAG, "nobody is there to say that a hard-wired emergency stop is at hand",
                         f"give {FLAG} where it is, docs/safety.md says which")
    if not _agreed(QUESTION, ask):
        raise WorkError("no hard-wired emergency stop at hand, so nothing was started; docs/safety.md says which")


def confirm_motion(what: str, yes: bool = False, ask: Callable[[str], str] | None = None) -> bool:
    """Whether a person agrees now that the leg moves by the plan `what`; with `yes` nobody is asked.

    Raises `InputError` where nobody can be asked.
    """
    print(MOVES, flush=True)
    if yes:
        return True
    if ask is None and not sys.stdin.isatty():
        raise InputError("--yes", "nobody is there to confirm each recording",
                         "give --yes where the leg may move unattended, or run it at a terminal")
    return _agreed(f"Record {what}? [y/N] ", ask)


def _agreed(question: str, ask: Callable[[str], str] | None) -> bool:
    try:
        return (ask or input)(question).strip().lower() in ("y", "yes")
    except EOFError:
        return False
