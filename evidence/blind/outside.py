"""Ten causes that no effect of the library describes, on the servo's legs of MuJoCo.

They were written after the rule of the diagnosis was settled, and none served to settle it. Right is `unexplained`, or
`partial` without a wrong name; `none` is right where the error is within 1.5 times what noise leaves.
"""

from collections.abc import Callable

import numpy as np

from evidence.blind import servo
from evidence.blind.servo import Plant, Readings, at_knee, changed


def _feels_gravity(columns: Readings) -> None:
    columns["gyro_radps"] = columns["gyro_radps"] + 0.006 * columns["accel_x_mps2"]


MAKERS: dict[str, Callable[[float], Plant]] = {
    "outside_dead_band": lambda s: at_knee(lambda q, v, u, t: -float(np.clip(u, -0.12 * s, 0.12 * s))),
    "outside_brownout": lambda s: at_knee(lambda q, v, u, t: -u * (t % 3.0 < 0.06 * s)),
    "outside_copper_heat": lambda s: at_knee(lambda q, v, u, t: -0.25 * s * u * (1.0 - np.exp(-t / 60.0))),
    "outside_coupling_spring": lambda s: Plant(
        law=lambda q, v, u, t: (-0.25 * s * (q[0] - q[1]), 0.25 * s * (q[0] - q[1]))),
    "outside_shaker": lambda s: at_knee(lambda q, v, u, t: 0.1 * s * np.sin(2.0 * np.pi * 4.3 * t)),
    "outside_eddy_brake": lambda s: at_knee(lambda q, v, u, t: -0.15 * s * v[1] / (1.0 + (v[1] / 1.5) ** 2)),
    # it rubs harder where the load drives the motor
    "outside_worm": lambda s: at_knee(lambda q, v, u, t: -0.25 * abs(u) * servo._sign(v[1]) * (u * v[1] < 0.0)),
    "outside_encoder_cubic": lambda s: Plant(logged=changed("q2_rad", lambda q: q + 0.04 * q**3)),
    "outside_gyro_feels_gravity": lambda s: Plant(logged=_feels_gravity),
    "outside_accelerometer_clips": lambda s: Plant(logged=changed("accel_y_mps2", lambda a: np.maximum(a, -9.6))),
}

