"""Records of a leg with one effect, made by other code than ours, and the size that a fit should find in them.

The plants share no code with the estimator. `evidence.blind.physics` has friction as a set-valued force, a
two-mass gear, LuGre bristles, a stop of Hunt and Crossley and a stand as a further body. MuJoCo takes a friction law.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from daq import Dataset, FloatArray
from evidence.blind.excite import Torque, draw
from evidence.blind.leg import Leg, stack
from evidence.blind.measure import RATE_HZ, Sensors, disturb, read
from evidence.blind.physics import integrate
from tests.support import mujoco_leg

LEG = Leg()
SENSORS = Sensors(process=0.0)
LEVELS = np.array([SENSORS.gyro, SENSORS.accel, SENSORS.accel, SENSORS.torque, SENSORS.count_rad / np.sqrt(12.0)])
"""Standard deviations of gyro, accelerometer (both axes), torque and encoder."""
COUNT = 600
RUNS = ("big", "slow", "small")
PEAK_NM = 0.6
GRID = np.arange(COUNT) / RATE_HZ
MOTOR_INERTIA = 2e-4
MOTOR_FRICTION = {"motor_viscous": float(LEG.viscous2), "motor_coulomb": float(LEG.coulomb2)}


@dataclass(frozen=True)
class HiddenEffect:
    """What is done to plant, torque and sensors, and the sizes by the names of the library."""

    sizes: Mapping[str, float]
    within: float = 0.05
    """Allowed error of each size, as a share of it."""
    plant: Mapping[str, float] = field(default_factory=dict)
    sense: Mapping[str, float] = field(default_factory=dict)
    acting: Callable[[Torque, FloatArray], FloatArray] = lambda torque, t: torque.at(t, PEAK_NM)
    """Torque on the knee at times t (N,) while the shunt shows the plan's."""
    law: Callable[[float, float, float, float], tuple[float, float]] | None = None
    """What MuJoCo adds to both torques, by angles and rates; the bench's integrator is not used then."""
    noise: float = 1.2
    """Largest estimated noise level over the true one, of all sensors: the effect explains the records."""
    begin: Mapping[str, float] = field(default_factory=dict)
    """Sizes and shapes at which the fit begins, by default zero and the middle of the grid."""


def _spring(stiffness: float, rest: float) -> HiddenEffect:
    return HiddenEffect({"stiffness": stiffness, "preload": stiffness * rest},
                        plant={"spring2": stiffness, "spring_rest2": rest})


def _stand(mass: float, stiffness: float, damping_ratio: float) -> HiddenEffect:
    whole = mass + float(LEG.m1) + float(LEG.m2)
    omega = float(np.sqrt(stiffness / whole))
    return HiddenEffect({"mobility": 1.0 / whole, "frequency": omega / (2.0 * np.pi)}, 0.1,
                        plant={"base_mass": mass, "base_stiffness": stiffness,
                               "base_damping": 2.0 * damping_ratio * omega * whole}, begin={"frequency": 2.0})


def _eccentric(amplitude: float, phase: float) -> HiddenEffect:
    sizes = {"sine_amplitude": amplitude * np.cos(phase), "cosine_amplitude": amplitude * np.sin(phase)}
    return HiddenEffect(sizes, 0.1, sense={"eccentricity": amplitude, "eccentricity_phase": phase})


def _bristles(deflection: float) -> HiddenEffect:
    """LuGre as the bench has it: bristles of this deflection at full slip carry the Coulomb level."""
    damping = 0.6 * np.sqrt(float(LEG.coulomb2) / deflection * float(LEG.beta()[1]) * 0.3)
    sizes = {"level": float(LEG.coulomb2), "bristle_damping": damping, "displacement": deflection}
    return HiddenEffect(sizes, 0.25, plant={"bristle2": deflection})


def _shaft(stiffness: float, damping: float, gap: float = 0.0) -> dict[str, float]:
    return {"shaft": stiffness, "shaft_damping": damping, "gap": gap, "motor_inertia": MOTOR_INERTIA}


def _stribeck(excess: float, speed: float) -> HiddenEffect:
    def law(q1: float, q2: float, v1: float, v2: float) -> tuple[float, float]:
        return 0.0, -excess * math.exp(-((v2 / speed) ** 2)) * math.tanh(v2 / 3e-3)

    return HiddenEffect({"excess_torque": excess, "stribeck_velocity": speed}, 0.2, law=law, begin={"exponent": 2.0})


# more noise than there is: contact between samples (backlash), Hertz's law (end stop), a second harmonic (ripple), and
# an acceleration that the likelihood iterates too few times for a rotor of a fifth of its link's inertia
LATE_S, LEVEL_NM = 0.008, 0.8
HIDDEN = {
    "accelerometer_bias": HiddenEffect({"bias_x": 0.3, "bias_y": -0.2}, sense={"accel_bias_x": 0.3,
                                                                              "accel_bias_y": -0.2}),
    "asymmetric_friction": HiddenEffect({"coulomb_difference": 0.08, "viscous_difference": 0.03}, 0.15,
                                        plant={"asymmetry2": 0.08, "asymmetric_drag2": 0.03}),
    "backlash": HiddenEffect({"gap": 0.08, **MOTOR_FRICTION}, 0.15, plant=_shaft(200.0, 0.12, 0.08),
                             noise=10.0, begin={"gap": 0.1, "contact_torque": 0.02}),
    "base_compliance": _stand(4.0, 1200.0, 0.1),
    "encoder_eccentricity": _eccentric(0.05, 0.7),
    "encoder_offset": HiddenEffect({"offset": 0.04}, sense={"encoder_offset": 0.04}),
    "encoder_scale": HiddenEffect({"scale_error": 0.05}, sense={"encoder_scale": 0.05}),
    "end_stop_contact": HiddenEffect({"angle": 0.5}, noise=2.5, plant={
        "stop_angle": 0.5, "stop_side": 1.0, "stop_stiffness": 40.0, "stop_damping": 0.15}),
    "friction_drift": HiddenEffect({"change": -0.1}, 0.2, plant={"warmup": 0.1, "warmup_time": 10.0}),
    "gyro_bias": HiddenEffect({"bias": 0.05}, sense={"gyro_bias": 0.05}),
    "gyro_scale": HiddenEffect({"scale_error": 0.05}, sense={"gyro_scale": 0.05}),
    "imu_lever_arm": HiddenEffect({"excess": 0.03}, sense={"lever": 0.03}),
    "imu_misalignment": HiddenEffect({"angle": -0.05}, sense={"misalignment": 0.05}),
    "joint_elasticity": HiddenEffect({"compliance": 0.1, **MOTOR_FRICTION}, 0.15, plant=_shaft(10.0, 0.003)),
    "joint_stiffness": _spring(0.3, 0.2),
    "load_dependent_friction": HiddenEffect({"load_coefficient": 0.25}, 0.08, plant={"load2": 0.25}),
    "presliding_friction": _bristles(0.1),
    "quadratic_drag": HiddenEffect({"drag": 0.02}, plant={"drag2": 0.02}),
    "rotor_inertia": HiddenEffect({"inertia": 0.005}, 0.2, noise=4.0, plant={"rotor": 0.005, "gear": 50.0}),
    "sensor_time_skew": HiddenEffect({"skew": 0.006}, sense={"skew": 0.006}),
    "stribeck_friction": _stribeck(0.1, 0.3),
    "torque_delay": HiddenEffect({"delay": LATE_S}, acting=lambda torque, t: torque.at(t + LATE_S, PEAK_NM)),
    "torque_offset": HiddenEffect({"offset": -0.05}, acting=lambda torque, t: torque.at(t, PEAK_NM) + 0.05),
    "torque_ripple": HiddenEffect({"sine_amplitude": 0.08, "order": 2.0}, noise=2.0, plant={
        "ripple": 0.08, "ripple_order": 2.0, "ripple_phase": 0.0, "gear": 50.0}, begin={"order": 2.0}),
    "torque_saturation": HiddenEffect({"cubic_shortfall": 1.0 / (3.0 * LEVEL_NM**2)}, 0.25, acting=lambda torque, t:
                                      LEVEL_NM * np.tanh(torque.at(t, PEAK_NM) / LEVEL_NM)),
}


def record_hidden(names: Sequence[str]) -> dict[str, list[Dataset]]:
    """Three runs of 6 s of the leg with each of the effects alone, by its name."""
    rng = np.random.default_rng(21)
    plans = [draw(rng, kind) for kind in RUNS]
    benched = [name for name in names if HIDDEN[name].law is None]
    out = _integrated(benched, plans) if benched else {}
    return out | {name: _by_mujoco(name, plans) for name in names if name not in out}


def _by_mujoco(name: str, plans: Sequence[Torque]) -> list[Dataset]:
    runs = [mujoco_leg.record(mujoco_leg.Leg(), np.random.default_rng([21, k]), seconds=COUNT / RATE_HZ,
                              tau=plan.at(GRID, PEAK_NM), law=HIDDEN[name].law, name=f"r{k + 1}")
            for k, plan in enumerate(plans)]
    return [replace(run, columns={c: v for c, v in run.columns.items() if c != "q1_rad"}) for run in runs]


def _integrated(names: Sequence[str], plans: Sequence[Torque]) -> dict[str, list[Dataset]]:
    """All in one integration, a lane a run."""
    lanes = [(HIDDEN[name], k, plan) for name in names for k, plan in enumerate(plans)]
    acting = np.array([hidden.acting(plan, GRID) for hidden, _, plan in lanes])
    plant = {
        key: np.array([hidden.plant.get(key, 0.0) for hidden, _, _ in lanes])
        for key in sorted({key for hidden, _, _ in lanes for key in hidden.plant})}
    late = np.array([i for i, (hidden, _, _) in enumerate(lanes) if "skew" in hidden.sense], dtype=np.intp)
    motion = integrate(stack([LEG] * len(lanes)), acting.T, step=1e-3, extra=plant, fast=late,
                       session=np.array([k * COUNT / RATE_HZ for _, k, _ in lanes]))
    out: dict[str, list[Dataset]] = {name: [] for name in names}
    for i, (hidden, k, plan) in enumerate(lanes):
        noise, shown = np.random.default_rng([21, k]), plan.at(GRID, PEAK_NM)
        columns = disturb(read(motion, i, shown, hidden.sense, SENSORS), SENSORS.torque * noise.normal(size=COUNT),
                          SENSORS, noise)
        time_s = columns.pop("time_s")
        out[names[i // len(plans)]].append(Dataset(f"r{k + 1}", RATE_HZ, time_s, columns))
    return out
