"""Runs of a leg of another engine, the last ones with a change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.evidence.blind.servo import write_case
from tests.evidence.blind.stickslip import Readings, as_read
from tests.support.mujoco_leg import random_leg
from tests.support.stick_slip_leg import TICK_S, move

REFERENCE = 4
"""Runs before the change."""


def leg_runs(out: Path, changes: Callable[[Readings], None], heavier: float = 0.0) -> tuple[list[Path], Path]:
    """Eight runs of one leg, the last four with a change of the readings, or of link 1's mass [kg] at its centre."""
    rng = np.random.default_rng(11)
    leg = replace(random_leg(rng), coulomb=(0.01, 0.05))

    def logged(run: int) -> Readings:
        after = run >= REFERENCE
        own = replace(leg, m1=leg.m1 + heavier) if after else leg
        readings = as_read(move(own, rng, seconds=10.0, closed=run % 2 == 1, high=(3.0, 2.0, 1.2, 2.5)[run % 4]))
        if after:
            changes(readings)
        return {k: v[:: round(0.01 / TICK_S)] for k, v in readings.items()}

    write_case("leg", 1, out, map(logged, range(8)), rng, leg, "", [], 0.05)
    return sorted((out / "leg-1").glob("r*.csv")), out / "leg-1/rig.toml"
