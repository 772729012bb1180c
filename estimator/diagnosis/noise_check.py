"""`excess_noise`: channels whose noise a fit finds larger than the rig declares, or than neighbouring samples show.

A model that lacks something unlike every listed term can leave it to the noise levels: each score is then small beside
scores that scatter, and yet a gyro that is good to 5 mrad/s errs by 95.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from estimator.diagnosis.data_split import RunSplit
from estimator.diagnosis.refit import Model
from estimator.fitting import TORQUE_SHARE, mistakes_torque
from estimator.options import accel_level, encoder_level, torque_level
from estimator.signals import white_noise_level

SENSOR, UNDECLARED, TORQUE = 1.3, 2.0, 1.6
"""How many times its level a channel may have: of a declared sensor, of one that is judged by its neighbouring samples,
and of torque, for a room and a motor add some to the shunt's noise."""
SHARE = 0.2
"""... or this share of what the nominal fit had beyond its level, in variance: functional forms differ."""


def ratios(split: RunSplit, model: Model) -> dict[str, tuple[float, float]]:
    """Channel in words to (noise found over its level, most it may be); no undeclared torques nor encoders."""
    known, noise = split.known, model.state.noise
    out: dict[str, tuple[float, float]] = {}
    driven = [torque_level(known, j, True) for j in split.mechanism.actuated]
    for j, level in enumerate(noise.torque):
        declared = torque_level(known, j, j in split.mechanism.actuated)
        if declared is None and j in split.mechanism.passive:  # it lacks no more than motors' sensors err by
            declared = max((d for d in driven if d is not None), default=None)
        if declared is not None:
            out[f"torque at joint {j + 1}"] = float(level) / declared, TORQUE
    return out | motion_ratios(split, model)


def motion_ratios(split: RunSplit, model: Model, undeclared: bool = False) -> dict[str, tuple[float, float]]:
    """`ratios` of encoders and IMU; `undeclared` encoders by what their neighbouring samples show."""
    known, problem, noise = split.known, model.problem, model.state.noise
    out: dict[str, tuple[float, float]] = {}
    for j in map(int, np.flatnonzero(problem.has_encoder)):
        level, declared = float(noise.encoder[j]), encoder_level(known, j)
        if declared:
            out[f"encoder of joint {j + 1}"] = level / declared, SENSOR
        elif undeclared:
            out[f"encoder of joint {j + 1}"] = level / max(1e-12, float(problem.shown.encoder[j])), UNDECLARED
    if problem.has_imu:
        seen = [("gyro", noise.gyro, problem.gyro, known.get("gyro_radps"))]
        seen += [(f"accelerometer's {axis} axis", noise.accel[i], readings, accel_level(known, i))
                 for i, (axis, readings) in enumerate((("x", problem.ax), ("y", problem.ay)))]
        for name, level, readings, declared in seen:
            if declared is None:
                out[name] = float(level) / max(1e-12, white_noise_level(readings)), UNDECLARED
            else:
                out[name] = float(level) / declared, SENSOR
    return out


def excess_noise(split: RunSplit, model: Model, before: Mapping[str, tuple[float, float]] | None = None) -> str:
    """The loudest channel in words; empty where none is too loud, beside what it was `before` if that is given."""
    worst, text = 1.0, ""
    for name, (ratio, limit) in ratios(split, model).items():
        rough = [f for e in model.effects for channel, f in e.rough.items() if name.startswith(channel)]
        allowed = math.prod([limit, *rough]) ** 2
        if before is not None:
            allowed = max(allowed, 1.0 + SHARE * (before[name][0] ** 2 - 1.0))
        if ratio**2 > worst * allowed:
            worst, text = ratio**2 / allowed, f"what is left in the {name} is {ratio:.1f} times its noise"
    return text


def hidden_motion(split: RunSplit, model: Model) -> str:
    """Which sensor of motion a fit takes for louder than the rig declares, or than its neighbouring samples show, in
    words; empty where none is.

    Errors of free runs are held against what this noise leaves, and vanish beside it. A torque that wanders is louder
    on healthy legs, too. (Measured: a load that swings on the link left 29 mrad to an encoder good to 0.4, and free
    runs erred 0.95 times as much as that noise alone; on 50 other legs the share is 0.7 to 1.7, with a soft gear 12.)
    """
    found = motion_ratios(split, model, undeclared=True)
    name, (ratio, limit) = max(found.items(), key=lambda f: f[1][0] / f[1][1], default=("", (0.0, 1.0)))
    return f"what is left in the {name} is {ratio:.1f} times its noise" if ratio > limit else ""


def noise_dominated(split: RunSplit, nominal: Model) -> str:
    """Says so where the nominal fit takes as much of a measured torque for noise as a fit may; else empty.

    What is missing can hide in so much noise, and a re-fit that needs as much is refused: nothing found then does not
    mean that nothing is wrong.
    """
    floors = split.floors(nominal.problem, nominal.state.beta)
    if not mistakes_torque(nominal.problem, nominal.state, floors):
        return ""
    share, rate = 100 * TORQUE_SHARE, split.runs[0][0].rate_hz
    return (f"the nominal fit leaves {share:.0f} % of a measured torque to noise, the most that it may; if the angles "
            f"are too coarse to check torque at {rate:g} Hz, a lower rate_hz under [sampling] leaves less")
