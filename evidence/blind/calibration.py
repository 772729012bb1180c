"""The calibration of stated probabilities: coefficients by all answers, and what it is worth on families left out."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from daq import FloatArray
from estimator.diagnosis.calibration import calibrated, terms

SPREAD = 3.0
"""Standard deviation of each coefficient before any answer; what few answers do not tell stays near none."""
Coefficients = tuple[float, float, float]


class Stated(NamedTuple):
    """One answer with a probability."""

    family: str
    in_library: float
    """Its probability if the library has the causes"""
    true: bool


def fit(answers: Sequence[Stated]) -> Coefficients:
    """a, b from zero up, and c: the likeliest, a normal prior of SPREAD about (1, 1, 0), which leaves p as it is."""
    x, y = terms([a.in_library for a in answers]), np.array([a.true for a in answers])

    def misfit(w: FloatArray) -> tuple[float, FloatArray]:
        z, from_prior = x @ w, (w - (1.0, 1.0, 0.0)) / SPREAD**2
        loss = float(np.logaddexp(0.0, np.where(y, -z, z)).sum())
        slope = x.T @ (1.0 / (1.0 + np.exp(-z)) - y) + from_prior
        return loss + 0.5 * float(from_prior @ (w - (1.0, 1.0, 0.0))), slope

    found = minimize(misfit, (1.0, 1.0, 0.0), method="L-BFGS-B", jac=True,
                     bounds=[(0.0, None), (0.0, None), (None, None)])
    a, b, c = map(float, found.x)
    return a, b, c


def left_out(answers: Sequence[Stated]) -> list[float]:
    """Of each answer the calibrated probability by the answers of all other families."""
    others = {name: fit([a for a in answers if a.family != name]) for name in {a.family for a in answers}}
    return [calibrated(a.in_library, others[a.family]) for a in answers]

