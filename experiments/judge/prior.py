"""Contradictions between runs and prior knowledge."""

from __future__ import annotations

from estimator import FitResult

CONTRADICTS = 3.0
"""Standard deviations from which on the runs contradict what was known."""


def contradictions_of(result: FitResult) -> list[str]:
    """One sentence for each known value that the runs contradict."""
    found = [f"the runs contradict [prior] {one.name} = {one.value:.4g} +- {one.std:.2g} by {one.contradiction:.1f} "
             f"standard deviations (after the fit {one.fitted:.4g}): measure it again, or take it out"
             for one in result.prior if one.contradiction > CONTRADICTS]
    if not found and result.prior_conflict > CONTRADICTS:
        found = [f"the runs contradict [prior] by {result.prior_conflict:.1f} standard deviations a value: check its "
                 "values and units"]
    return found
