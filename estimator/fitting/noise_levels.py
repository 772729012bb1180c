"""Noise levels as a fit begins with them, and as others see them afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray
from estimator.likelihood import Noise
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import white_noise_level


def first_levels(options: FitOptions, readings: Sequence[FloatArray]) -> FloatArray:
    """(3,) of the gyro and the accelerometer's axes as declared, otherwise as neighbouring samples (N,) show them."""
    known = options.gyro_noise(), options.accel_noise(0), options.accel_noise(1)
    return np.array([max(white_noise_level(x), least) if level is None else level
                     for level, x, least in zip(known, readings, (1e-6, 1e-5, 1e-5), strict=True)])


def torque_levels(noise: Noise, mechanism: Mechanism) -> dict[str, float]:
    """The largest level of a driven joint, and where there are several those of all."""
    driven = sorted(mechanism.actuated)
    if not driven:
        return {}
    found = {"torque_nm": float(np.max(noise.torque[driven], initial=0.0))}
    return found | ({f"torque{j + 1}_nm": float(noise.torque[j]) for j in driven} if len(driven) > 1 else {})


def imu_levels(noise: Noise) -> dict[str, float]:
    """Noise levels of gyro and accelerometer: both axes together (rms), each axis, and their correlation."""
    levels = [{"gyro{}_radps": float(gyro), "accel{}_mps2": float(np.sqrt(np.mean(accel**2))),
               "accel{}_x_mps2": float(accel[0]), "accel{}_y_mps2": float(accel[1])}
              for gyro, accel in zip(noise.gyro, noise.accel)]
    found = {name.format(""): max(own[name] for own in levels) for name in levels[0]}
    if len(levels) > 1:
        found |= {name.format(k + 1): value for k, own in enumerate(levels) for name, value in own.items()}
    return found | ({"accel_correlation": noise.accel_correlation} if noise.accel_correlation else {})


def disturbance_levels(noise: Noise) -> dict[str, float]:
    """Level [N m] and time constant [s] of each joint's coloured disturbance, of the joints that have one."""
    return {name: float(value) for j in np.flatnonzero(noise.disturbance) for name, value in
            ((f"disturbance{j + 1}_nm", noise.disturbance[j]), (f"disturbance{j + 1}_s", noise.time_constant[j]))}


def unseen_levels(noise: Noise) -> dict[str, float]:
    """Level [N m] of each joint's torque between samples that no sample shows, of the joints that have one."""
    return {f"unseen{j + 1}_nm": float(noise.unseen[j]) for j in np.flatnonzero(noise.unseen)}


def unseen_text(noise: Noise, unit: str) -> str | None:
    """Sentence on it; None where there is none."""
    told = [f"{noise.unseen[j]:.2g} {unit} at joint {j + 1}" for j in np.flatnonzero(noise.unseen)]
    return ("torque acts between samples that no sample shows, as of a loop that is faster than the log: "
            f"{' and '.join(told)}; it counts as noise of the motion") if told else None


def colour(noise: Noise) -> str:
    """Whether noise is white, in words."""
    joints = [f"joint {j + 1} ({noise.disturbance[j]:.2g} over {noise.time_constant[j]:.2g} s)"
              for j in np.flatnonzero(noise.disturbance)]
    return f"white, with a coloured disturbance torque at {' and '.join(joints)}" if joints else "white"


def independence(options: FitOptions) -> str:
    """Assumption about the channels' noise at one time, in words."""
    declared = [name for name, given in (("the accelerometer's axes", bool(options.accel_correlation)),
                                         ("the torques", bool(options.torque_correlation))) if given]
    return "independent between channels" + (f", but for {' and '.join(declared)}, correlated as given"
                                             if declared else "")
