"""`noisy_sensors`: sensors whose noise a fit finds larger than the rig declares, or than neighbouring samples show.

An error unlike every listed term can end up in the noise levels. Then all scores are small, but a gyro with 5 mrad/s
of noise has a residual of 95.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.diagnosis.decision_rule import EDGE
from estimator.diagnosis.model import Model, refit
from estimator.fitting import TORQUE_SHARE, mistaken_torques
from estimator.options import accel_level, encoder_level, gyro_level
from estimator.signals import Channel, encoder_of, imu_channels


def declared_levels(model: Model) -> dict[Channel, float | None]:
    """Channel of each encoder and IMU to the noise that the rig declares for it; None where it declares none."""
    known, problem = model.split.known, model.problem
    out = {encoder_of(j): encoder_level(known, j) or None for j in map(int, np.flatnonzero(problem.has_encoder))}
    for k in range(problem.imu_count):
        levels = gyro_level(known, k), accel_level(known, 0, k), accel_level(known, 1, k)
        out |= {channel: level or None for channel, level in zip(imu_channels(k), levels, strict=True)}
    return out


def noise_ratios(model: Model) -> dict[Channel, tuple[float, float]]:
    """Channel of an encoder or IMU to its fitted noise over what is usual for it, and the most that this may be.

    Usual is what the rig declares, up to EDGE times; else what neighbouring samples show, which is itself known to
    EDGE only.
    """
    problem, noise = model.problem, model.state.noise
    shown = problem.shown
    fitted = {encoder_of(j): (noise.encoder[j], shown.encoder[j])
              for j in map(int, np.flatnonzero(problem.has_encoder))}
    for k in range(problem.imu_count):
        levels = zip((noise.gyro[k], *noise.accel[k]), (shown.gyro[k], *shown.accel[k]), strict=True)
        fitted |= dict(zip(imu_channels(k), levels, strict=True))
    declared = declared_levels(model)
    return {channel: (float(level) / (declared[channel] or max(1e-12, float(usual))),
                      EDGE**2 if declared[channel] is None else EDGE) for channel, (level, usual) in fitted.items()}


def in_words(channel: Channel, ratio: float) -> str:
    """Residual of a channel in units of its noise, in words."""
    joint = (channel.joint or 0) + 1
    name = {"torque": f"torque at joint {joint}", "encoder": f"encoder of joint {joint}", "gyro": "gyro",
            "accel_x": "accelerometer's x axis", "accel_y": "accelerometer's y axis"}[channel.kind]
    return f"the residual of the {name} is {ratio:.1f} times its noise"


def noisy_sensors(model: Model) -> dict[Channel, float]:
    """Ratios of `noise_ratios` that are larger than they may be: sensors of motion that are too noisy."""
    return {channel: ratio for channel, (ratio, most) in noise_ratios(model).items() if ratio > most}


def with_declared_noise(model: Model) -> Model:
    """`model` fitted again, its noisy sensors held at the noise that they are known to have. Raises `FitError`."""
    noise = model.state.noise
    levels = {encoder_of(j): (f"encoder{j + 1}_rad", level) for j, level in enumerate(noise.encoder)}
    for k, (gyro, accel) in enumerate(zip(noise.gyro, noise.accel)):
        names = f"gyro{k + 1}_radps", f"accel{k + 1}_x_mps2", f"accel{k + 1}_y_mps2"
        levels |= dict(zip(imu_channels(k), zip(names, (gyro, *accel)), strict=True))
    held = {levels[channel][0]: float(levels[channel][1]) / ratio for channel, ratio in noisy_sensors(model).items()}
    split = replace(model.split, options=replace(model.split.options, noise=held))
    state = replace(model.state, noise=noise.with_declared(held, ()))
    return refit(replace(model, split=split, state=state), list(zip(model.effects, model.sizes())))


def noise_dominated(nominal: Model) -> str:
    """Says so where the nominal fit takes as much of a measured torque for noise as a fit may; else empty.

    What is missing can hide in so much noise, and a re-fit that needs as much is refused: nothing found then does not
    mean that nothing is wrong.
    """
    split = nominal.split
    floors = split.floors(nominal.problem, nominal.state.beta)
    joints = mistaken_torques(nominal.problem, nominal.state, floors)
    if not joints:
        return ""
    share, rate = 100 * TORQUE_SHARE, split.runs[0][0].rate_hz
    where = " and ".join(str(j + 1) for j in joints)
    return (f"the nominal fit assigns {share:.0f} % of the torque of joint {where} to noise, its upper limit; lower "
            f"rate_hz under [sampling] if the angles are too coarse for a torque at {rate:g} Hz")
