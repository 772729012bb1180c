"""Random legs with effects, simulated by legid and by the folder that `legid export --to mujoco` writes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

from daq import Dataset, FloatArray
from daq.recording import Plan
from experiments.models import EffectValue, Model, known_effects, load_model
from experiments.simulators import ExportedLeg, Piece, Record
from experiments.workflows import simulate_run
from tests.support.models import LEG, write_model
from tests.support.mujoco_leg import random_leg

RATE_HZ = 500.0
START = [0.4, -0.3]
REACH = ((-1.0, 1.0), (-0.6, 0.6))


class Case(NamedTuple):
    """One effect: sizes, shapes, and its joint where it has one."""

    sizes: Mapping[str, float]
    shapes: Mapping[str, float] = {}
    joint: int = 2


EFFECTS = {
    "joint_stiffness": Case({"stiffness": 0.4, "preload": 0.1}, joint=1), "quadratic_drag": Case({"drag": 0.004}),
    "rotor_inertia": Case({"inertia": 0.004}), "torque_offset": Case({"offset": 0.05}),
    "imu_lever_arm": Case({"excess": 0.01}), "imu_misalignment": Case({"angle": 0.05}),
    "stribeck_friction": Case({"excess_torque": 0.03}, {"stribeck_velocity": 0.2, "exponent": 2.0}),
    "asymmetric_friction": Case({"coulomb_difference": 0.02, "viscous_difference": 0.01}),
    "load_dependent_friction": Case({"load_coefficient": 0.08}),
    "load_stribeck_friction": Case({"load_coefficient": 0.08}, {"stribeck_velocity": 0.4, "exponent": 2.0}),
    "quadratic_load_friction": Case({"load_coefficient": 0.08}),
    "directional_load_friction": Case({"load_coefficient": 0.08, "coefficient_near_rest": 0.04},
                                      {"load_share": 0.4, "stribeck_velocity": 0.3}),
    "presliding_friction": Case({"level": 0.03, "bristle_damping": 0.005}, {"displacement": 0.03}),
    "friction_drift": Case({"change": 0.03, "change_per_minute_within_runs": 0.1}, {"time_constant": 30.0}),
    "joint_elasticity": Case({"compliance": 0.01, "motor_viscous": 0.01, "motor_coulomb": 0.01,
                              "motor_inertia": 0.001}),
    "backlash": Case({"gap": 0.01, "motor_viscous": 0.01, "motor_coulomb": 0.01, "motor_inertia": 0.001},
                     {"contact_torque": 0.1}),
    "end_stop_contact": Case({"stiffness": 4.0}, {"angle_share": 0.65}),
    "base_compliance": Case({"mobility": 0.1}, {"frequency": 4.9, "damping_ratio": 0.1}),
    "torque_ripple": Case({"sine_amplitude": 0.03, "cosine_amplitude": 0.02}, {"order": 6.0}),
    "torque_saturation": Case({"cubic_shortfall": 0.3}), "torque_delay": Case({"delay": -0.012}),
    "sensor_time_skew": Case({"skew": 0.008}), "gyro_bias": Case({"bias": 0.01}),
    "gyro_scale": Case({"scale_error": 0.02}), "accelerometer_bias": Case({"bias_x": 0.1, "bias_y": -0.1}),
    "encoder_offset": Case({"offset": 0.02}), "encoder_scale": Case({"scale_error": 0.02}),
    "encoder_eccentricity": Case({"sine_amplitude": 0.02, "cosine_amplitude": 0.01})}
OPPOSITE = {"torque_delay": Case({"delay": 0.012}), "sensor_time_skew": Case({"skew": -0.008})}
"""Delays of the other sign."""
PAIRS = (("torque_delay", "sensor_time_skew"), ("stribeck_friction", "presliding_friction"),
         ("load_dependent_friction", "torque_saturation"), ("base_compliance", "torque_ripple"),
         ("joint_elasticity", "encoder_eccentricity"), ("asymmetric_friction", "friction_drift"),
         ("torque_offset", "load_dependent_friction"), ("end_stop_contact", "joint_stiffness"),
         ("backlash", "encoder_scale"), ("torque_delay", "load_dependent_friction"))


def model_of(folder: Path, seed: int, names: Sequence[str], cases: Mapping[str, Case] = EFFECTS,
             smoothing: float = 0.005, **more: Any) -> Model:
    """A random leg with effects."""
    beta = list(random_leg(seed).beta())
    model = load_model(write_model(folder / "m.json", beta, {**LEG, "friction_velocity_radps": smoothing}))
    effects = tuple(EffectValue(name=name, joint=cases[name].joint if known_effects()[name].per_joint else None,
                                sizes=dict(cases[name].sizes), shapes=dict(cases[name].shapes)) for name in names)
    count = len(beta) + sum(len(e.sizes) + len(e.shapes) for e in effects)
    return structs.replace(model, effects=effects, reach=REACH, covariance=((0.0,) * count,) * count, **more)


def simulated(model: Model, seconds: float = 5.0, peak: float = 0.4) -> Dataset:
    """Run by `legid simulate`; the torque begins at zero, so that a delay knows what was before."""
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    rise = np.clip((t - 0.05) / 0.1, 0.0, 1.0) ** 2
    return simulate_run(model, Plan(t, rise * peak * (np.sin(5 * t) + 0.5 * np.sin(11 * t + 1))), "m.json", RATE_HZ,
                        START)


def in_mujoco(model: Model, run: Dataset, step_s: float) -> Mapping[str, FloatArray]:
    """The same run by the exported folder, under the torque as it was measured."""
    record = Record(run.time_s, np.asarray(run["tau2_nm"])[:, None])
    return ExportedLeg(model, "m.json").run(record, Piece(0, len(run), np.array(START), np.zeros(2)), step_s)


def angle_error(model: Model, step_s: float) -> float:
    """Largest difference of an angle's reading between both [rad]."""
    run = simulated(model, 5.0)
    found = in_mujoco(model, run, step_s)
    assert np.ptp(run["q2_rad"]) > 0.4  # it does move
    return max(float(np.abs(found[c] - run[c]).max()) for c in ("q1_rad", "q2_rad"))
