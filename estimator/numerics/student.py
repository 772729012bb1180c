"""`student_half_width`: Student's t of whole degrees of freedom. SciPy takes a tenth of a second to import."""

from __future__ import annotations

import math


def student_half_width(share: float, freedom: int) -> float:
    """The t for which |T| < t has the probability `share`, T of Student's t with so many degrees of `freedom`.

    The probability is a finite sum in the angle atan(t / sqrt(freedom)) (Abramowitz and Stegun 26.7.3, 26.7.4).
    """
    low, high = 0.0, 0.5 * math.pi
    while True:
        angle = 0.5 * (low + high)
        if angle in (low, high):
            return math.tan(angle) * math.sqrt(freedom)
        low, high = (angle, high) if _within(angle, freedom) < share else (low, angle)


def _within(angle: float, freedom: int) -> float:
    """Probability of |T| < sqrt(freedom) tan(angle)."""
    odd, square = freedom % 2, math.cos(angle) ** 2
    term, total = (math.cos(angle) if odd else 1.0), 0.0
    for k in range(2 + odd, freedom + 1, 2):
        total += term
        term *= square * (k - 1.0) / k
    return 2.0 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total
