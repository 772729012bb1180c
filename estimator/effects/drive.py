"""The drive and its torque measurement."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daq import FloatArray
from estimator.effects.base import CONSTANT, Points, SensorEffect, Shape, Size, TorqueEffect, View
from estimator.effects.timing import shifted
from estimator.model import Mechanism
from estimator.signals import Channel, torque_of

LEAST_MARGIN = 0.1
"""A saturated motor's current grows without bound; beyond this its slope, 32 then, stays."""


class TorqueRipple(TorqueEffect):
    """A sin(n phi) + B cos(n phi), phi the motor's angle: gear ratio times the joint's."""

    name = "torque_ripple"
    sizes = (Size("sine_amplitude", "N m", 0.01), Size("cosine_amplitude", "N m", 0.01))
    shapes = (Shape("order", "1", (1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 12.0, 14.0), discrete=True),)
    sentence = "the motor's torque ripples with its angle (cogging, commutation)"
    reference = "whole orders of the motor's angle"
    experiment = "slow constant speed over several turns of the motor"
    depends_on = "turn"
    plans = ("steady",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        phase = size[2] * view.gear_ratio * at.q[self.joint or 0]
        return -(size[0] * np.sin(phase) + size[1] * np.cos(phase))

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if self.joint in actuated else "no motor at this joint"


class TorqueSensorEffect(SensorEffect):
    """Base of what is wrong with the measured torque; without a joint it acts on every driven joint alike."""

    per_joint = False

    def shown_at(self, mechanism: Mechanism) -> int:
        return mechanism.actuated[-1] if self.joint is None else self.joint

    def _driven(self, view: View) -> list[int]:
        return list(view.mechanism.actuated) if self.joint is None else [self.joint]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if actuated else "no joint carries a measured torque"


class TorqueSaturation(TorqueSensorEffect):
    """The torque that acts falls short of what the current i says, u = i / sqrt(1 + 2 c i^2) = i - c i^3 + ...

    So reading = u / sqrt(1 - 2 c u^2); where less than LEAST_MARGIN is left under the root it goes on straight.
    """

    name = "torque_saturation"
    per_motor = True
    positive = 1
    sizes = (Size("cubic_shortfall", "1/(N m)^2", 0.01),)
    sentence = "at high current the motor gives less torque than the current says (saturation)"
    reference = "torque constant of an iron core that saturates, K0 / sqrt(1 + (i / i_s)^2)"
    experiment = "the same motion at two amplitudes"
    depends_on = "u"
    plans = ()

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {torque_of(j): self._current(view.samples.u[j], size)[0] - view.samples.u[j]
                for j in self._driven(view)}

    def by_torque(self, view: View, size: FloatArray) -> Mapping[Channel, FloatArray]:
        return {torque_of(j): self._current(view.samples.u[j], size)[1] - 1.0 for j in self._driven(view)}

    @staticmethod
    def _current(torque: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """i, in units of the torque, and its slope."""
        most = np.sqrt((1.0 - LEAST_MARGIN) / (2.0 * size[0])) if size[0] > 0.0 else np.inf
        known = np.clip(torque, -most, most)
        root = 1.0 - 2.0 * size[0] * known**2
        slope = root**-1.5
        return known / np.sqrt(root) + slope * (torque - known), slope


class TorqueOffset(TorqueSensorEffect):
    """reading = u + c."""

    name = "torque_offset"
    per_motor = True
    equivalence_class = CONSTANT
    sizes = (Size("offset", "N m", 0.01),)
    sentence = "the measured torque has an offset (shunt zero)"
    reference = "zero of the current shunt, [calibration] shunt_offset_a in README.md"
    experiment = "rest with the motor off"
    depends_on = "v"
    plans = ("rest",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {torque_of(j): np.full(view.samples.q.shape[1], size[0]) for j in self._driven(view)}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if any(p.term == "offset" for p in mechanism.parameters):
            return "declared in the rig: it is a parameter of the nominal model"
        return super().testable(mechanism, has_imu, actuated)


class TorqueDelay(TorqueSensorEffect):
    """reading(t) = u(t - d).

    Of the reading only what is slow is moved in time: noise that falls between samples is averaged, and an estimate
    would be drawn to half a sample for it.
    """

    name = "torque_delay"
    sizes = (Size("delay", "s", 0.001),)
    sentence = "the measured torque is late against the torque that acted (early where the delay is negative)"
    reference = "dead time of a current loop; positive: the measurement is late"
    experiment = "motion at high frequency: phase grows with it"
    depends_on = "du"
    plans = ("fast",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        found = {}
        for j in self._driven(view):
            if view.measured is None:
                true = view.samples.u[j]
                found[torque_of(j)] = shifted(true, size[0], view) - true
            else:  # u(t - d) - y(t) is u(t) - y(t + d); noise interpolated between samples is less, so it stays
                slow = view.measured.slow[torque_of(j)]
                found[torque_of(j)] = slow - shifted(slow, -size[0], view)
        return found
