"""`SmallSteps` and `SmallFall`: ends of Gauss-Newton searches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.fitting.damping import RISE
from estimator.fitting.newton_step import NewtonStep
from estimator.likelihood import Latents

TOLERANCE = 0.05
"""Converged when a step moves no parameter by more than this share of its standard deviation."""
LOOSE_AFTER = 15
"""Steps before LOOSE."""
LOOSE = 0.15
"""After so many steps this share of a standard deviation will do: a joint that reverses, or rests, close to a
sample makes the last digits swing."""
ROUGH = 0.5
"""As TOLERANCE, once, where only a start for a longer record is wanted: its standard deviations are smaller."""
SAME_NOISE, ROUGHLY_SAME_NOISE = 0.01, 0.1
"""Largest relative change of a noise level in a step at the end of a search, and likewise."""
SMALL_STEPS = 2
"""Small steps one after the other that end a search: a single one may be a chance."""
SAME_OBJECTIVE = 0.1
"""Fall of the objective, -2 log likelihood, below which a step changes nothing: one predicted, or two observed, end the
search."""


@dataclass
class SmallSteps:
    """End of a search for motion, parameters and noise levels: neither parameters nor levels change any more."""

    rough: bool = False
    """Ends at ROUGH."""
    objective: float = np.inf
    small: int = 0
    """Small steps so far, one after the other."""

    def before(self, iteration: int, x: Latents, objective: float, anew: bool) -> bool:
        """Whether the search has ended at the motion x, before a step."""
        return False

    def at(self, step: NewtonStep, anew: bool) -> bool:
        """Whether the search has ended because of what a step promises."""
        return False

    def after(self, iteration: int, moved: float, objective: float, change: float | None) -> bool:
        """Whether the search has converged with a step that moved the parameters by so many standard deviations, and
        levels by `change`, from a point of this objective; None: more than levels is sought still."""
        enough = ROUGH if self.rough else TOLERANCE if iteration < LOOSE_AFTER else LOOSE
        same_noise = change is not None and change < (ROUGHLY_SAME_NOISE if self.rough else SAME_NOISE)
        overshot = objective > RISE * self.objective and iteration < LOOSE_AFTER
        self.objective = objective
        self.small = self.small + 1 if moved < enough and same_noise and not overshot else 0
        return self.small >= (1 if self.rough else SMALL_STEPS)


class SmallFall:
    """End of a search for the motion alone, after up to `limit` steps: the objective falls no further."""

    def __init__(self, x: Latents, limit: int) -> None:
        self.limit, self.small = limit, 0
        self.best, self.lowest, self.objective = x, np.inf, np.inf
        """The motion of the lowest objective, which is that of the last point or of one before."""

    def before(self, iteration: int, x: Latents, objective: float, anew: bool) -> bool:
        """Whether the objective has stopped falling at x; `anew`: objectives of before cannot be compared."""
        if anew:
            self.lowest = self.objective = np.inf
        if objective < self.lowest:
            self.lowest, self.best = objective, x
        fall, self.objective = self.objective - objective, objective
        self.small = self.small + 1 if abs(fall) < SAME_OBJECTIVE else 0
        return self.small == SMALL_STEPS or iteration == self.limit

    def at(self, step: NewtonStep, anew: bool) -> bool:
        """Whether a step promises too small a fall."""
        return step.fall < SAME_OBJECTIVE and not anew

    def after(self, iteration: int, moved: float, objective: float, change: float | None) -> bool:
        """False: no step tells."""
        return False
