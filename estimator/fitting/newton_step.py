"""`newton_step`: one Gauss-Newton step of motion and parameters together, the latents eliminated exactly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq import FloatArray, IndexArray
from estimator.errors import FitError
from estimator.likelihood import Linearised
from estimator.numerics import Swept, pseudo_inverse

DIVERGED = "the fit diverged; the starting values are too far from the data"


class NewtonStep(NamedTuple):
    """A whole step."""

    latents: FloatArray
    """(N, b)"""
    beta: FloatArray
    """(f,) of the free parameters"""
    information: FloatArray
    """(f, f) of these, the latents eliminated"""
    covariance: FloatArray
    """(f, f)"""
    fall: float
    """By how much it would lower the objective if that were quadratic, beta held."""


class Taken(NamedTuple):
    """A step that was taken, and where it began."""

    point: Linearised
    solved: Swept
    step: NewtonStep
    free: IndexArray
    """(f,) the free parameters"""
    moved: float
    """Length of what was taken of it, in standard deviations."""


def newton_step(point: Linearised, solved: Swept, index: IndexArray) -> NewtonStep:
    """Step of the latents and of the parameters `index`. Raises `FitError` where they are not finite."""
    product = solved.product()
    information = point.corner[np.ix_(index, index)] - product[np.ix_(1 + index, 1 + index)]
    if not np.isfinite(information).all():
        raise FitError(DIVERGED)
    covariance = pseudo_inverse(information)
    step_beta = -covariance @ (point.gradient_beta[index] - product[1 + index, 0])
    weights = np.zeros(point.chain.width)
    weights[0], weights[1 + index] = 1.0, step_beta
    return NewtonStep(-solved.solution(weights), step_beta, information, covariance, float(product[0, 0]))
