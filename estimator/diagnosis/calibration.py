"""`calibrated`: how often answers of a probability are true, measured on legs whose causes are known.

    P = 1 / (1 + exp(-(c + a ln p - b ln(1 - p))))

p is the probability if the library has the true causes (`probability_of`). P is that of the answer, whatever the causes
are: beta calibration (Kull, Silva Filho and Flach, AISTATS 2017). Its coefficients are the likeliest of 155 answers,
136 of them those that docs/evidence/causes.md counts by probability; one in seven is to a cause outside the library.
`make evidence` says what P is worth on a family of legs that was left out of the fit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from daq import FloatArray
from estimator.diagnosis.decision_rule import DRAWS

COEFFICIENTS = (0.90, 0.16, 0.65)
"""a, b and c"""
NEAREST = 0.5 / DRAWS
"""What resamplings do not tell from zero, or from one"""


def terms(p: ArrayLike) -> FloatArray:
    """(..., 3) what a, b and c multiply."""
    kept = np.clip(np.asarray(p, dtype=float), NEAREST, 1.0 - NEAREST)
    return np.stack([np.log(kept), -np.log1p(-kept), np.ones_like(kept)], axis=-1)


def calibrated(p: float, coefficients: tuple[float, float, float] = COEFFICIENTS) -> float:
    """P (0 to 1) of an answer whose probability is p if the library has the true causes."""
    return 1.0 / (1.0 + math.exp(-float(terms(p) @ np.array(coefficients))))
