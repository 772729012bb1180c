"""`MissingIntegral`: a loop with an integral that is not stated."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Effect, Perturbation, Points, Size, View
from estimator.effects.loop_integral import summed


class MissingIntegral(Effect):
    """The loop has I Int (c - q) dt more than stated, zero at the start of a run."""

    name = "missing_integral"
    per_joint = True
    per_loop = True
    sizes = (Size("integral", "N m/(rad s)", 0.05, tolerance=0.02),)
    sentence = "the loop integrates its error, which is not stated"
    reference = "position I gain of the Dynamixel X series, register over 65536"
    tolerance_source = "an integral that takes a minute to double the torque"
    experiment = "hold the joint against gravity and wait: the error creeps to zero"
    depends_on = "session"
    plans = ("steady", "slow")

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        at, told, j = view.samples, view.samples.commanded, self.joint or 0
        gauss, samples = np.zeros_like(view.gauss.q), np.zeros_like(at.q)
        if told is None or not told.follows[j]:
            return Perturbation(gauss, samples)
        n = len(told.supply)
        error = summed(told.error(at.q[:n], at.v[:n], at.a[:n])[0], told.told.first, view.dt_s)
        samples[j] = self._lacking(at, error, size)
        gauss[j] = self._lacking(view.gauss, view.to_gauss(error), size)
        return Perturbation(gauss, samples)

    def _lacking(self, at: Points, error: FloatArray, size: FloatArray) -> FloatArray:
        """(...) torque by the stated law less that with the integral of the error (n, ...)."""
        told, j = at.commanded, self.joint or 0
        assert told is not None
        n = len(told.supply)
        seen, rate_seen = told.error(at.q[:n], at.v[:n], at.a[:n])
        loop, both = told.loop, []
        for more in (0.0, float(size[0]) * error):
            wanted = np.clip(loop.gain * seen + loop.damping * rate_seen + loop.integral * told.summed + more,
                             -loop.limit, loop.limit)
            both.append(loop.acting(wanted, at.v[:n], told.supply)[j])
        return np.asarray(both[0] - both[1])
