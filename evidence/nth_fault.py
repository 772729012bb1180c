"""Faults by counting: the Nth write, flush, sync, read or allocation of a 2 s recording fails, on all four drives.

    python -m evidence nth-fault --out docs/evidence/nth-fault.md     # what `make nth-fault` does
    python -m evidence nth-fault --every 200 --drives legid           # every 200th read and allocation
"""

from collections.abc import Sequence

from evidence.frame import Lines, new_folder, program, table, tell
from evidence.kept import kept
from evidence.registry import Evidence
from tests.support.nth_fault import DRIVES, FAULTS, SECONDS, Ended, strike

DISK = ("write", "flush", "sync")
TARGET_MS = 110.0
EVIDENCE = Evidence(
    "The Nth write, flush, sync, read or allocation of a recording fails", "make nth-fault", "nth-fault.md",
    180, f"zero torque within {TARGET_MS:g} ms, file readable to its last flush, cause named",
    (r"[\d,]+ faults", r"worst time to zero torque [\d.]+ ms", r"\d+ not named, \d+ not readable"))


@kept
def struck(drive: str, kind: str, every: int) -> tuple[Sequence[Ended], int]:
    """How the operations of one kind ended that failed, and how many there are."""
    with new_folder() as folder:
        found, counts = strike(drive, lambda of, n: of == kind and n % every == 0, folder)
    return found, counts[kind]


def page(every: int = 1, drives: Sequence[str] = DRIVES) -> Lines:
    done = {(drive, kind): struck(drive, kind, 1 if kind in DISK else every) for drive in drives for kind in FAULTS}
    found = [one for ended, _ in done.values() for one in ended]
    bad = [one for one in found if not (one.named and one.readable and one.zero_ms <= TARGET_MS)]
    tell(*bad)
    yield from [
        "# Faults by counting",
        f"A recording of {SECONDS:g} s on virtual time, its "
        "lead-in and end included, is forked at one operation after the other. In the copy that operation fails, and "
        "the copy records to its end.",
        f"- {len(found):,} faults: worst time to zero torque {max(one.zero_ms for one in found):.2f} ms; "
        f"{sum(not one.named for one in found)} not named, {sum(not one.readable for one in found)} not "
        "readable to the last flush.",
        "- Every write, flush and sync of the file fails once. " + (
            "So does every read and allocation." if every == 1 else
            f"Of the reads and allocations (a message that finds no memory) every {every}th does."),
        "- `write`: no space on the disk. `flush`, `sync`: an input/output error. `read of the link`: the adapter is "
        "gone for good. `read of the IMU`: one I2C transfer without an acknowledge, which the driver may repeat.",
        "- A fault is named where the message holds its cause, or where the recording goes on because a read was "
        "repeated."]
    yield table("drive | operation | how many | failed | went on | worst time to zero torque [ms] | not named | "
                "not readable", (
        f"{drive} | {kind} | {count} | {len(mine)} | {sum(not one.said for one in mine)} | "
        f"{max((one.zero_ms for one in mine), default=0.0):.2f} | {sum(not one.named for one in mine)} | "
        f"{sum(not one.readable for one in mine)}" for (drive, kind), (mine, count) in done.items()))
    return len(bad)


main = program(page)
