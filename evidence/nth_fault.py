"""Faults by counting: the Nth write, flush, sync, read or allocation of a 2 s recording fails, on all four drives.

    python -m evidence nth-fault --out docs/evidence/nth-fault.md     # what `make nth-fault` does
    python -m evidence nth-fault --every 200 --drives legid           # every 200th read and allocation

A study that was stopped goes on with the next kind of operation of a drive.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from evidence.kept import kept
from evidence.registry import Evidence
from tests.support.nth_fault import DRIVES, FAULTS, SECONDS, Ended, strike

DISK = ("write", "flush", "sync")
TARGET_MS = 110.0
EVIDENCE = (
    Evidence("The Nth write, flush, sync, read or allocation of a recording fails", "make nth-fault", "nth-fault.md",
             180, f"zero torque within {TARGET_MS:g} ms, file readable to its last flush, cause named",
             (r"[\d,]+ faults", r"worst time to zero torque [\d.]+ ms", r"\d+ not named, \d+ not readable")),)


def page(found: Sequence[Ended], counts: dict[str, Counter[str]], every: int) -> str:
    """The dated page."""
    worst = max(one.zero_ms for one in found)
    unnamed, unreadable = sum(not one.named for one in found), sum(not one.readable for one in found)
    lines = [
        f"# Faults by counting, {datetime.now(UTC):%Y-%m-%d}", "",
        f"By `make nth-fault{f' EVERY={every}' * (every > 1)}`: a recording of {SECONDS:g} s on virtual time, its "
        "lead-in and end included, is forked at one operation after the other. In the copy that operation fails, and "
        "the copy records to its end.", "",
        f"- {len(found):,} faults: worst time to zero torque {worst:.2f} ms; {unnamed} not named, {unreadable} not "
        "readable to the last flush.",
        "- Every write, flush and sync of the file fails once. " + (
            "So does every read and allocation." if every == 1 else
            f"Of the reads and allocations (a message that finds no memory) every {every}th does."),
        "- `write`: no space on the disk. `flush`, `sync`: an input/output error. `read of the link`: the adapter is "
        "gone for good. `read of the IMU`: one I2C transfer without an acknowledge, which the driver may repeat.",
        "- A fault is named where the message holds its cause, or where the recording goes on because a read was "
        "repeated.", "",
        "| drive | operation | how many | failed | went on | worst time to zero torque [ms] | not named | "
        "not readable |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |"]
    for drive, of in counts.items():
        for kind in FAULTS:
            mine = [one for one in found if one.drive == drive and one.kind == kind]
            cells = (drive, kind, of[kind], len(mine), sum(not one.said for one in mine),
                     f"{max((one.zero_ms for one in mine), default=0.0):.2f}", sum(not one.named for one in mine),
                     sum(not one.readable for one in mine))
            lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


@kept
def struck(drive: str, kind: str, every: int) -> tuple[Sequence[Ended], int]:
    """How the operations of one kind ended that failed, and how many there are."""
    with tempfile.TemporaryDirectory() as folder:
        found, counts = strike(drive, lambda of, n: of == kind and n % every == 0, Path(folder))
    return found, counts[kind]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print or write; 1 where a fault was not named, a file not readable, or a torque lasted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", nargs="*", default=DRIVES, choices=DRIVES)
    parser.add_argument("--every", type=int, default=1, help="of the reads and allocations; of the others every one")
    parser.add_argument("--out", type=Path, help="the page to write; printed without it")
    args = parser.parse_args(arguments)
    found: list[Ended] = []
    counts: dict[str, Counter[str]] = {}
    for drive in args.drives:
        counts[drive] = Counter()
        for kind in FAULTS:
            ended, counts[drive][kind] = struck(drive, kind, 1 if kind in DISK else args.every)
            found += ended
            print(f"{drive}, {kind}: {len(ended)}", file=sys.stderr, flush=True)
    text = page(found, counts, args.every)
    args.out.write_text(text, encoding="utf-8") if args.out else print(text)
    bad = [one for one in found if not (one.named and one.readable and one.zero_ms <= TARGET_MS)]
    for one in bad:
        print(one)
    return int(bool(bad))
