"""What the bench can hide: the contract's 25 effects in forms of their own, and others that no library lists.

Every effect is made by one function of a strength and a seeded generator; it says what it does to the plant, to
the torque and to the sensors, and the sizes that a diagnosis should state. A strength grows with the effect; for
effects whose size shrinks as they grow (a shaft's stiffness, a saturation level) it is the inverse of that size.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator

GEAR = 50.0


@dataclass(frozen=True)
class Size:
    """One size of a hidden effect, in the unit of the contract."""

    name: str
    unit: str
    value: float


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: coefficients for `physics.integrate`, for the torque and for the sensors."""

    joint: int | None
    sizes: tuple[Size, ...]
    plant: Mapping[str, float] = field(default_factory=dict)
    drive: Mapping[str, float] = field(default_factory=dict)
    sense: Mapping[str, float] = field(default_factory=dict)
    leg: Mapping[str, float] = field(default_factory=dict)
    """Factors on the leg's masses from the fifth run on."""
    also: tuple[tuple[str, int | None], ...] = ()
    """Effects that are truly there too, if small: naming them beside this one is not wrong."""


Maker = Callable[[float, Generator], Hidden]


def _sign(rng: Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _plain(where: str, key: str, size: str, unit: str, joint: int | None = None, signed: bool = False,
           absolute: bool = False) -> Maker:
    """An effect whose strength, with a drawn sign if `signed`, is a coefficient of `where` and its one size, which is
    stated without the sign if `absolute`."""
    def make(strength: float, rng: Generator) -> Hidden:
        value = strength * _sign(rng) if signed else strength
        more: dict[str, Any] = {where: {key: value}}
        return Hidden(joint, (Size(size, unit, strength if absolute else value),), **more)
    return make


def stribeck_friction(strength: float, rng: Generator) -> Hidden:
    speed = rng.uniform(0.15, 0.5)
    return Hidden(2, (Size("excess_torque", "N m", strength), Size("stribeck_velocity", "rad/s", speed)),
                  plant={"stribeck2": strength, "stribeck_velocity2": speed})


def asymmetric_friction(strength: float, rng: Generator) -> Hidden:
    # the contract's F*max(s, 0) and Fv by direction. F alone is, term for term, a Coulomb level and an offset of the
    # torque: nothing could tell them apart. A negative F would make friction drive the joint, so the sign stays
    viscous = strength / rng.uniform(2.0, 6.0)
    return Hidden(2, (Size("coulomb_difference", "N m", strength),
                      Size("viscous_difference", "N m s/rad", float(viscous))),
                  plant={"asymmetry2": strength, "asymmetric_drag2": float(viscous)})


def quadratic_drag(strength: float, rng: Generator) -> Hidden:
    joint = int(rng.choice((1, 2)))
    # the pivot turns at a third of the knee's rate and carries more: equally visible at twelve times the size
    value = strength * (12.0 if joint == 1 else 1.0)
    return Hidden(joint, (Size("coefficient", "N m s^2/rad^2", value),),
                  plant={f"drag{joint}": value})


def friction_drift(strength: float, rng: Generator) -> Hidden:
    span = rng.uniform(60.0, 140.0)
    return Hidden(2, (Size("change", "N m", strength), Size("time_constant", "s", span)),
                  plant={"warmup": strength, "warmup_time": span})


def joint_stiffness(strength: float, rng: Generator) -> Hidden:
    joint = int(rng.choice((1, 2)))
    rest = rng.uniform(-0.4, 0.4)
    return Hidden(joint, (Size("stiffness", "N m/rad", strength), Size("rest_angle", "rad", rest)),
                  plant={f"spring{joint}": strength, f"spring_rest{joint}": rest})


# small, so that it is no effect of its own beside the shaft's
MOTOR_INERTIA = 2e-4


def joint_elasticity(strength: float, rng: Generator) -> Hidden:
    stiffness = 1.0 / strength
    damping = rng.uniform(0.05, 0.15) * 2.0 * np.sqrt(stiffness * MOTOR_INERTIA)
    return Hidden(2, (Size("stiffness", "N m/rad", stiffness),),
                  plant={"shaft": stiffness, "shaft_damping": float(damping), "motor_inertia": MOTOR_INERTIA},
                  also=(("rotor_inertia", None),))


def backlash(strength: float, rng: Generator) -> Hidden:
    stiffness = rng.uniform(150.0, 300.0)
    damping = 0.3 * 2.0 * np.sqrt(stiffness * MOTOR_INERTIA)
    return Hidden(2, (Size("gap", "rad", strength),),
                  plant={"shaft": stiffness, "shaft_damping": float(damping), "gap": strength,
                         "motor_inertia": MOTOR_INERTIA},
                  also=(("rotor_inertia", None), ("joint_elasticity", 2)))


def rotor_inertia(strength: float, rng: Generator) -> Hidden:
    return Hidden(None, (Size("inertia", "kg m^2", strength),),
                  plant={"rotor": strength, "gear": GEAR})


def end_stop_contact(strength: float, rng: Generator) -> Hidden:
    """Strength: how far the stop stands inside +-1.6 rad, as a share of it."""
    side = _sign(rng)
    angle = side * 1.6 * (1.0 - strength)
    return Hidden(2, (Size("angle", "rad", angle),),
                  plant={"stop_angle": angle, "stop_side": side, "stop_stiffness": rng.uniform(20.0, 60.0),
                         "stop_damping": 0.15})


def base_compliance(strength: float, rng: Generator) -> Hidden:
    stiffness = 1.0 / strength
    mass = rng.uniform(3.0, 6.0)
    damping = rng.uniform(0.05, 0.15) * 2.0 * np.sqrt(stiffness * (mass + 2.0))
    return Hidden(None, (Size("stiffness", "N/m", stiffness), Size("mass", "kg", mass)),
                  plant={"base_mass": mass, "base_stiffness": stiffness, "base_damping": float(damping)})


def torque_ripple(strength: float, rng: Generator) -> Hidden:
    order = float(rng.choice((1, 2)))
    return Hidden(2, (Size("amplitude", "N m", strength), Size("order", "1", order)),
                  plant={"ripple": strength, "ripple_order": order, "ripple_phase": rng.uniform(0, 2 * np.pi),
                         "gear": GEAR})


def torque_offset(strength: float, rng: Generator) -> Hidden:
    value = strength * _sign(rng)
    # stated as the reading's: the shunt shows that much less than acts
    return Hidden(None, (Size("offset", "N m", -value),), drive={"offset": value})


def torque_saturation(strength: float, rng: Generator) -> Hidden:
    return Hidden(None, (Size("level", "N m", 1.0 / strength),),
                  drive={"saturation": 1.0 / strength})


def accelerometer_bias(strength: float, rng: Generator) -> Hidden:
    angle = rng.uniform(0, 2 * np.pi)
    x, y = strength * np.cos(angle), strength * np.sin(angle)
    return Hidden(None, (Size("bias_x", "m/s^2", float(x)), Size("bias_y", "m/s^2", float(y))),
                  sense={"accel_bias_x": float(x), "accel_bias_y": float(y)})


def imu_misalignment(strength: float, rng: Generator) -> Hidden:
    value = strength * _sign(rng)
    # stated in the sense of q1, which turns the link the other way under its sensor's axes
    return Hidden(None, (Size("angle", "rad", -value),), sense={"misalignment": value})


def encoder_eccentricity(strength: float, rng: Generator) -> Hidden:
    phase = rng.uniform(0, 2 * np.pi)
    return Hidden(2, (Size("amplitude", "rad", strength), Size("phase", "rad", phase)),
                  sense={"eccentricity": strength, "eccentricity_phase": phase})


# ---- outside the library -------------------------------------------------------------------------------------


def swaying_gravity(strength: float, rng: Generator) -> Hidden:
    """The floor under the rig tilts slowly to and fro."""
    return Hidden(None, (Size("amplitude", "rad", strength),),
                  plant={"tilt": strength, "tilt_rate": rng.uniform(0.5, 1.5), "tilt_phase": rng.uniform(0, 6.28)})


def sloshing_payload(strength: float, rng: Generator) -> Hidden:
    rate = rng.uniform(6.0, 14.0)
    return Hidden(2, (Size("inertia", "kg m^2", strength), Size("rate", "rad/s", rate)),
                  plant={"slosh": strength, "slosh_stiffness": strength * rate**2,
                         "slosh_damping": 0.04 * strength * rate})


def cable_hysteresis(strength: float, rng: Generator) -> Hidden:
    return Hidden(1, (Size("torque", "N m", strength),),
                  plant={"cable": strength, "cable_yield": rng.uniform(0.1, 0.3)},
                  also=(("presliding_friction", 1), ("joint_stiffness", 1)))


def encoder_interpolation(strength: float, rng: Generator) -> Hidden:
    return Hidden(2, (Size("amplitude", "rad", strength),),
                  sense={"interpolation": strength, "interpolation_order": float(rng.integers(8, 17)),
                         "interpolation_phase": rng.uniform(0, 6.28)})


def angle_dependent_friction(strength: float, rng: Generator) -> Hidden:
    """A bent shaft or a tight gear: friction that depends on where the knee is."""
    return Hidden(2, (Size("amplitude", "N m", strength),),
                  plant={"angle_friction": strength, "angle_order": float(rng.integers(2, 6)),
                         "angle_phase": rng.uniform(0, 6.28)})


def loose_payload(strength: float, rng: Generator) -> Hidden:
    """A part of link 2 falls off between the fourth and the fifth run."""
    return Hidden(None, (Size("share", "1", strength),), leg={"m2": 1.0 - strength})


PLAIN: dict[str, Maker] = {
    "load_dependent_friction": _plain("plant", "load2", "coefficient", "1", 2),
    "presliding_friction": _plain("plant", "bristle2", "deflection", "rad", 2),
    "torque_delay": _plain("drive", "delay", "delay", "s"), "sensor_time_skew": _plain("sense", "skew", "skew", "s"),
    "gyro_bias": _plain("sense", "gyro_bias", "bias", "rad/s", signed=True),
    "gyro_scale": _plain("sense", "gyro_scale", "scale", "1", signed=True),
    "imu_lever_arm": _plain("sense", "lever", "error", "m", signed=True),
    "encoder_offset": _plain("sense", "encoder_offset", "offset", "rad", 2, signed=True),
    "encoder_scale": _plain("sense", "encoder_scale", "scale", "1", 2, signed=True),
    "gyro_g_sensitivity": _plain("sense", "gyro_g", "coefficient", "rad/s per m/s^2", signed=True, absolute=True),
    # the motor's current reaches the gyro
    "magnetic_gyro": _plain("sense", "gyro_torque", "coefficient", "rad/s per N m", signed=True, absolute=True),
    "gyro_cubic": _plain("sense", "gyro_cubic", "coefficient", "s^2/rad^2", signed=True, absolute=True),
    "torque_dead_band": _plain("drive", "dead_band", "half_width", "N m"),
    # the magnets warm up: torque per ampere falls over the session
    "torque_gain_drift": _plain("drive", "gain_drift", "share", "1"),
    # a hose from knee to frame: the knee's rate brakes the pivot
    "knee_drags_pivot": _plain("plant", "cross_damping", "coefficient", "N m s/rad", 1)}
INSIDE = ("stribeck_friction", "asymmetric_friction", "load_dependent_friction", "presliding_friction",
          "quadratic_drag", "friction_drift", "joint_stiffness", "joint_elasticity", "backlash", "rotor_inertia",
          "end_stop_contact", "base_compliance", "torque_ripple", "torque_offset", "torque_saturation", "torque_delay",
          "sensor_time_skew", "gyro_bias", "gyro_scale", "accelerometer_bias", "imu_misalignment", "imu_lever_arm",
          "encoder_offset", "encoder_scale", "encoder_eccentricity")
OUTSIDE = ("gyro_g_sensitivity", "swaying_gravity", "sloshing_payload", "cable_hysteresis", "magnetic_gyro",
           "torque_dead_band", "encoder_interpolation", "angle_dependent_friction", "gyro_cubic", "loose_payload",
           "torque_gain_drift", "knee_drags_pivot")
MAKERS: dict[str, Maker] = {name: PLAIN.get(name) or globals()[name]
                            for name in (*INSIDE, *OUTSIDE)}
# what a leg must have for an effect to matter on it: factors on its parameters
NEEDS: dict[str, dict[str, float]] = {"presliding_friction": {"coulomb2": 3.0}}
SMALLEST: dict[str, float] = {"joint_elasticity": 1 / 500}
LARGEST: dict[str, float] = {
    "presliding_friction": 0.2, "joint_elasticity": 0.3, "backlash": 0.25, "rotor_inertia": 0.06,
    "end_stop_contact": 0.8, "base_compliance": 1 / 300, "load_dependent_friction": 0.35, "torque_saturation": 2.5,
    "torque_delay": 0.04, "sensor_time_skew": 0.04, "gyro_scale": 0.4, "encoder_scale": 0.3,
    "encoder_eccentricity": 0.3, "imu_misalignment": 0.3, "imu_lever_arm": 0.15, "encoder_offset": 0.35,
    "gyro_g_sensitivity": 0.12, "torque_dead_band": 0.25, "loose_payload": 0.5, "torque_gain_drift": 0.4,
    "swaying_gravity": 0.3, "torque_ripple": 0.6, "encoder_interpolation": 0.15, "sloshing_payload": 0.012}
