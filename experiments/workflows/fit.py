"""`fit_setup`: a fit of prepared runs, which says what was done to them."""

from __future__ import annotations

from dataclasses import replace

from estimator import FitResult
from estimator.fitting import fit
from experiments.rig import Setup


def fit_setup(setup: Setup, method: str = "mle") -> FitResult:
    """`estimator.fitting.fit.fit`, with the notes of `setup` among its assumptions. Raises `FitError` as that does."""
    found = fit(setup.datasets, setup.mechanism, setup.options, method)
    return replace(found, assumptions=(*found.assumptions, *setup.notes))
