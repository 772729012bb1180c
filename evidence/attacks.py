"""`make attacks`: files made to hang, to fill the memory, to crash a reader or to lead elsewhere, through the commands
that read them.
"""

from evidence.frame import Lines, new_folder, program, table
from evidence.registry import Evidence
from tests.support.hostile_files import ATTACKS
from tests.support.measured_command import measured

EVIDENCE = Evidence(
    "Files made to do harm, through the commands that read them", "make attacks", "attacks.md", 4,
    "one line, below 10 s and 1 GB", (r"\d+ of \d+ end in one line", r"slowest [\d.]+ s", r"most \d+ MB"))


def page() -> Lines:
    rows, good, slowest, most = [], 0, 0.0, 0.0
    for name, (make, command) in ATTACKS.items():
        with new_folder() as folder:
            file = make(folder)
            found = measured([file if word == "FILE" else word for word in command], folder)
        said = ["", *(found.out + found.error).strip().splitlines()][-1]
        good += found.status in (0, 1, 2) and "internal error" not in said
        slowest, most = max(slowest, found.seconds), max(most, found.megabytes)
        rows.append((name, command[0], found.status, f"{found.seconds:.1f}", f"{found.megabytes:.0f}", said[:160]))
    yield from [
        "# Files made to do harm",
        f"{len(rows)} files, each through one command. Time is that of the processor and memory the "
        "largest process, the child that reads the file included; both are at most so large.",
        f"- {good} of {len(rows)} end in one line or do no harm; slowest {slowest:.1f} s, most {most:.0f} MB."]
    yield table("file | command | status | time [s] | memory [MB] | last line", rows)
    return len(rows) - good


main = program(page)
