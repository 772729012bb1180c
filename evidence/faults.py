"""The fault matrix: what goes wrong x when -> how long the torque outlives it, what was said, what was kept.

    python -m evidence faults --out docs/evidence/faults.md        # what `make faults` does
"""

import re
from pathlib import Path

import numpy as np

from evidence.fault_list import FAULTS
from evidence.frame import Lines, new_folder, program, table
from evidence.kept import kept
from evidence.registry import Evidence
from tests.support.fault_bench import MOMENTS, PEAK_NM, FaultBench, Outcome

TARGET_MS = 110.0


def strike(name: str, moment: str, folder: Path) -> Outcome:
    """One cell."""
    from daq.runs import mcap_run

    watch = mcap_run.WATCH_EVERY_S
    try:
        return FaultBench(FAULTS[name], moment).run(folder)
    finally:
        mcap_run.WATCH_EVERY_S = watch


def page(only: str = "") -> Lines:
    names = [name for name in FAULTS if only in name]
    with new_folder() as folder:

        @kept
        def cell(name: str, moment: str) -> Outcome:
            return strike(name, moment, folder)

        cells = {(name, moment): cell(name, moment) for name in names for moment in MOMENTS}
    zero = np.array([cell.zero_ms for cell in cells.values()])
    late = [key for key, cell in cells.items() if cell.zero_ms > TARGET_MS]
    yield from [
        "# Faults while a leg is driven",
        f"{len(cells)} recordings of the emulated leg on virtual time, each with one fault at "
        f"one moment. Torque up to {PEAK_NM:g} N m, a watchdog of 100 ms, default `[limits]`. Time counts from the "
        "fault, or from the first torque if that is later, to the last torque of the drive's current loop. The current "
        "follows within a millisecond.",
        f"- Median {np.median(zero):.0f} ms, worst {zero.max():.0f} ms; {len(cells) - len(late)} of {len(cells)} cells "
        f"within {TARGET_MS:g} ms.",
        "- `arming`: as Arm goes out. `ramp`: 60 ms into the plan. `driving`: 0.85 s into it, the leg in full swing. "
        "`stopping`: 20 ms after a SIGTERM, in the ramp.",
        "- The run file is looked at every 20 ms on the real clock; here at every message. Disks that hang are another "
        "study: tests/daq/recording/test_disk.py, on the real clock."]
    if late:
        yield ("Beyond the target: " + "; ".join(f"{name} ({moment}, {cells[name, moment].zero_ms:.0f} ms)"
                                                 for name, moment in late)
               + ". A wrong angle sensor shows only after its joint has turned by the band of its check.")
    yield "## Time to zero torque [ms]"
    yield table(f"fault | {' | '.join(MOMENTS)}", (
        (name, *(f"{cells[name, moment].zero_ms:.0f}" for moment in MOMENTS)) for name in names))
    yield "## What was said, and what the file holds, at `driving`"
    yield table("fault | said | file", (
        (name, re.sub(r"\S*/(\w+\.mcap)", r"\1", cells[name, "driving"].said), cells[name, "driving"].kept)
        for name in names))


EVIDENCE = Evidence(
    "Every fault at every moment on virtual time: how long the torque outlives it", "make faults",
    "faults.md", 10, f"zero torque within {TARGET_MS:g} ms",
    (r"Median \d+ ms, worst \d+ ms; \d+ of \d+ cells within \d+ ms",))
main = program(page)
