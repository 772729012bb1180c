"""`fit_setup`: a fit of prepared runs, which says what was done to them and what looks wrong in their set-up."""

from __future__ import annotations

from dataclasses import replace

from estimator import FitError, FitResult, Method
from estimator.fitting import fit_admissible
from experiments.rig import Setup
from experiments.workflows.suspicion import suspect


def fit_setup(setup: Setup, method: Method = "mle") -> FitResult:
    """`fit_admissible`, with the notes of `setup` among its assumptions, and with the remedies of a set-up that
    contradicts itself. Raises `FitError` as that does, naming them."""
    try:
        found = fit_admissible(setup.datasets, setup.mechanism, setup.options, method)
    except FitError as error:
        mends = suspect(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio, True).remedies
        raise FitError("; ".join([str(error), *["; or ".join(mends)] * bool(mends)])) from None
    bad = bool(found.inadmissible) or not found.converged or any("no scatter" in text for text in found.warnings)
    seen = suspect(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio, bad)
    return replace(found, assumptions=(*found.assumptions, *setup.notes), remedies=seen.remedies,
                   inadmissible=found.inadmissible or seen.against, warnings=(*found.warnings, *seen.remedies))
