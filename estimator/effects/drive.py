"""The drive and its torque measurement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from estimator.effects.base import CONSTANT, SLOW_TORQUE, Points, SensorEffect, Shape, Size, TorqueEffect, View
from estimator.effects.timing import shifted
from estimator.mechanism import Mechanism

FloatArray = NDArray[np.float64]


class TorqueRipple(TorqueEffect):
    """A sin(n phi) + B cos(n phi), phi the motor's angle: gear ratio times the joint's."""

    name = "torque_ripple"
    sizes = (Size("sine_amplitude", "N m", 0.01), Size("cosine_amplitude", "N m", 0.01))
    shapes = (Shape("order", "1", (1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 12.0, 14.0)),)
    whole_shapes = True
    sentence = "the motor's torque ripples with its angle (cogging, commutation)"
    reference = "whole orders of the motor's angle"
    experiment = "slow constant speed over several turns of the motor"
    rough: ClassVar[Mapping[str, float]] = {"accelerometer": 1.6}
    """Its harmonics are not in the law, and many fall between samples."""

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        phase = size[2] * view.gear_ratio * at.q[self.joint or 0]
        return -(size[0] * np.sin(phase) + size[1] * np.cos(phase))

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if self.joint in actuated else "no motor at this joint"


class TorqueSensorEffect(SensorEffect):
    """Base of what is wrong with the measured torque; acts on every driven joint alike."""

    per_joint = False

    def _driven(self, view: View) -> list[int]:
        return list(view.mechanism.actuated)

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if actuated else "no joint carries a measured torque"


class TorqueSaturation(TorqueSensorEffect):
    """The torque that acts falls short of the measured one at high level: reading = u + c u^3."""

    name = "torque_saturation"
    positive = 1
    sizes = (Size("cubic_shortfall", "1/(N m)^2", 0.01),)
    sentence = "at high current the motor gives less torque than the current says (saturation)"
    reference = "magnetic saturation, leading odd term"
    experiment = "the same motion at two amplitudes"

    def readings(self, view: View, size: FloatArray) -> dict[str, FloatArray]:
        return {f"torque{j + 1}": size[0] * view.samples.u[j] ** 3 for j in self._driven(view)}


class TorqueOffset(TorqueSensorEffect):
    """reading = u + c."""

    name = "torque_offset"
    alike = CONSTANT
    sizes = (Size("offset", "N m", 0.01),)
    sentence = "the measured torque has an offset (shunt zero)"
    reference = "contracts: torque from the current shunt"
    experiment = "rest with the motor off"

    def readings(self, view: View, size: FloatArray) -> dict[str, FloatArray]:
        return {f"torque{j + 1}": np.full(view.samples.q.shape[1], size[0]) for j in self._driven(view)}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if any(p.term == "offset" for p in mechanism.parameters):
            return "declared in the rig: it is a parameter of the nominal model"
        return super().testable(mechanism, has_imu, actuated)


class TorqueDelay(TorqueSensorEffect):
    """reading(t) = u(t - d).

    Of the reading only what is slow is moved in time: noise that falls between samples is averaged, and an estimate
    would be drawn to half a sample for it. (Measured with 0.02 N m of noise at 100 Hz: 6.0 ms, the truth 9.8 ms.)
    """

    name = "torque_delay"
    sizes = (Size("delay", "s", 0.001),)
    sentence = "the measured torque is late against the torque that acted (early where the delay is negative)"
    reference = "contracts: torque_delay > 0"
    experiment = "motion at high frequency: phase grows with it"

    def readings(self, view: View, size: FloatArray) -> dict[str, FloatArray]:
        found = {}
        for j in self._driven(view):
            if view.measured is None:
                true = view.samples.u[j]
                found[f"torque{j + 1}"] = shifted(true, size[0], view) - true
            else:  # u(t - d) - y(t) is u(t) - y(t + d); noise interpolated between samples is less, so it stays
                slow = view.measured[f"{SLOW_TORQUE}{j + 1}"]
                found[f"torque{j + 1}"] = slow - shifted(slow, -size[0], view)
        return found


