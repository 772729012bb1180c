"""`TorqueSaturation`: a motor that gives less torque than its current says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import TorqueSensorEffect
from estimator.signals import Channel, torque_of

LEAST_MARGIN = 0.1
"""A saturated motor's current grows without bound; beyond this its slope, 32 then, stays."""


class TorqueSaturation(TorqueSensorEffect):
    """The torque that acts falls short of what the current i says, u = i / sqrt(1 + 2 c i^2) = i - c i^3 + ...

    So reading = u / sqrt(1 - 2 c u^2); where less than LEAST_MARGIN is left under the root it goes on straight.
    """

    name = "torque_saturation"
    per_motor = True
    positive = 1
    sizes = (Size("cubic_shortfall", "1/(N m)^2", 0.01, tolerance=0.002),)
    sentence = "at high current the motor gives less torque than the current says (saturation)"
    reference = "torque constant of an iron core that saturates, K0 / sqrt(1 + (i / i_s)^2)"
    tolerance_source = "iron cores below half of their peak current"
    experiment = "the same motion at two amplitudes"
    depends_on = "u"
    plans = ()

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {torque_of(j): self._current(view.samples.u[j], size)[0] - view.samples.u[j]
                for j in self.driven(view)}

    def by_torque(self, view: View, size: FloatArray) -> Mapping[Channel, FloatArray]:
        return {torque_of(j): self._current(view.samples.u[j], size)[1] - 1.0 for j in self.driven(view)}

    @staticmethod
    def _current(torque: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """i, in units of the torque, and its slope."""
        most = np.sqrt((1.0 - LEAST_MARGIN) / (2.0 * size[0])) if size[0] > 0.0 else np.inf
        known = np.clip(torque, -most, most)
        root = 1.0 - 2.0 * size[0] * known**2
        slope = root**-1.5
        return known / np.sqrt(root) + slope * (torque - known), slope
