"""`make changed-families`: is the change of one effect found on simulated legs that have ten small faults?

The servo's legs of MuJoCo, with `several_faults.TEN` always there. Four runs are the reference; in four more runs one
effect is added, or none. Called again it goes on where it stopped.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq import load_rig
from experiments.studies import machine
from experiments.workflows import find_change
from tests.evidence.blind.score import Rate
from tests.evidence.blind.servo import GEAR, MAKERS, record, write_case
from tests.evidence.blind.several_faults import NAMES, TEN, together
from tests.evidence.kept import kept
from tests.evidence.page_file import within, write_page
from tests.evidence.registry import Evidence
from tests.support.mujoco_leg import random_leg

SEED, RUNS, UNTOUCHED = 4042, 4, 5
"""... one case of so many has no change."""
STRENGTH = (0.3, 1.15)
"""Range of the added effect, in the servo family's ordinary strength."""
TWINS = {frozenset({"torque_offset", "asymmetric_friction"})}
"""No run tells these apart (docs/diagnosis.md)."""


class Outcome(NamedTuple):
    """One case."""

    effect: str
    """`none` where nothing was added."""
    strength: float
    verdict: str
    causes: tuple[str, ...]

    @property
    def hit(self) -> bool:
        return any(cause == self.effect or frozenset({cause, self.effect}) in TWINS for cause in self.causes)


def effect_of(number: int) -> str:
    """Case number's added effect: each in turn, and none in every UNTOUCHED-th case."""
    effects = [name for name in NAMES if name != "none"]
    return "none" if number % UNTOUCHED == 0 else effects[(number - 1 - number // UNTOUCHED) % len(effects)]


@kept
def outcome(number: int) -> Outcome:
    """Case `number`: its eight runs, the comparison."""
    rng, name = np.random.default_rng([SEED, number]), effect_of(number)
    small = [MAKERS[n](share * rng.uniform(0.7, 1.3)) for n, share in TEN.items()]
    strength = float(rng.uniform(*STRENGTH))
    before, now = together(small), together([*small, MAKERS[name](strength)])
    leg, dry = replace(random_leg(rng), coulomb=(0.0, 0.0)), rng.uniform(0.02, 0.08)
    runs = (record(leg, before if run < RUNS else now, dry, rng, run % RUNS, session_s=25.0 * (run % RUNS))
            for run in range(2 * RUNS))
    with tempfile.TemporaryDirectory() as place:
        write_case(name, number, Path(place), runs, rng, leg, f"[motor]\ngear_ratio = {GEAR}\n", [], dry)
        folder = Path(place) / f"{name}-{number}"
        files = [folder / f"r{k}.csv" for k in range(1, 2 * RUNS + 1)]
        found = find_change(files[RUNS:], files[:RUNS], load_rig(folder / "rig.toml")).change
    return Outcome(name, strength, found.verdict, tuple(dict.fromkeys(cause.effect for cause in found.causes)))


def page(cases: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    rows = list[Outcome]()
    for number in within(minutes, range(cases)):
        rows.append(outcome(number))
        print(number, rows[-1], flush=True)
    changed, same = ([r for r in rows if (r.effect == "none") == untouched] for untouched in (False, True))
    wrong = sum(bool(r.causes) and not r.hit for r in rows)
    more = sum(r.hit and len(r.causes) > 1 and r.verdict != "one_of" for r in changed)
    silent = sum(r.verdict == "no_change" for r in changed), sum(r.verdict == "no_change" for r in same)
    yield from [
        "# A change of one effect on legs with ten small faults", "",
        f"Made by `make changed-families MINUTES={minutes:g}` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, "
        f"{machine()}.", "",
        "Legs of MuJoCo under a position servo with ten small faults always there. Four runs of 20 s are the "
        f"reference. In four more runs one effect is added: {STRENGTH[0]:g} to {STRENGTH[1]:g} times the family's "
        "ordinary strength. `legid diagnose --against` compares them.", "",
        f"{len(rows)} of {cases} cases were measured.", "",
        "| | measured | wanted |", "| --- | --- | --- |",
        f"| the effect is in the answer | {Rate(sum(r.hit for r in changed), len(changed))} | 80 to 95 % by size |",
        f"| `no_change` with an added effect | {Rate(silent[0], len(changed))} | |",
        f"| together with a second name | {Rate(more, len(changed))} | |",
        f"| only wrong names | {Rate(wrong, len(rows))} | at most 3 % |",
        f"| untouched: `no_change` | {Rate(silent[1], len(same))} | 95 % |", "",
        "| added | strength | verdict | causes |", "| --- | ---: | --- | --- |"]
    for r in sorted(rows):
        yield f"| {r.effect} | {r.strength:.2f} | {r.verdict} | {', '.join(r.causes) or '-'} |"
    yield ""


EVIDENCE = (
    Evidence("Is the change of one effect found on legs with ten small faults?", "make changed-families",
             "changed-families.md", 25, "80 to 95 % by size; untouched 95 %",
             (r"(the effect is in the answer) \| ([^|]*\))", r"(untouched: `no_change`) \| ([^|]*\))")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, cases=(100, "at most"),
               minutes=(30.0, "after which no other case is begun"))
