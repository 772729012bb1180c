"""`SwingDamping` and `FallDamping`: shares of Gauss-Newton steps that are taken."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from daq import FloatArray
from estimator.fitting.newton_step import NewtonStep

SHORTER, LONGER = 0.5, 1.2
"""Factors on the share of a step after one that was too long, and after one that was not: back to whole steps in four,
so that a swing in every tenth step does not slow a search down."""
SHORTEST = 0.1
"""Least share of a step that is taken: with less, sixty steps lead nowhere."""
FREE_STEPS = 3
"""First steps, which are whole: they come from far off, and their noise levels are rough."""
SWING = 0.25
"""A step that goes back by more than this share of the one before was preceded by one that was too long."""
RISE = 1.05
"""Growth of the objective above which a step was too long. (Measured: it doubled where a joint reversed close to a
sample; the next step gave 0.7.)"""
REACH_RAD = 0.5
"""Most that a step moves an angle: a linearisation means little there."""


@dataclass
class SwingDamping:
    """Shares of steps in motion and parameters: shorter where the parameters go to and fro, or the objective rises."""

    share: float = 1.0
    lowest: float = np.inf
    before: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(f,) the step before"""

    def next(self, iteration: int, objective: float, step: NewtonStep, anew: bool) -> float:
        """The share to take of a step; `anew`: objectives of before cannot be compared."""
        if iteration >= FREE_STEPS:
            along = float(step.beta @ step.information @ self.before)
            swings = along < -SWING * float(self.before @ step.information @ self.before)
            too_long = swings or objective > RISE * self.lowest
            self.share = max(SHORTEST, SHORTER * self.share) if too_long else min(1.0, LONGER * self.share)
            self.lowest = min(self.lowest, objective)
        if anew:
            self.lowest = objective
        self.before = step.beta
        return self.share


@dataclass
class FallDamping:
    """Shares of steps in the motion alone: shorter where the objective rises; 0 where no step lowers it."""

    share: float = 1.0
    before: float = np.inf

    def next(self, iteration: int, objective: float, step: NewtonStep, anew: bool) -> float:
        """The share to take of a step; `anew`: objectives of before cannot be compared."""
        rose, self.before = not anew and objective > self.before, objective
        if iteration >= FREE_STEPS:
            if rose and self.share == SHORTEST:  # effects whose slope the equations neglect
                return 0.0
            self.share = max(SHORTEST, SHORTER * self.share) if rose else min(1.0, LONGER * self.share)
        return self.share


def shortened(angles: FloatArray, share: float) -> float:
    """`share`, less where an angle would move by more than REACH_RAD."""
    biggest = share * float(np.max(np.abs(angles)))
    return share if biggest < REACH_RAD else share * REACH_RAD / biggest
