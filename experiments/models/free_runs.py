"""Free runs of a model against one run: over any horizon, and how far its parameters' uncertainty moves them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from daq import Dataset, FloatArray
from estimator import TWO_SIDED, FitOptions
from estimator.likelihood import FreeRun, free_run
from estimator.model import Mechanism
from estimator.signals import Channel, angle_column, encoder_of, imu_channels, imu_columns, split_signals
from experiments.models.model_file import widening_of
from experiments.models.schema import Model
from experiments.models.with_effects import problem_of, smoothed_state

SHORT_S = 1.0
GYRO = "gyro"
"""How a gyro's column begins."""


@dataclass(frozen=True)
class Prediction:
    """One run, its stretches one after the other: what sensors read, and what free runs of a model make of it."""

    run: str
    time_s: FloatArray
    """(N,), increasing across gaps"""
    longest_s: float
    """Of its stretches."""
    measured: Mapping[str, FloatArray]
    """Column -> (N,): each joint's encoder where the run has one, and each gyro."""
    whole: Mapping[str, FloatArray] | None
    """Simulated from each stretch's first state; None where that ran away."""
    short: Mapping[str, FloatArray] | None
    """Simulated in pieces of `SHORT_S`, each from the motion there."""
    band: Mapping[str, FloatArray] | None
    """Half width of the 95 % band of `whole` from the parameters' covariance; None where it is not known."""


class FreeRuns:
    """One run under one model: the likeliest motion with all parameters held, and simulations that start from it.

    What is compared are sensors alone: each joint's encoder where the run has one, and each gyro. Raises `FitError`
    where no motion can be estimated.
    """

    def __init__(self, model: Model, mechanism: Mechanism, options: FitOptions, data: Dataset,
                 session_s: float = 0.0) -> None:
        placed = model if model.effects else replace_reach(model, mechanism.n)
        self.data, self._signals = data, split_signals([data], mechanism, options)
        self._problem = problem_of(placed, mechanism, self._signals, session_s)
        self._state = smoothed_state(placed, self._problem, self._signals, options)
        self._drive = self._problem.torque - self._problem.torque_readings(self._state.x, self._state.beta)
        wide = np.array(widening_of(model))
        self._covariance = wide[:, None] * wide * np.array(
            [[np.nan if c is None else c for c in row] for row in model.covariance])
        self.seconds = self._problem.total * self._problem.dt
        self.measured = {column: values for column, values in self._columns(mechanism).items()
                         if np.isfinite(values).any()}
        """Column -> (N,), the stretches one after the other."""

    def simulated(self, horizon_s: float = np.inf) -> dict[str, FloatArray] | None:
        """Column -> (N,) as simulated, each piece of about `horizon_s` from the motion there; None where that runs
        away."""
        found = free_run(self._problem, self._state, self._drive, horizon_s)
        return None if found is None else self._read(found)

    def band(self, sigmas: float = TWO_SIDED) -> dict[str, FloatArray] | None:
        """Column -> (N,) half width by which the parameters' covariance moves the free run of whole stretches, to first
        order; None where parameters are not determined or the free run moves away."""
        base = self.simulated()
        if base is None or not np.isfinite(self._covariance).all():
            return None
        values, axes = np.linalg.eigh(self._covariance)
        squares = {column: np.zeros_like(x) for column, x in base.items()}
        for k in np.flatnonzero(values > 0.0):
            moved = replace(self._state, beta=self._state.beta + np.sqrt(values[k]) * axes[:, k])
            found = free_run(self._problem, moved, self._drive)
            if found is None:
                return None
            for column, x in self._read(found).items():
                squares[column] += (x - base[column]) ** 2
        return {column: sigmas * np.sqrt(x) for column, x in squares.items()}

    def prediction(self) -> Prediction:
        """Whole and in pieces, with the band."""
        time_s = np.concatenate([s.time_s for s in self._signals])
        return Prediction(self.data.name, time_s, max(len(s.time_s) for s in self._signals) * self._problem.dt,
                          self.measured, self.simulated(), self.simulated(SHORT_S), self.band())

    def _read(self, found: FreeRun) -> dict[str, FloatArray]:
        return {column: found.readings[self._channel(column)] for column in self.measured}

    def _channel(self, column: str) -> Channel:
        if column.startswith(GYRO):
            return next(c for k in range(self._problem.imu_count) for c in imu_channels(k)[:1]
                        if imu_columns(k)[0] == column)
        return encoder_of(int(column[1:column.index("_")]) - 1)

    def _columns(self, mechanism: Mechanism) -> Mapping[str, FloatArray]:
        rows = np.concatenate([np.searchsorted(self.data.time_s, s.time_s) for s in self._signals])
        names = [angle_column(mechanism, j) for j in range(mechanism.n)]
        names += [imu_columns(k)[0] for k in range(self._problem.imu_count)]
        return {name: np.asarray(self.data[name][rows]) for name in names if name in self.data}


def replace_reach(model: Model, joints: int) -> Model:
    """A model without effects, which have no use for the angles that it leaves out."""
    return msgspec.structs.replace(model, reach=((0.0, 0.0),) * joints)
