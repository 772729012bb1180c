"""Records of a leg behind a position loop that does otherwise than it says, and the size that a fit should find."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from daq import Dataset
from tests.support.mujoco_leg import GRAVITY, Leg
from tests.support.servo_leg import COUNTS, ServoFaults, follow, with_torque

GAIN, DAMPING = 6.0, 0.1
SERVO = f"gain = {GAIN}\ndamping = {DAMPING}\n"
LEG = Leg(viscous=(0.02, 0.03), coulomb=(0.01, 0.02))
STEP_RAD = float(np.radians(2.0))
QUANTUM_RAD = 2.0 * np.pi / COUNTS


@dataclass(frozen=True)
class HiddenLoop:
    """What the loop does, and sizes by the names of the library."""

    faults: ServoFaults
    sizes: Mapping[str, float]
    within: float = 0.1
    begin: Mapping[str, float] = field(default_factory=dict)
    servo: str = SERVO
    """What the rig file says of it."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Parameters that are given."""
    law: Callable[..., tuple[float, float]] | None = None
    """Torques that act on pivot and knee besides, by angles, rates and the servo's torque."""


def _directional(q1: float, q2: float, v1: float, v2: float, u: float) -> tuple[float, float]:
    """BAM's M5 at the knee: |0.175 tau_m - 0.075 tau_e| in motion, 1.8 times that at rest."""
    load = -(float(LEG.beta()[2]) * math.sin(q2) * v1**2 + float(LEG.beta()[4]) * GRAVITY * math.sin(q1 + q2))
    near = math.exp(-((v2 / 0.3) ** 2))
    return 0.0, -(1.0 + 0.8 * near) * abs(0.175 * u - 0.075 * load) * math.tanh(v2 / 0.02)


HIDDEN_LOOPS = {
    "command_delay": HiddenLoop(ServoFaults(delay_s=0.015), {"delay": 0.015}),
    "gain_scale": HiddenLoop(ServoFaults(gain=1.2), {"scale_error": 0.2}, fixed={"beta5": float(LEG.beta()[4])}),
    "missing_integral": HiddenLoop(ServoFaults(integral=2.0), {"integral": 2.0}),
    "input_limit": HiddenLoop(ServoFaults(limit=0.5), {"cut": 1.0}, begin={"cut": 0.8, "level_share": 0.1}),
    "supply_sag": HiddenLoop(ServoFaults(sag=0.2), {"sag": 0.2}, 0.25, begin={"lost_share": 0.1}),
    "command_dead_band": HiddenLoop(ServoFaults(dead_band=0.02), {"width": 0.02}, 0.15),
    "command_steps": HiddenLoop(ServoFaults(step=STEP_RAD), {"share": 1.0}, 0.3, {"step": STEP_RAD, "share": 0.5}),
    "load_stribeck_friction": HiddenLoop(
        ServoFaults(), {"load_coefficient": 0.3, "stribeck_velocity": 0.5}, 0.25,
        law=lambda q1, q2, v1, v2, u: (0.0, -0.3 * abs(u) * math.exp(-((v2 / 0.5) ** 2)) * math.tanh(v2 / 0.02)),
        begin={"stribeck_velocity": 0.4, "exponent": 2.0}),
    "quadratic_load_friction": HiddenLoop(
        ServoFaults(), {"load_coefficient": 0.2},
        law=lambda q1, q2, v1, v2, u: (0.0, -0.2 * u * u * math.tanh(v2 / 0.02))),
    "directional_load_friction": HiddenLoop(
        ServoFaults(), {"load_coefficient": 0.25, "coefficient_near_rest": 0.2, "load_share": 0.3}, 0.25,
        law=_directional, begin={"load_share": 0.4, "stribeck_velocity": 0.3}),
}


def record_loop(name: str) -> list[Dataset]:
    """Three runs of 8 s of the leg with the fault, with the torque by the stated law."""
    hidden = HIDDEN_LOOPS[name]
    return [with_torque(follow(LEG, np.random.default_rng([23, k]), gain=GAIN, damping=DAMPING, seconds=8.0,
                               amplitude=0.9, high=(2.5, 1.0, 1.8)[k], faults=hidden.faults, law=hidden.law,
                               name=f"r{k + 1}"), hidden.servo) for k in range(3)]
