"""`number`, the format of numbers that reports share, and `Estimate`, a value with its interval."""

from __future__ import annotations

import math
from typing import NamedTuple

from estimator import TWO_SIDED, FitResult

LARGE = 1e6
"""Of a standard deviation: numbers beyond it are written with a power of ten."""


def number(value: float, std: float = 0.0) -> str:
    """`value` to two digits of its standard deviation, or to five digits where it has none, or a `LARGE` one."""
    if not math.isfinite(value):
        return "not determined"
    if not 0.0 < std < LARGE:
        return f"{value:.5g}"
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{value:.{decimals}f}"


class Estimate(NamedTuple):
    """A parameter as it was found, in its unit."""

    value: float
    std: float
    low: float
    """Of its 95 % interval, as `high`."""
    high: float

    @property
    def interval(self) -> str:
        """Both ends as text; empty where they are not known."""
        known = 0.0 < self.std < math.inf
        return f"{number(self.low, self.std)} .. {number(self.high, self.std)}" if known else ""

    def holds(self, truth: float) -> bool:
        """Whether `truth` lies in the interval."""
        return self.low <= truth <= self.high


def normal(value: float, std: float) -> Estimate:
    """One whose interval is by its standard deviation alone."""
    return Estimate(value, std, value - TWO_SIDED * std, value + TWO_SIDED * std)


def estimates_of(result: FitResult) -> dict[str, Estimate]:
    """Parameter -> estimate of a fit: wider where its runs disagree, one-sided where a level is held at zero."""
    rows = zip(result.mechanism.names, result.beta, result.std, result.ci95())
    return {name: Estimate(float(value), float(std), float(low), float(high)) for name, value, std, (low, high) in rows}
