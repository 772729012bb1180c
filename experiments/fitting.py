"""`fit_setup`: a fit of prepared runs, which says what was done to them."""

from __future__ import annotations

from dataclasses import replace

from estimator.fit import fit
from estimator.result import FitResult
from experiments.rigs import Setup


def fit_setup(setup: Setup, method: str = "mle") -> FitResult:
    """`estimator.fit.fit`, with the notes of `setup` among its assumptions. Raises `FitError` as that does."""
    found = fit(setup.datasets, setup.mechanism, setup.options, method)
    return replace(found, assumptions=(*found.assumptions, *setup.notes))
