"""`with_levels_by_run`: a fit with separate noise levels of runs, where these differ; see `run_levels`."""

from __future__ import annotations

from dataclasses import replace

from estimator.fit_errors import FIT_ERRORS
from estimator.fitting.extension import ExtendedFit
from estimator.fitting.gauss_newton import iterate
from estimator.fitting.initial_guess import noise_floors
from estimator.likelihood import unit_scale


def with_levels_by_run(fitted: ExtendedFit) -> ExtendedFit:
    """The fit with levels of its runs; as it was where these are alike, and where no fit with them converges."""
    problem, state, _, free, options, *_ = fitted
    if not state.converged or len(problem.run_starts) < 2:
        return fitted
    alike = unit_scale(problem.total, problem.n, problem.imu_count)
    try:
        found = iterate(problem, replace(state, noise=replace(state.noise, scale=alike)), free, options,
                        noise_floors(problem, problem.mechanism, state.beta))
    except FIT_ERRORS:
        return fitted
    return fitted._replace(state=found) if found.converged and found.noise.scale is not None else fitted
