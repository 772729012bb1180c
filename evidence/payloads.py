"""`make payloads`: is the mass of a payload on link 2 within its interval?

Emulated legs with random parameters record four runs through the drivers, then four more with a point mass at a random
place of link 2. The second four are compared with the first. Called again it goes on where it stopped.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from evidence.emulated_legs import RATE_HZ, label, leg_of, rig_in
from evidence.frame import Lines, new_folder, program, share, table, within
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.emulation import LegBody, record_emulated
from experiments.excite import random_multisine
from experiments.workflows import find_change

SEED, RUNS, SECONDS, PEAK_NM = 4041, 4, 5.0, 0.7
SHARES, FARTHEST_M = (0.02, 0.2), 0.3
"""Range of the mass as a share of link 2's, and of its distance from the knee."""


AT = "payload@2"


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


def carrying(body: LegBody, mass_kg: float, arm_m: float) -> LegBody:
    """The leg with a point mass fixed to link 2, so far from the knee."""
    whole = body.m2 + mass_kg
    centre = (body.m2 * body.c2 + mass_kg * arm_m) / whole
    inertia = body.i2 + body.m2 * (body.c2 - centre) ** 2 + mass_kg * (arm_m - centre) ** 2
    return replace(body, m2=whole, c2=centre, i2=inertia)


def loaded(number: int) -> tuple[LegBody, LegBody, float, float]:
    """Leg `number` and the same with its payload, mass [kg] and distance from the knee [m]."""
    rng, body = np.random.default_rng([SEED, number]), leg_of(SEED, number)
    share, arm = float(np.exp(rng.uniform(*np.log(SHARES)))), rng.uniform(0.0, FARTHEST_M)
    return body, carrying(body, share * body.m2, arm), share * body.m2, arm


@kept
def outcome(number: int) -> Outcome:
    """Leg `number`, its eight runs, the comparison."""
    bare, heavy, mass, arm = loaded(number)
    with new_folder() as folder:
        rig, text = rig_in(folder)
        files = [folder / f"run{k}.mcap" for k in range(2 * RUNS)]
        for k, file in enumerate(files):
            seed = 1000 * number + k
            record_emulated(file, rig, text, random_multisine(seed, SECONDS, PEAK_NM), seed,
                            bare if k < RUNS else heavy)
        found = find_change(files[RUNS:], files[:RUNS], rig).change
    masses = [(size.value, *size.ci95) for cause in found.causes if label(cause.effect, cause.joint) == AT
              for size in cause.size if size.name == "mass"]
    return Outcome(mass / bare.m2, mass, arm, found.verdict, tuple(label(c.effect, c.joint) for c in found.causes),
                   masses[0] if masses else None)


def page(legs: int = 50, minutes: float = 30.0) -> Lines:
    rows = [outcome(number) for number in within(minutes, range(legs))]
    yield from [
        "# Payloads at random places",
        f"Each emulated leg (seed {SEED}) records {RUNS} runs of {SECONDS:g} s of a random multisine through the "
        f"drivers, and {RUNS} more with a point mass on link 2. The mass is {100 * SHARES[0]:g} to "
        f"{100 * SHARES[1]:g} % of the link's, at 0 to {FARTHEST_M:g} m from the knee. `legid diagnose --against` "
        f"compares them at {RATE_HZ:g} Hz. No motion determines the mass of a payload on link 1, so none is put there.",
        f"{len(rows)} of {legs} legs were measured."]
    yield table(" | measured | wanted", [
        f"mass within its 95 % interval | {share(o.found[1] <= o.mass_kg <= o.found[2] for o in rows if o.found)} | "
        "93 to 97 %",
        f"a payload of link 2 is named alone | {share((o.verdict, o.causes) == ('named', (AT,)) for o in rows)} | "])
    yield table("share of link 2 | distance [m] | mass [kg] | verdict | causes | mass found [kg]", (
        f"{100 * one.share:.1f} % | {one.arm_m:.3f} | {one.mass_kg:.4f} | {one.verdict} | {', '.join(one.causes)} | "
        + ("{:.3g} ({:.3g} to {:.3g})".format(*one.found) if one.found else "-") for one in rows))


EVIDENCE = Evidence(
    "Payloads at random places of link 2: is the mass within its interval?", "make payloads", "payloads.md",
    20, "93 to 97 %", (r"(mass within its 95 % interval) \| ([^|]*\))",))
main = program(page)
