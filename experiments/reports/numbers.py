"""`number`: the format of numbers that reports share."""

from __future__ import annotations

import math


def number(value: float, std: float = 0.0) -> str:
    """`value` to two digits of its standard deviation, or to five digits where it has none."""
    if not math.isfinite(value):
        return "not determined"
    if not (math.isfinite(std) and std > 0):
        return f"{value:.5g}"
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{value:.{decimals}f}"
