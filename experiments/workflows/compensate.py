"""The named causes of a model taken back to the drive: torque added to a plan, a cogging table in a moteus.

- `feedforward` adds to a plan the torque that the causes need on the motion of the model without them. Every drive
  takes it, since a plan is the torque that goes with each command.
- `cogging_settings` is a table of current over a turn of the rotor, as a moteus takes it. ODrive's CAN protocol, a
  Dynamixel's control table and legid's own protocol have no such table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import structs

from daq import FloatArray, InputError, Rig
from daq.recording import Plan
from estimator.effects import Points, TorqueEffect, View
from estimator.model import Mechanism, simulate, smooth_sign
from experiments.models import EffectValue, Model, build_mechanism, effects_of, simulate_extended
from experiments.rig import wiring

BY_PLAN = ("joint_stiffness", "quadratic_drag", "rotor_inertia", "stribeck_friction", "asymmetric_friction",
           "load_dependent_friction", "torque_ripple")
"""Torques at the driven joint that depend on its motion alone."""
COGGING, MOST_COUNTS = 1024, 127
"""Entries of a moteus' `motor.cogging_dq_comp`, int8 each, over a turn of the rotor; scale in A."""
OUTPUT = ("motor_position.rotor_to_output_ratio", "motor_position.output.offset", "motor_position.output.sign")
"""Settings of a moteus that lead from its rotor to the position that it reports, by docs/reference/configuration.md."""
STEP_S = 0.002
ELSEWHERE = {"torque_offset": "an error of the measured current: legid calibrate shunt",
             "gyro_bias": "legid calibrate imu", "gyro_scale": "legid calibrate imu",
             "accelerometer_bias": "legid calibrate imu", "imu_misalignment": "legid calibrate imu",
             "encoder_offset": "legid calibrate zero", "imu_lever_arm": "lever_arm_m of the rig file",
             "encoder_eccentricity": "no drive's table by legid: the encoder commutates the motor, and the drive's own "
                                     "tool then calibrates it anew"}


class Share(NamedTuple):
    """Means that compensate one cause."""

    cause: str
    where: str
    """`plan`, `drive` or `nowhere`."""
    words: str


class Feedforward(NamedTuple):
    """A plan with the torque that the causes need."""

    plan: Plan
    before: float
    """RMS distance of the driven joint from the model without the causes, under the first plan [rad]."""
    after: float
    """The same under the new plan, by simulation."""


def shares_of(model: Model, kind: str) -> list[Share]:
    """Means that compensate each cause of the model with a drive of this kind."""
    (driven, *_) = build_mechanism(model.mechanism).actuated
    out = []
    for effect in model.effects:
        name = f"{effect.name}@{effect.joint}" if effect.joint else effect.name
        if not _by_plan(effect, driven):
            out.append(Share(name, "nowhere", ELSEWHERE.get(effect.name, "no torque of the motor undoes it")))
        elif effect.name == "torque_ripple" and kind == "moteus":
            out.append(Share(name, "drive", "motor.cogging_dq_comp of the moteus; or torque of a plan"))
        else:
            out.append(Share(name, "plan", "torque added to the commands of a plan"))
    return out


def _by_plan(effect: EffectValue, driven: int) -> bool:
    return effect.name in BY_PLAN and effect.joint in (None, driven + 1)


def feedforward(model: Model, plan: Plan, where: str) -> Feedforward:
    """`plan` with the torque that the model's causes need at the driven joint on the motion that the model without them
    makes under it. Raises `InputError` where no cause can be compensated so, `WorkError` where a motion diverges."""
    mechanism = build_mechanism(model.mechanism)
    driven, least = mechanism.actuated[0], structs.replace(model, effects=())
    used = [e for e in model.effects if _by_plan(e, driven)]
    if not used:
        raise InputError(where, "has no cause that torque of the motor undoes",
                         "give a model that legid diagnose --model-out extended")
    time_s = np.arange(0.0, plan.duration_s, STEP_S)
    torque = _held(plan, time_s, mechanism, driven)
    q, v, a = (x.T for x in simulate(mechanism, np.array(least.beta), np.zeros(mechanism.n), np.zeros(mechanism.n),
                                     torque, STEP_S, "zero"))
    need = np.zeros(time_s.size)
    for effect, size in effects_of(structs.replace(model, effects=tuple(used))):
        if isinstance(effect, TorqueEffect):
            need += effect.law(*_motion(model, mechanism, time_s, (q, v, a, torque.T), size))
    begins = np.searchsorted(time_s, plan.time_s - plan.time_s[0] - 1e-9)
    mean = np.add.reduceat(need, begins) / np.diff(np.append(begins, need.size))
    new = Plan(plan.time_s, plan.torque_nm + mean)
    errors = []
    for one in (plan, new):
        run = simulate_extended(structs.replace(model, hold="zero"), mechanism, time_s,
                                _held(one, time_s, mechanism, driven), np.zeros(mechanism.n))
        errors.append(float(np.sqrt(np.mean((run.q[:, driven] - q[driven]) ** 2))))
    return Feedforward(new, *errors)


def _held(plan: Plan, time_s: FloatArray, mechanism: Mechanism, driven: int) -> FloatArray:
    """(N, n) the plan's torque at the driven joint, held between its times."""
    torque = np.zeros((time_s.size, mechanism.n))
    torque[:, driven] = plan.torque_nm[np.searchsorted(plan.time_s - plan.time_s[0], time_s + 1e-9, side="right") - 1]
    return torque


def _motion(model: Model, mechanism: Mechanism, time_s: FloatArray, motion: tuple[FloatArray, ...], size: FloatArray
            ) -> tuple[Points, FloatArray, View]:
    q, v, a, torque = motion
    speeds = np.array(mechanism.velocity_scales)[:, None]
    at = Points(q, v, a, torque, smooth_sign(v, speeds), time_s, time_s, np.zeros(time_s.size))
    view = View(mechanism, np.array(model.beta), at, at, np.arange(time_s.size - 1), (0.5, 0.5), np.zeros(1, np.intp),
                STEP_S, np.array(model.reach, dtype=float), model.gear_ratio)
    return at, size, view


def cogging_settings(model: Model, rig: Rig, setting: Callable[[str], float], where: str) -> dict[str, float]:
    """A moteus' settings that undo the model's torque ripple: 1024 counts and their scale [A].

    `setting` reads one of the drive. Its reported position is sign (ratio rotor + offset). Raises `InputError` where
    the model has no ripple at the driven joint, or one that does not repeat with the rotor."""
    device = rig.devices.controller
    if device is None or device.kind != "moteus":
        raise InputError("[devices.controller]", f"is {device.kind if device else 'absent'}: no table of torque",
                         "add the torque to a plan: --plan PLAN.csv --out NEW.csv")
    (driven, *_) = build_mechanism(model.mechanism).actuated
    ripples = [e for e in model.effects if e.name == "torque_ripple" and e.joint in (None, driven + 1)]
    if not ripples:
        raise InputError(where, "has no torque_ripple at the driven joint, and a moteus' table holds nothing else",
                         "add the torque to a plan: --plan PLAN.csv --out NEW.csv")
    ratio, offset, sign = (setting(name) for name in OUTPUT)
    if not all(map(math.isfinite, (ratio, offset, sign))) or not ratio:
        raise InputError(where, f"is of a moteus that does not say {' or '.join(OUTPUT)}", "update its firmware")
    place = wiring(device, rig)
    turn = np.arange(COGGING) / COGGING
    needed = np.zeros(COGGING)
    for ripple in ripples:
        order = ripple.shapes["order"] * model.gear_ratio
        repeats = order * ratio / abs(place.turns)
        if abs(repeats - round(repeats)) > 1e-6:
            raise InputError(where, f"has a torque ripple of {repeats:g} periods a turn of the rotor",
                             "check gear_ratio of the rig against rotor_to_output_ratio of the drive")
        position = sign * (ratio * turn + offset)
        phase = order * (2.0 * math.pi * position / place.turns - rig.calibration.knee_zero_rad)
        needed -= ripple.sizes["sine_amplitude"] * np.sin(phase) + ripple.sizes["cosine_amplitude"] * np.cos(phase)
    current = math.copysign(1.0, place.turns) * needed / place.torque_constant_nm_per_a
    scale = float(np.abs(current).max()) / MOST_COUNTS
    counts = np.rint(current / scale) if scale else np.zeros(COGGING)
    return {"motor.cogging_dq_scale": scale,
            **{f"motor.cogging_dq_comp.{k}": float(count) for k, count in enumerate(counts)}}

