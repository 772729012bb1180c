"""Runs of a leg of another engine, the last ones with a change."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from evidence.blind.servo import Readings, write_case
from evidence.blind.stickslip import as_read
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.stick_slip_leg import TICK_S, move

REFERENCE = 4
"""Runs before the change."""


def loaded(leg: Leg, link: int, mass: float, distance: float, inertia: float) -> Leg:
    """`leg` with a body fixed to a link (1 or 2): its mass, distance from the link's joint, inertia about its own
    centre."""
    m, c, i = (leg.m1, leg.c1, leg.i1) if link == 1 else (leg.m2, leg.c2, leg.i2)
    centre = (m * c + mass * distance) / (m + mass)
    whole = i + m * (c - centre) ** 2 + inertia + mass * (distance - centre) ** 2
    if link == 1:
        return replace(leg, m1=m + mass, c1=centre, i1=whole)
    return replace(leg, m2=m + mass, c2=centre, i2=whole)


def leg_runs(out: Path, changes: Callable[[Readings], None], changed: Callable[[Leg], Leg] = lambda leg: leg,
             seconds: float = 10.0) -> tuple[list[Path], Path]:
    """Eight runs of `seconds` [s] of one leg, the last four with a change of the readings, or of the leg."""
    rng = np.random.default_rng(11)
    leg = replace(random_leg(rng), coulomb=(0.01, 0.05))

    def logged(run: int) -> Readings:
        after = run >= REFERENCE
        own = changed(leg) if after else leg
        readings = as_read(move(own, rng, seconds=seconds, closed=run % 2 == 1, high=(3.0, 2.0, 1.2, 2.5)[run % 4]))
        if after:
            changes(readings)
        return {k: v[:: round(0.01 / TICK_S)] for k, v in readings.items()}

    write_case("leg", 1, out, map(logged, range(8)), rng, leg, "", [], 0.05)
    return sorted((out / "leg-1").glob("r*.csv")), out / "leg-1/rig.toml"
