"""Recursive least squares, appendix A of the paper, eqs. (64)-(67).

Corrections of the paper: (64) uses the estimate of the previous sample, beta(t_{k-1}); Joseph's form (67) is
P = (1 - K Z) P (1 - K Z)^T + K R K^T. R = B Sigma_u B^T has rank 2, and the paper does not give the small number that
regularises it. The estimate depends on it: with angle errors a heavily weighted passive row biases beta to zero (to
0.4 of the truth with a 13-bit encoder at 1 % of the others' variance). Here it is `passive_nm`, by default the
residual of the first fit.

In exact arithmetic the recursion adds Z^T R^-1 Z to the inverse of P at every sample, so all its estimates are
one running sum; that is how they are computed. tests/estimator/fitting/test_rls.py holds them against (64)-(67) step by
step.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from daq import Dataset, FloatArray
from estimator.fitting.identifiability import undetermined
from estimator.fitting.wls import design_rows, free_mask, trajectory, weighted_least_squares
from estimator.likelihood import Noise
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import FitResult
from estimator.signals import split_signals

PRIOR_SPREAD = 1.0
"""P(0): each parameter's standard deviation as a share of the size of its first estimate."""


def recursive_estimates(z: FloatArray, torque: FloatArray, variance: FloatArray, beta: FloatArray,
                        covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """beta(t_k) (m, p) and P(t_m) (p, p) from z (m, n, p), torque (m, n), variance (n,), beta(0) and P(0)."""
    weighted = z / variance[:, None]
    first = np.linalg.inv(covariance)
    information = first + np.cumsum(weighted.swapaxes(1, 2) @ z, axis=0)
    right = first @ beta + np.cumsum(np.einsum("mnp,mn->mp", weighted, torque), axis=0)
    scale = 1.0 / np.sqrt(np.einsum("mpp->mp", information))
    scaled = information * scale[:, :, None] * scale[:, None]
    estimates = np.linalg.solve(scaled, (right * scale)[..., None])[..., 0] * scale
    return estimates, np.linalg.inv(scaled[-1]) * np.outer(scale[-1], scale[-1])


def torque_variance(mechanism: Mechanism, sigma: FloatArray, options: FitOptions) -> FloatArray:
    """R's diagonal (n,): torque noise as declared, or the residual's of a first fit (n,) where it is not."""
    return Noise(sigma, np.full(mechanism.n, np.inf)).with_declared(options.noise, mechanism.actuated).torque ** 2


def fit_rls(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FitResult:
    """Identify by (64)-(67), started by WLS-FCD as appendix A says; the last estimate is the result.

    Errors in the angles bias this estimate as they bias `wls`. Raises `FitError`.
    """
    start = time.perf_counter()
    signals = split_signals(datasets, mechanism, options)
    design = design_rows(signals, mechanism, options)
    free, beta = free_mask(mechanism, options)
    beta, _, sigma = weighted_least_squares(design.z, design.torque, free, beta, 1.0)
    known = design.z[:, :, ~free] @ beta[~free]
    variance = torque_variance(mechanism, np.maximum(sigma, 1e-12), options)
    spread = PRIOR_SPREAD * np.maximum(np.abs(beta[free]), 1e-3 * np.max(np.abs(beta), initial=1e-9))
    estimates, covariance_free = recursive_estimates(design.z[:, :, free], design.torque - known,
                                                     variance * design.samples_per_dof, beta[free],
                                                     np.diag(spread**2))
    beta = beta.copy()
    beta[free] = estimates[-1]
    covariance = np.zeros((mechanism.p, mechanism.p))
    covariance[np.ix_(free, free)] = covariance_free
    residual = design.torque - design.z @ beta
    trajectories = tuple(trajectory(s, k, mechanism, beta) for s, k in zip(signals, design.motions))
    return FitResult(
        mechanism, "rls", options.sensors, beta, covariance,
        {"torque_nm": float(np.sqrt(np.max(variance[list(mechanism.actuated)], initial=0.0)))},
        np.sqrt(np.mean(residual**2, axis=0)), True, 1, sum(len(s.time_s) for s in signals),
        time.perf_counter() - start, undetermined(mechanism, beta, covariance, free),
        (design.filtering,
         "the filtered motion is taken as exact: errors in it bias the estimate and are not in the intervals",
         "a passive joint's torque is zero to within passive_nm, or the first fit's residual",
         "the first estimate counts as one that may be 100 % wrong"),
        (), trajectories, dict(options.fixed), options.hold)
