"""`TorqueDelay`: a measured torque that is late."""

from __future__ import annotations

from copy import copy
from typing import Self

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import TorqueSensorEffect
from estimator.model import Mechanism
from estimator.signals import Channel, added_by_delay, torque_of


class TorqueDelay(TorqueSensorEffect):
    """reading(t) = u(t - d), with a record by `added_by_delay`."""

    name = "torque_delay"
    sizes = (Size("delay", "s", 0.001, tolerance=5e-4),)
    sentence = "the torque acts earlier than it was measured (later where the delay is negative), beyond its hold"
    reference = "dead time of a current loop; positive: the measurement is late"
    tolerance_source = "half a period of a current loop of 1 kHz"
    experiment = "motion at high frequency: phase grows with it"
    depends_on = "du"
    plans = ("fast",)
    fast_s: float | None = None
    """Delay by which the fast part of a record moves [s]; None: the size."""

    def about(self, size: FloatArray) -> Self:
        """The same with the fast part of a record where it is: its steps are no derivative, and no delay would cross
        one."""
        own = copy(self)
        own.fast_s = float(size[0])
        return own

    def told(self, size: FloatArray) -> str:
        """Sentence that says which of both comes first, and by how much."""
        late_ms = 1e3 * abs(float(size[0]))
        return f"the torque acts {late_ms:.3g} ms {'before' if size[0] > 0.0 else 'after'} it was measured"

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if actuated and set(actuated) <= set(mechanism.followers):
            return "no torque was measured: the law of a loop makes it, and command_delay is how late that acts"
        return super().testable(mechanism, has_imu, actuated)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        if view.measured is None:
            return {torque_of(j): view.delayed(view.samples.u[j], None, size[0]) for j in self.driven(view)}
        found = {}
        for channel in (torque_of(j) for j in self.driven(view)):
            y, slow = view.measured.readings[channel], view.measured.slow[channel]
            late, fast = -np.array([size[0], size[0] if self.fast_s is None else self.fast_s]) / view.dt_s
            found[channel] = -np.concatenate([added_by_delay(y[part], slow[part], late, fast)
                                              for part in view.segments()])
        return found
