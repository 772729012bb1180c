"""`FitOptions`: what a person may decide about a fit; everything else is estimated."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from daq import FloatArray
from estimator.model import HOLDS

AUTO = "auto"
"""What the likelihood chooses."""
NOISE_CHANNELS = ("gyro_radps", "accel_mps2", "accel_x_mps2", "accel_y_mps2", "torque_nm", "encoder_rad", "passive_nm")
OWN_LEVEL = re.compile(r"encoder[1-9][0-9]*_rad|torque[1-9][0-9]*_nm|passive[1-9][0-9]*_nm|gyro[1-9][0-9]*_radps|"
                       r"accel[1-9][0-9]*(_x|_y)?_mps2|disturbance[1-9][0-9]*_(nm|s)")
"""One joint's encoder, torque or disturbance, or one IMU's sensor, counted from 1: it goes before `encoder_rad`,
`torque_nm` and so on, which stand for all."""
Levels = Mapping[str, float]
"""Known standard deviations by channel."""


def encoder_level(known: Levels, joint: int) -> float | None:
    """Noise level of one joint's encoder [rad], joint 0-based; None where it is not known."""
    return known.get(f"encoder{joint + 1}_rad", known.get("encoder_rad"))


def torque_level(known: Levels, joint: int, driven: bool) -> float | None:
    """Noise level of one joint's torque [N m], or the model error of a joint that is not driven."""
    return known.get(f"torque{joint + 1}_nm", known.get("torque_nm")) if driven else \
        known.get(f"passive{joint + 1}_nm", known.get("passive_nm"))


def gyro_level(known: Levels, imu: int = 0) -> float | None:
    """Noise level of an IMU's gyro [rad/s], 0-based in the rig's order."""
    return known.get(f"gyro{imu + 1}_radps", known.get("gyro_radps"))


def accel_level(known: Levels, axis: int, imu: int = 0) -> float | None:
    """Noise level of axis 0 (x) or 1 (y) of an IMU's accelerometer [m/s^2]."""
    names = [f"accel{own}{which}_mps2" for own in (imu + 1, "") for which in (("_x", "_y")[axis], "")]
    return next((known[name] for name in names if name in known), None)


def _is_correlation(r: FloatArray) -> bool:
    """Whether r (n, n) is symmetric and positive definite with ones on its diagonal."""
    return (r.ndim == 2 and r.shape[0] == r.shape[1] and np.array_equal(r, r.T) and bool(np.all(np.diag(r) == 1.0))
            and bool(np.linalg.eigvalsh(r)[0] > 0.0))


@dataclass(frozen=True)
class FitOptions:
    """Checked when made; raises ValueError naming the option."""

    sensors: str = "imu"
    """imu: the mechanism's IMUs are read, and give the angles of joints without an encoder. encoder: encoders alone."""
    encoders: tuple[int, ...] | None = None
    """0-based joints whose encoders are read; None: all, on the IMU path all but joint 1's."""
    hold: str = "linear"
    """How the torque acts between samples: zero | linear | average | smooth; auto: as is likeliest (`mle`; the other
    methods take it for linear)."""
    smoothing_velocity: str = "given"
    """Friction smoothing velocity of each joint. given: the mechanism's. auto: estimated, at least the mechanism's
    (`mle` only)."""
    noise: Levels = field(default_factory=dict)
    """Known standard deviations by channel; the others are estimated."""
    accel_correlation: float = 0.0
    """Known correlation of the accelerometer's x and y noise (`mle` on one motion only)."""
    torque_correlation: tuple[tuple[float, ...], ...] = ()
    """Known correlation of the driven joints' torque noise, a row each by rising joint; empty: none (likewise)."""
    cutoff_hz: float | None = None
    """Low pass of `wls` and of starting values; None: a tenth of the rate, at most 10 Hz."""
    filter_order: int = 4
    half_power: float | None = None
    """wls, rls and hekf: the paper's recipe of section V instead: noisy angles low-passed at this share of the
    Nyquist rate (1: not at all), differences over `spacing` samples by (60), (61), nothing else filtered."""
    spacing: int = 1
    """n_cd of (60), (61), with `half_power`."""
    torque_half_power: float | None = None
    """With `half_power`: the torque is low-passed at this share of the Nyquist rate, (34); None: not at all, as section
    V filters only the absolute angle."""
    weights: str = "estimated"
    """wls only. estimated: each joint's torque by its own residual. known: by torque_nm and passive_nm of `noise`."""
    encoder_zeros: tuple[int, ...] = ()
    """0-based joints whose encoders' zeros differ from run to run: a comparison takes them to be unknown in each."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Parameters that are given by name, not estimated."""
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Value and standard deviation of parameters and body values (m1, lc1, I1, l1, ...) that are known from elsewhere;
    `mle` on one motion then finds the maximum a posteriori."""
    tolerances: Mapping[str, tuple[float, ...]] | None = None
    """mle on one motion only: effect, or effect@joint, to the tolerance of each of its sizes, 1 sigma, SI. What is not
    named has its default, or none where there is a key `none`. None: all are zero."""
    gear_ratio: float = 1.0
    """Of the motor."""
    unknown_loop: tuple[str, ...] = ()
    """mle on one motion only: keys of `[servo]` that are estimated with the parameters, of joints whose loop makes the
    torque: delay_s, limit, integral, damping."""
    seeks_omitted: bool = False
    """mle on one motion only: whether the fit looks for listed effects that would move its parameters."""
    latent: str = "trajectory"
    """mle only. trajectory: one consistent motion. free: the paper's free samples of sin, cos and rate."""

    def __post_init__(self) -> None:
        if self.sensors not in ("imu", "encoder"):
            raise ValueError(f"sensors {self.sensors!r} is neither imu nor encoder")
        if self.hold not in (*HOLDS, AUTO):
            raise ValueError(f"hold {self.hold!r} is none of {(*HOLDS, AUTO)}")
        if self.smoothing_velocity not in ("given", AUTO):
            raise ValueError(f"smoothing velocity {self.smoothing_velocity!r} is neither given nor auto")
        if self.latent not in ("trajectory", "free"):
            raise ValueError(f"latent {self.latent!r} is neither trajectory nor free")
        if self.weights not in ("estimated", "known"):
            raise ValueError(f"weights {self.weights!r} are neither estimated nor known")
        if self.weights == "known" and not {"torque_nm", "passive_nm"} <= set(self.noise):
            raise ValueError("known weights need torque_nm and passive_nm among the noise levels")
        if self.half_power is not None and not 0.0 < self.half_power <= 1.0:
            raise ValueError(f"half_power {self.half_power} is not in (0, 1]")
        if self.spacing < 1:
            raise ValueError(f"spacing {self.spacing} is below 1")
        for name, (value, std) in self.prior.items():
            if not (np.isfinite(value) and np.isfinite(std) and std > 0.0):
                raise ValueError(f"prior {name} = {value:g} +- {std:g} has no standard deviation above zero")
        unknown = {name for name in self.noise if name not in NOISE_CHANNELS and not OWN_LEVEL.fullmatch(name)}
        if unknown:
            raise ValueError(f"noise channel {sorted(unknown)[0]!r} is none of {NOISE_CHANNELS}")
        if not -1.0 < self.accel_correlation < 1.0:
            raise ValueError(f"accel_correlation {self.accel_correlation} is not in (-1, 1)")
        if self.torque_correlation and not _is_correlation(np.array(self.torque_correlation)):
            raise ValueError(f"torque_correlation {self.torque_correlation} is no matrix of correlations")

    def encoders_of(self, joints: int) -> tuple[int, ...]:
        """0-based joints of a mechanism of so many whose encoders are read."""
        return tuple(range(int(self.sensors == "imu"), joints)) if self.encoders is None else self.encoders

    def encoder_noise(self, joint: int) -> float | None:
        """Known standard deviation of one joint's encoder [rad], joint 0-based; None where it is to be estimated."""
        return encoder_level(self.noise, joint)

    def torque_noise(self, joint: int, driven: bool) -> float | None:
        """Noise level of one joint's torque [N m], joint 0-based; the model error of a joint that is not driven."""
        return torque_level(self.noise, joint, driven)

    def gyro_noise(self, imu: int = 0) -> float | None:
        """Noise level of an IMU's gyro [rad/s], 0-based in the rig's order."""
        return gyro_level(self.noise, imu)

    def accel_noise(self, axis: int, imu: int = 0) -> float | None:
        """Noise level of axis 0 (x) or 1 (y) of an IMU's accelerometer [m/s^2]."""
        return accel_level(self.noise, axis, imu)

    def disturbance(self, joint: int) -> tuple[float, float] | None:
        """Known level [N m] and time constant [s] of one joint's coloured disturbance torque, joint 0-based; None where
        they are to be estimated. A level of 0 says that there is none."""
        level = self.noise.get(f"disturbance{joint + 1}_nm")
        return None if level is None else (level, self.noise.get(f"disturbance{joint + 1}_s", 1.0))

    def cutoff(self, rate_hz: float) -> float:
        """The low pass in force [Hz]."""
        return self.cutoff_hz if self.cutoff_hz is not None else min(10.0, 0.1 * rate_hz)
