"""Kinds of clock faults, in telemetry, probes or both, at four moments of a recording: what is said, what is used.

    python -m evidence clock-faults --out docs/evidence/clock-faults.md   # what `make clock-faults` does
"""

from collections.abc import Sequence
from typing import NamedTuple

from daq import InputError
from daq.runs import read_run
from daq.timing import decode, recorded_rig
from evidence.frame import Lines, new_folder, program, table
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.reports import list_runs
from tests.support.clock_bench import KINDS, MOMENTS_S, SECONDS, WHICH, strike

EVIDENCE = Evidence(
    "Steps, wraps, freezes and rate changes of the controller's clock", "make clock-faults", "clock-faults.md",
    15, "none unsaid", (r"\d+ of \d+ faults are said by all three", r"\d+ unsaid"))


class Cell(NamedTuple):
    """One fault at one moment."""

    kind: str
    which: str
    moment: str
    events: int
    """While recording."""
    flag: str
    """Of the file; empty for none."""
    listed: bool
    """`legid runs` says it."""
    used: float
    """Share of the samples that a fit gets."""
    ended: str
    touched: int
    """Messages whose tick the fault altered."""


def measure(kind: str, which: str, moment: str) -> Cell:
    """Record and read one."""
    with new_folder() as folder:
        path, said, touched = strike(kind, which, moment, folder)
        raw = read_run(path)
        events = sum(note.kind == "clock" for note in raw.events)
        (line,) = list_runs(path)
        telemetry = raw.streams["/leg/telemetry"]
        try:
            found = decode(raw, recorded_rig(raw))
        except InputError as error:
            return Cell(kind, which, moment, events, str(error), bool(line.flaws), 0.0, said,
                        touched)
        flag = " ".join(str(one) for one in found.flags if one.kind == "clock")
        return Cell(kind, which, moment, events, flag, any("clock" in flaw for flaw in line.flaws),
                    found.channels[0].time_s.size / telemetry.size, said, touched)


def page(moments: Sequence[str] = tuple(MOMENTS_S)) -> Lines:
    cell = kept(measure)
    cells = [cell(kind, which, moment) for kind in KINDS for which in WHICH for moment in moments]
    faults = [one for one in cells if one.touched]
    unsaid = [one for one in faults if not (one.events and one.flag and one.listed)]
    none = [one for one in cells if not one.touched]
    yield from [
        "# Faults of the controller's clock",
        f"{len(cells)} recordings of {SECONDS:g} s of the emulated leg with legid's own "
        "controller on virtual time. From one moment on the ticks of its telemetry, of its answers to clock probes, or "
        "of both are off. The bought drives (moteus, ODrive, Dynamixel) keep no time: the host stamps their samples, "
        "so these faults do not exist there.",
        f"- {len(faults) - len(unsaid)} of {len(faults)} faults are said by all three: an event while recording, a "
        f"warning of `legid info` and `legid fit`, and `legid runs`; {len(unsaid)} unsaid.",
        "- `used`: share of the samples that a fit gets. The others are set aside, with their number in the warning.",
        f"- Unsaid: {'; '.join(map(_name, unsaid)) or 'none'}.",
        f"- No fault: {'; '.join(map(_name, none)) or 'none'}. These freezes lie between two probes, so the recording "
        "holds no tick that is off, and nothing is to be said."]
    yield table("fault | ticks of | at | events | runs | used | what the file says", (
        f"{c.kind} | {c.which} | {c.moment} | {c.events} | {'yes' if c.listed else 'no'} | {c.used:.0%} | "
        + (c.flag.removeprefix("the controller's clock failed: ") or "nothing") for c in cells))
    return len(unsaid)


def _name(cell: Cell) -> str:
    return f"{cell.kind} ({cell.which}, {cell.moment})"
main = program(page)
