"""The emulated knee drive: a current loop of first order, and the record of what was asked and what acted."""

from __future__ import annotations

import math
from array import array

import numpy as np
from numpy.typing import NDArray


class Motor:
    """Torque follows the command with one time constant; exact over each step in which the command is held."""

    def __init__(self, time_constant_s: float) -> None:
        self._tau = time_constant_s
        self._acting_nm = self._before_nm = self._command_nm = 0.0
        self._t_ns = array("q")
        self._commanded = array("d")
        self._mean = array("d")
        self.last_mean_nm = 0.0
        """Mean torque of the last step [N m]."""
        self.impulse_nms = 0.0
        """Integral of the acting torque since the start [N m s]."""

    def step(self, t_ns: int, dt_s: float, command_nm: float) -> float:
        """Mean torque [N m] over the step that starts at `t_ns`."""
        error = self._acting_nm - command_nm
        self._before_nm, self._command_nm = self._acting_nm, command_nm
        if self._tau > 0:
            decay = math.exp(-dt_s / self._tau)
            mean = command_nm + error * (1 - decay) * self._tau / dt_s
            self._acting_nm = command_nm + error * decay
        else:
            mean = self._acting_nm = command_nm
        self._t_ns.append(t_ns)
        self._commanded.append(command_nm)
        self._mean.append(mean)
        self.last_mean_nm = mean
        self.impulse_nms += mean * dt_s
        return mean

    def torque_at(self, t_ns: int) -> float:
        """Torque [N m] at a time within the last step."""
        if self._tau <= 0 or not self._t_ns:
            return self._command_nm
        since_s = max(0.0, (t_ns - self._t_ns[-1]) * 1e-9)
        return self._command_nm + (self._before_nm - self._command_nm) * math.exp(-since_s / self._tau)

    def forget(self, keep: int) -> None:
        """Drop all of the record but the last `keep` steps: a rig that runs for days must not grow."""
        for column in (self._t_ns, self._commanded, self._mean):
            del column[:-keep]

    @property
    def record(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """(t_ns at the step's start, torque commanded, mean torque acting), each (steps,), [N m]."""
        return np.array(self._t_ns, np.int64), np.array(self._commanded), np.array(self._mean)
