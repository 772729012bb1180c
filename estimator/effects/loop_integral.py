"""`SimulatedIntegral`: integrals of position loops in a simulation, beyond what they were in the record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from daq import FloatArray, IndexArray
from estimator.effects.base import Effect, Perturbation, View
from estimator.effects.commanded import Commanded


def summed(error: FloatArray, first: IndexArray, dt_s: float) -> FloatArray:
    """(n, N) integral of an error (n, N) [rad s] by trapezia, zero at the sample `first` (N,) of each part."""
    mean = 0.5 * dt_s * (error[:, 1:] + error[:, :-1])
    whole = np.concatenate([np.zeros((len(error), 1)), np.cumsum(mean, axis=1)], axis=1)
    return np.asarray(whole - whole[:, first])


@dataclass(frozen=True)
class RecordedMotion:
    """The motion by which a record has its integrals, and where pieces of a simulation begin."""

    q: FloatArray
    """(n, N)"""
    first: IndexArray
    """(N,) first sample of each sample's simulated piece: there a simulation has the record's integral"""


class SimulatedIntegral(Effect):
    """The motion before acts through it: a free run finds it by repeated simulation."""

    name: ClassVar[str] = "simulated_integral"
    sizes = ()
    reference = "the loop of the rig file"
    experiment = ""

    def __init__(self, recorded: RecordedMotion) -> None:
        super().__init__()
        self.recorded = recorded

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        at, told = view.samples, view.samples.commanded
        if told is None or view.gauss.commanded is None:
            return Perturbation()
        n = len(told.supply)
        more = summed(self.recorded.q - at.q[:n], self.recorded.first, view.dt_s)
        between = view.to_gauss(more)
        return Perturbation(self._less(view.gauss, view.gauss.commanded, between),
                            self._less(at, told, more))

    @staticmethod
    def _less(at: Any, commanded: Commanded, more: FloatArray) -> FloatArray:
        """(n, ...) torque that the motion lacks, with so much more in the integral."""
        n, out = len(commanded.supply), np.zeros_like(at.q)
        motion = at.q[:n], at.v[:n], at.a[:n]
        out[:n] = commanded.input(*motion) - replace(commanded, summed=commanded.summed + more).input(*motion)
        return out
