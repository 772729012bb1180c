"""Tests of residuals as MATLAB's `resid` has them: are they white, and independent of the input?

Ljung (System Identification, 2nd ed., section 16.6): of white residuals the normalised autocorrelation at any lag but
zero is near Normal(0, 1/N), of residuals independent of the input the cross-correlation near Normal(0, P/N) with
P = sum over lags of the product of both autocorrelations. Bands hold 99 % of each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from daq import BoolArray, FloatArray
from estimator import RESIDUAL_LAGS, FitResult, Trajectory
from estimator.likelihood import Noise, Process, held_variance
from estimator.numerics import correlate

SHARE = 0.99
STRONG = 0.2
"""Autocorrelation beyond which a residual counts as material structure, whatever the number of samples."""


@dataclass(frozen=True)
class Correlation:
    """One correlation function of residuals."""

    what: str
    """The residual's name, with the input's where it is held against one."""
    lags: FloatArray
    """(k,) in samples"""
    values: FloatArray
    """(k,)"""
    band: float
    """Half width of the 99 % band."""

    @property
    def outside(self) -> float:
        """Share of the lags outside the band; lag zero of an autocorrelation is not among them."""
        return float(np.mean(np.abs(self.values) > self.band))

    @property
    def largest(self) -> float:
        """Largest size."""
        return float(np.max(np.abs(self.values)))


def autocorrelation(what: str, residuals: Sequence[FloatArray], own: FloatArray | None = None) -> Correlation:
    """Autocorrelation of residuals by segment, at lags 1 to `RESIDUAL_LAGS`, less what a right model leaves.

    That is `own` (RESIDUAL_LAGS,), by default zero. The band is Bartlett's (J. R. Stat. Soc. Suppl. 8, 1946): that of
    white noise, times (1 + 2 sum own^2)^1/2.
    """
    lags = np.arange(1.0, RESIDUAL_LAGS + 1)
    own = np.zeros(RESIDUAL_LAGS) if own is None else own
    count = sum(int(np.isfinite(e).sum()) for e in residuals) / (1.0 + 2.0 * float(own @ own))
    band = NormalDist().inv_cdf(0.5 + SHARE / 2) / count**0.5
    return Correlation(what, lags, correlate(residuals, residuals, lags) - own, band)


def torque_autocorrelation(result: FitResult, j: int, residuals: Sequence[FloatArray]) -> Correlation:
    """Autocorrelation of the torque residual of joint `j`, from 0, less what the fit of a right model leaves."""
    own = result.torque_colour
    return autocorrelation(f"torque {j + 1}", residuals, None if own is None else own[j])


def torque_level(result: FitResult, j: int, otherwise: float) -> float:
    """Noise [N m] of the measured torque of joint `j`, from 0; `otherwise` where the method has none."""
    return result.noise.get(f"torque{j + 1}_nm", result.noise.get("torque_nm", otherwise))


def cross_correlation(what: str, residuals: Sequence[FloatArray], inputs: Sequence[FloatArray]) -> Correlation:
    """Correlation of residuals with an input, at lags of up to `RESIDUAL_LAGS` either way; a
    positive one is the input's past."""
    lags = np.arange(-float(RESIDUAL_LAGS), RESIDUAL_LAGS + 1)
    count = sum(int(np.isfinite(e).sum()) for e in residuals)
    far = np.arange(1.0, 4 * RESIDUAL_LAGS + 1)
    power = 1.0 + 2.0 * float(correlate(residuals, residuals, far) @ correlate(inputs, inputs, far))
    band = NormalDist().inv_cdf(0.5 + SHARE / 2) * max(power, 0.0) ** 0.5 / count**0.5
    return Correlation(what, lags, correlate(residuals, inputs, lags), band)


def open_torque(result: FitResult, path: Trajectory, j: int) -> BoolArray:
    """(n,) samples near rest at which dry friction of joint `j`, from 0, may balance more torque than its noise.

    The model does not determine the torque there, so the residual does not count.
    """
    m, found = result.mechanism, np.zeros(len(path.time_s), bool)
    rms = float(result.torque_residual_rms[j])
    sigma = torque_level(result, j, rms) if j in m.actuated else result.noise.get("passive_joint_nm", rms)
    for p, level in zip(m.parameters, result.beta):
        if p.term == "coulomb" and p.at[0] == j and result.method in ("mle", "shooting"):
            found |= held_variance(path.qd[:, j], float(level), float(m.velocity_scales[j])) > sigma**2
    return found


def torque_fit(result: FitResult, j: int, paths: Sequence[Trajectory]) -> float:
    """Fit [%] of the model's torque of joint `j`, from 0, to the measured one where the model says what it is."""
    judged = np.concatenate([~open_torque(result, path, j) for path in paths])
    measured, modelled = (np.concatenate([getattr(path, name)[:, j] for path in paths])
                          for name in ("tau_measured", "tau"))
    return fit_percent(np.where(judged, measured, np.nan), modelled)


def torque_innovations(result: FitResult, path: Trajectory, j: int) -> FloatArray:
    """(n,) measured less modelled torque of joint `j`, from 0 [N m]; with a coloured disturbance what of that its past
    does not predict."""
    error = path.tau_measured[:, j] - path.tau[:, j]
    level = result.noise.get(f"disturbance{j + 1}_nm")
    if level is None:
        return error
    white = torque_level(result, j, 0.0) if j in result.mechanism.actuated else result.noise["passive_joint_nm"]
    dt = float(path.time_s[1] - path.time_s[0])
    process = Process.of(Noise(np.array([white]), np.ones(1), disturbance=np.array([level]),
                               time_constant=np.array([result.noise[f"disturbance{j + 1}_s"]])), dt)
    return process.innovations(error, 0, white)


def residuals_of(result: FitResult) -> dict[str, list[FloatArray]]:
    """Channel -> measured less estimated, by segment: sensors, and the torque of every joint, NaN where it is open;
    a channel without any is left out."""
    def left(path: Trajectory) -> Mapping[str, FloatArray]:
        sensors = {name: path.measured[name] - path.predicted[name] for name in path.measured if name in path.predicted}
        return sensors | {
            f"torque {j + 1}": np.where(open_torque(result, path, j), np.nan, torque_innovations(result, path, j))
            for j in range(result.mechanism.n)}

    found: dict[str, list[FloatArray]] = {}
    for path in result.trajectories:
        for name, values in left(path).items():
            found.setdefault(name, []).append(values)
    return {name: e for name, e in found.items() if np.isfinite(np.concatenate(e)).any()}


def residual_tests(result: FitResult) -> tuple[list[Correlation], list[Correlation]]:
    """(autocorrelations, cross-correlations with the torque of each driven joint) of a fit's residuals.

    Empty for a method that estimates no motion. What a fit makes free for every sample leaves no residual to test.
    """
    found = {name: e for name, e in residuals_of(result).items()
             if np.nanstd(np.concatenate(e)) > 1e-9 and min(map(len, e)) > 4 * RESIDUAL_LAGS}
    inputs = {j + 1: [path.tau_measured[:, j] for path in result.trajectories] for j in result.mechanism.actuated}
    torques = {f"torque {j + 1}": j for j in result.mechanism.actuated}
    return ([torque_autocorrelation(result, torques[name], e) if name in torques else autocorrelation(name, e)
             for name, e in found.items()],
            [cross_correlation(f"{name} with the torque of joint {j}", e, u)
             for name, e in found.items() for j, u in inputs.items() if name != f"torque {j}"])


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    """100 (1 - |measured - modelled| / |measured - mean|) [%], MATLAB's NRMSE fit: 100 is exact, 0 no better than the
    mean."""
    good = np.isfinite(measured) & np.isfinite(modelled)
    spread = float(np.linalg.norm(measured[good] - measured[good].mean())) if good.any() else 0.0
    return 100.0 * (1.0 - float(np.linalg.norm((measured - modelled)[good])) / spread) if spread else float("nan")
