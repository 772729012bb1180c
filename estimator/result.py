"""`FitResult`: what an estimator found, what it could not determine, and what its intervals assume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm

from daq import FloatArray
from estimator.model import Mechanism


@dataclass(frozen=True)
class Trajectory:
    """Estimated motion and sensor predictions of one gap-free stretch of one run."""

    run: str
    """Name of the run."""
    time_s: FloatArray
    """(n,)"""
    q: FloatArray
    """(n, joints) [rad]"""
    qd: FloatArray
    """(n, joints) [rad/s]"""
    qdd: FloatArray
    """(n, joints) [rad/s2]"""
    tau: FloatArray
    """(n, joints) model torque Z beta along the estimated motion [N m]."""
    tau_measured: FloatArray
    """(n, joints) measured torque, zero on a passive joint [N m]."""
    measured: Mapping[str, FloatArray]
    """Sensor column -> (n,) measurement."""
    predicted: Mapping[str, FloatArray]
    """Sensor column -> (n,) prediction from the estimated motion."""


@dataclass(frozen=True)
class Combination:
    """Amounts by which parameters can change together without the data noticing."""

    amounts: tuple[tuple[str, float], ...]
    """Name and amount of each, the one that leads first, by 1."""

    def __str__(self) -> str:
        """For a person: "beta2 -0.8*beta3"."""
        (lead, _), *others = self.amounts
        return " ".join([lead, *(f"{amount:+.3g}*{name}" for name, amount in others)])


@dataclass(frozen=True)
class FitResult:
    """Identified parameters with their covariance, noise levels and the motion they came with."""

    mechanism: Mechanism
    method: str
    """mle | mle-free | wls | rls | hekf"""
    sensors: str
    """imu | encoder"""
    beta: FloatArray
    """(p,) in the order of `mechanism.parameters`."""
    covariance: FloatArray
    """(p, p)"""
    noise: Mapping[str, float]
    """1 sigma by channel: gyro_radps, accel_mps2, torque_nm, encoder_rad, pivot_nm, where estimated or used."""
    torque_residual_rms: FloatArray
    """(joints,) rms of measured minus modelled torque [N m]."""
    converged: bool
    iterations: int
    samples: int
    wall_s: float
    undetermined: tuple[Combination, ...] = ()
    """What this data cannot determine: single parameters, or several together."""
    assumptions: tuple[str, ...] = ()
    """What the intervals rest on, one plain sentence each."""
    warnings: tuple[str, ...] = ()
    trajectories: tuple[Trajectory, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Parameters that were given, not estimated."""
    hold: str = "linear"
    """How the torque was taken to act between samples."""
    hold_margin: float | None = None
    """Log-likelihood of that hold above the next one's, where it was chosen by the likelihood."""

    @property
    def open_parameters(self) -> frozenset[str]:
        """Names of the parameters that take part in what is undetermined: their values mean nothing."""
        return frozenset(name for combination in self.undetermined for name, _ in combination.amounts)

    @property
    def std(self) -> FloatArray:
        """(p,) standard deviations."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def ci95(self) -> FloatArray:
        """(p, 2) 95 % intervals, normal."""
        half = float(norm.ppf(0.975)) * self.std
        return np.stack([self.beta - half, self.beta + half], axis=-1)
