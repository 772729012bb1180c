"""`make payloads`: is the mass of a payload on link 2 within its interval?

Emulated legs with random parameters record four runs through the drivers, then four more with a point mass at a random
place of link 2. The second four are compared with the first. Called again it goes on where it stopped.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evidence.blind.score import Rate
from evidence.emulated_legs import RATE_HZ, leg_of, rig_in
from evidence.kept import kept
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from experiments.emulation import LegBody, record_emulated
from experiments.excite import random_multisine
from experiments.workflows import find_change
from studies import machine

SEED, RUNS, SECONDS, PEAK_NM = 4041, 4, 5.0, 0.7
SHARES, FARTHEST_M = (0.02, 0.2), 0.3
"""Range of the mass as a share of link 2's, and of its distance from the knee."""


class Outcome(NamedTuple):
    """One leg."""

    share: float
    mass_kg: float
    arm_m: float
    verdict: str
    causes: tuple[str, ...]
    """`effect@joint`"""
    found: tuple[float, float, float] | None = None
    """Mass and its interval [kg]; None where the answer has no payload of link 2 with a mass."""

    @property
    def held(self) -> bool | None:
        return None if self.found is None else self.found[1] <= self.mass_kg <= self.found[2]


def loaded(number: int) -> tuple[LegBody, LegBody, float, float]:
    """Leg `number` and the same with its payload, mass [kg] and distance from the knee [m]."""
    rng, body = np.random.default_rng([SEED, number]), leg_of(SEED, number)
    share, arm = float(np.exp(rng.uniform(*np.log(SHARES)))), float(rng.uniform(0.0, FARTHEST_M))
    return body, body.carrying(share * body.m2, arm), share * body.m2, arm


@kept
def outcome(number: int) -> Outcome:
    """Leg `number`, its eight runs, the comparison."""
    bare, heavy, mass, arm = loaded(number)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rig, text = rig_in(folder)
        files = [folder / f"run{k}.mcap" for k in range(2 * RUNS)]
        for k, file in enumerate(files):
            seed = 1000 * number + k
            record_emulated(file, rig, text, random_multisine(seed, SECONDS, PEAK_NM), seed,
                            bare if k < RUNS else heavy)
        found = find_change(files[RUNS:], files[:RUNS], rig).change
    causes = tuple(c.effect if c.joint is None else f"{c.effect}@{c.joint}" for c in found.causes)
    masses = [(size.value, *size.ci95) for cause in found.causes if (cause.effect, cause.joint) == ("payload", 2)
              for size in cause.size if size.name == "mass"]
    return Outcome(mass / bare.m2, mass, arm, found.verdict, causes, masses[0] if masses else None)


def page(legs: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    rows = list[Outcome]()
    for number in within(minutes, range(legs)):
        rows.append(outcome(number))
        print(number, rows[-1], rows[-1].held, flush=True)
    held = [one.held for one in rows if one.held is not None]
    alone = sum(one.verdict == "named" and one.causes == ("payload@2",) for one in rows)
    yield from [
        "# Payloads at random places", "",
        f"Made by `make payloads MINUTES={minutes:g}` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, {machine()}, one "
        "core that other work shared.", "",
        f"Each emulated leg records {RUNS} runs of {SECONDS:g} s of a random multisine through the drivers, and {RUNS} "
        f"more with a point mass on link 2. The mass is {100 * SHARES[0]:g} to {100 * SHARES[1]:g} % of the link's, at "
        f"0 to {FARTHEST_M:g} m from the knee. `legid diagnose --against` compares them at {RATE_HZ:g} Hz. No motion "
        "determines the mass of a payload on link 1, so none is put there.", "",
        f"{len(rows)} of {legs} legs were measured." if len(rows) < legs else f"All {legs} legs were measured.", "",
        "| | measured | wanted |", "| --- | --- | --- |",
        f"| mass within its 95 % interval | {Rate(sum(held), len(held))} | 93 to 97 % |",
        f"| a payload of link 2 is named alone | {Rate(alone, len(rows))} | |", "",
        "| share of link 2 | distance [m] | mass [kg] | verdict | causes | mass found [kg] |",
        "| ---: | ---: | ---: | --- | --- | --- |"]
    for one in rows:
        found = "-" if one.found is None else f"{one.found[0]:.3g} ({one.found[1]:.3g} to {one.found[2]:.3g})"
        yield (f"| {100 * one.share:.1f} % | {one.arm_m:.3f} | {one.mass_kg:.4f} | {one.verdict} | "
               f"{', '.join(one.causes)} | {found} |")
    yield ""


EVIDENCE = (
    Evidence("Payloads at random places of link 2: is the mass within its interval?", "make payloads", "payloads.md",
             20, "93 to 97 %", (r"(mass within its 95 % interval) \| ([^|]*\))",)),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, legs=(50, "at most"),
               minutes=(30.0, "after which no other leg is begun"))
