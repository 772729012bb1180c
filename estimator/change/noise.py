"""Changes of sensors' noise: the log levels of one session's runs against another's, by Student's t.

Levels are those that neighbouring samples show, so that a change of anything else hardly moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import stdtr, stdtrit

from daq import Dataset
from estimator.change.result import LevelChange
from estimator.change.scores import ReferenceFit
from estimator.likelihood import Noise
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import angle_column, imu_columns, torque_column, white_noise_level


@dataclass(frozen=True)
class LogLevels:
    """Levels of noise, or of free-run errors, of one session: column to mean and variance of the log level."""

    runs: int
    levels: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, runs: int, values: Mapping[str, Sequence[float]]) -> Self:
        """Those of the columns whose `values`, one a run, are all positive."""
        logs = {name: np.log(own) for name, own in values.items() if min(own) > 0.0}
        return cls(runs, {name: (float(x.mean()), float(x.var(ddof=1))) for name, x in logs.items()})


def levels_of(runs: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> LogLevels:
    """Noise levels of the columns that a fit reads and whose noise shows in every run."""
    shown = {name: [white_noise_level(run[name][np.isfinite(run[name])]) for run in runs]
             for name in _columns(mechanism, options) if all(name in run for run in runs)}
    return LogLevels.of(len(runs), shown)


def _columns(m: Mechanism, options: FitOptions) -> list[str]:
    imus = [name for k in range(len(m.imus)) for name in imu_columns(k)] if options.sensors == "imu" else []
    return [*imus, *(angle_column(m, j) for j in options.encoders_of(m.n)), *(torque_column(m, j) for j in m.actuated)]


def compare_noise(test: LogLevels, reference: LogLevels) -> tuple[LevelChange, ...]:
    """Noise changes of every column that both sessions show, the likeliest change first."""
    both = [name for name in test.levels if name in reference.levels]
    freedom = test.runs + reference.runs - 2
    found = []
    for name in both:
        (mean, own), (before, other) = test.levels[name], reference.levels[name]
        pooled = ((test.runs - 1) * own + (reference.runs - 1) * other) / freedom
        std = max((pooled * (1.0 / test.runs + 1.0 / reference.runs)) ** 0.5, 1e-12)
        p = min(1.0, 2.0 * len(both) * float(stdtr(freedom, -abs(mean - before) / std)))
        half = float(stdtrit(freedom, 0.975)) * std
        low, ratio, high = np.exp(mean - before + half * np.array([-1.0, 0.0, 1.0]))
        found.append(LevelChange(name, float(ratio), (float(low), float(high)), p))
    return tuple(sorted(found, key=lambda n: n.p_value))


def with_noise(fit: ReferenceFit, changes: Sequence[LevelChange]) -> Noise:
    """Noise of the other session: that of the `fit`, times the ratio in each column of `changes`."""
    m, n = fit.model.mechanism, fit.noise
    ratio = {one.column: one.ratio for one in changes}
    imus = np.array([[ratio.get(name, 1.0) for name in imu_columns(k)] for k in range(len(n.gyro))]).reshape(-1, 3)
    torque, encoder = (np.array([ratio.get(column(m, j), 1.0) for j in range(m.n)])
                       for column in (torque_column, angle_column))
    return replace(n, torque=n.torque * torque, encoder=n.encoder * encoder, gyro=n.gyro * imus[:, 0],
                   accel=n.accel * imus[:, 1:])
