"""Hidden effects of the emulated leg of a demo: one effect that its rig file does not mention.

They share no code with the estimator's library, and their friction laws have other forms than the library's.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from daq import InputError
from drivers.mock import Plant
from experiments.emulation.plant import HiddenTorque, LegBody, LegPlant, Motion


@dataclass(frozen=True)
class Hidden:
    """One effect: its name, what it is in words, and where it enters."""

    effect: str
    joint: int | None
    """From 1; None for the whole rig."""
    words: str
    """What is hidden, with its size and form, for a person."""
    body: tuple[tuple[str, Any], ...] = ()
    """Fields of `LegBody` that it changes."""
    torques: tuple[HiddenTorque, ...] = ()
    torque_offset_nm: float = 0.0
    """Of the measured torque, beyond the calibration."""
    gyro_bias_radps: float = 0.0
    """About the joint's axis, beyond the calibration."""
    torque_gain: float = 1.0
    """The joint gets so much of the torque that the drive believes to make."""
    imu_late_s: float = 0.0
    """How long ago was true what sensors on link 1 show."""

    def plant(self, body: LegBody) -> Plant:
        """The leg with the effect in it."""
        plant = LegPlant(replace(body, **dict(self.body)), hidden=self.torques)
        return LatePivot(plant, self.imu_late_s) if self.imu_late_s else plant


class Seen(NamedTuple):
    """A state as sensors see it."""

    q1: float
    q2: float
    q1d: float
    q2d: float
    q1dd: float


class LatePivot:
    """A plant whose link 1 is seen `late_s` late, in whole steps; its motion is not changed."""

    def __init__(self, plant: LegPlant, late_s: float) -> None:
        self._plant, self._late_s = plant, late_s
        self._past: deque[tuple[float, float, float]] = deque()

    def step(self, dt_s: float, torque_nm: float) -> Seen:
        """State after `dt_s` [s]; all steps must be equally long."""
        now = self._plant.step(dt_s, torque_nm)
        self._past.append((now.q1, now.q1d, now.q1dd))
        if len(self._past) > round(self._late_s / dt_s) + 1:
            self._past.popleft()
        q1, q1d, q1dd = self._past[0]
        return Seen(q1, now.q2, q1d, now.q2d, q1dd)


SPRING_NM, DRAG = 0.45, 0.006
REST_RAD = 0.1


def _spring(time_s: float, motion: Motion, torque: float) -> tuple[float, float]:
    return 0.0, -SPRING_NM * (motion[1] - REST_RAD)


def _drag(time_s: float, motion: Motion, torque: float) -> tuple[float, float]:
    return 0.0, -DRAG * motion[3] * abs(motion[3])


NOTHING = Hidden("none", None, "nothing")
EFFECTS: dict[str, Hidden] = {hidden.effect: hidden for hidden in (
    Hidden("stribeck_friction", 2, "dry friction in the knee that is 0.06 N m higher at standstill and falls off as "
           "1 / (1 + (v / 0.25 rad/s)^2), another form than the library's", (("stribeck", (0.0, 0.06)),
                                                                            ("stribeck_radps", 0.25))),
    Hidden("asymmetric_friction", 2, "dry friction in the knee that is 0.03 N m higher while its angle grows",
           (("forward_coulomb", (0.0, 0.03)),)),
    Hidden("rotor_inertia", None, "a rotor of 0.004 kg m^2, seen at the knee", (("rotor", 0.004),)),
    Hidden("joint_stiffness", 2, f"a spring of {SPRING_NM} N m/rad at the knee, at rest at {REST_RAD} rad",
           torques=(_spring,)),
    Hidden("quadratic_drag", 2, f"a drag of {DRAG} N m s^2/rad^2 in the knee", torques=(_drag,)),
    Hidden("torque_offset", None, "a shunt that reads 0.04 N m too much", torque_offset_nm=0.04),
    Hidden("gyro_bias", None, "a gyro that reads 0.01 rad/s too much", gyro_bias_radps=0.01),
    Hidden("sensor_time_skew", None, "an IMU that is 4 ms late", imu_late_s=0.004),
)}
DEFAULT = "joint_stiffness"
WRONG_CONSTANT = Hidden("torque_gain", None, "a motor that makes 7 % more torque than its constant says: no motion "
                        "shows it, a known weight does", torque_gain=1.07)


def find_hidden(name: str) -> Hidden:
    """The effect called `name`, or `none`. Raises `InputError`."""
    known = {h.effect: h for h in (NOTHING, WRONG_CONSTANT)} | EFFECTS
    if name not in known:
        raise InputError("emulate", f"{name!r} cannot be hidden", f"it can be {', '.join(known)}")
    return known[name]
