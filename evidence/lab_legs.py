"""Legs with everything wrong at once, each fault drawn from its default tolerance: MuJoCo under a position servo.

The laws are those of the effects, written out anew; the readings are changed as `servo` changes them.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.random import Generator

from daq import FloatArray
from estimator.score import default_tolerances
from evidence.blind import servo
from evidence.known_legs import KnownLeg, read_leg, truth_of

Faults = Mapping[str, FloatArray]
"""Effect -> (joints, sizes): one row for each joint, or one for all of the rig."""
STIFFNESS = "joint_stiffness"
POSITIVE = ("joint_stiffness", "quadratic_drag", "load_dependent_friction", "stribeck_friction", "rotor_inertia")
"""Effects whose first size is not below zero."""


def drawn(rng: Generator, times: float = 1.0) -> Faults:
    """Sizes of every effect with a tolerance, normal with `times` its standard deviation."""
    found = {}
    for name, sizes in default_tolerances().items():
        found[name] = times * np.array(sizes) * rng.normal(size=(2, len(sizes)))
        if name in POSITIVE:
            found[name][:, 0] = np.abs(found[name][:, 0])
    return found


def plant_of(faults: Faults, rng: Generator) -> servo.Plant:
    """The plant with these faults; those that MuJoCo or the readings do not have are left out."""
    phase = rng.uniform(0.0, 2.0 * np.pi)

    def of_rig(name: str) -> float:
        """The one size of an effect of the rig."""
        return float(faults[name][0, 0])

    def law(q: FloatArray, v: FloatArray, u: float, t: float) -> tuple[float, float]:
        sign = np.clip(v / 0.01, -1.0, 1.0)
        k, c = faults[STIFFNESS].T
        coulomb, viscous = faults["asymmetric_friction"].T
        forward = 0.5 * (1.0 + sign)
        torque = -(k * q - c) - faults["quadratic_drag"][:, 0] * v * np.abs(v) - forward * (coulomb + viscous * v)
        torque -= faults["stribeck_friction"][:, 0] * np.exp(-(v / 0.2) ** 2) * sign
        torque[1] -= faults["load_dependent_friction"][1, 0] * abs(u) * sign[1]
        torque[1] += np.hypot(*faults["torque_ripple"][1]) * np.sin(servo.GEAR * q[1] + phase)
        return float(torque[0]), float(torque[1])

    def logged(columns: servo.Readings) -> None:
        step = float(columns["time_s"][1])
        rate = columns["gyro_radps"].copy()
        x, y = (columns[name] for name in ("accel_x_mps2", "accel_y_mps2"))
        excess, angle = of_rig("imu_lever_arm"), of_rig("imu_misalignment")
        columns |= {"accel_x_mps2": x + excess * np.gradient(rate, step), "accel_y_mps2": y - excess * rate**2}
        servo.turned(angle)(columns)
        for name, bias in zip(("accel_x_mps2", "accel_y_mps2"), faults["accelerometer_bias"][0]):
            columns[name] += bias
        columns["gyro_radps"] = (1.0 + of_rig("gyro_scale")) * rate + of_rig("gyro_bias")
        q = columns["q2_rad"]
        sine, cosine = faults["encoder_eccentricity"][1]
        columns["q2_rad"] = ((1.0 + faults["encoder_scale"][1, 0]) * q + faults["encoder_offset"][1, 0]
                             + sine * np.sin(q) + cosine * (np.cos(q) - 1.0))
        torque = columns["tau2_nm"]
        torque = torque + of_rig("torque_saturation") * torque**3
        columns["tau2_nm"] = (1.0 + of_rig("torque_gain")) * torque + of_rig("torque_offset")

    late = {"tau2_nm": of_rig("torque_delay"),
            **dict.fromkeys(("gyro_radps", "accel_x_mps2", "accel_y_mps2"), of_rig("sensor_time_skew"))}
    return servo.Plant(armature=faults["rotor_inertia"][1, 0], law=law, logged=logged, late_s=late)


def lab_leg(hidden: str, rng: Generator, folder: Path, times: float = 1.0) -> KnownLeg:
    """A leg whose faults are drawn from `times` the tolerances; nothing else is hidden."""
    bare = servo.draw(rng)
    leg = servo.write_plant("leg", 0, folder, plant_of(drawn(rng, times), rng), [], *bare, rng)
    return read_leg(folder / "leg-0", truth_of(leg.beta()))
