"""`learn_torque`: the torque of one joint that a model leaves, as a function of the state that repeats between runs.

    r = Phi w + e,  w ~ N(0, (sum_g alpha_g K_g)^-1),  e ~ N(0, sigma^2)

r is the residual torque at the smoothed motion of the runs, Phi the columns of the tables of `StateTorque`, K_g the
mean square of table g and of its slope. The levels alpha and sigma maximise the marginal likelihood (MacKay 1992,
Bayesian interpolation). A correlated e counts as so many fewer samples as its correlation time asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray, IndexArray
from estimator.effects import Points, StateTorque, Table, Variable
from estimator.free_runs import SmoothedRun
from estimator.model import Mechanism, smooth_sign
from estimator.prediction.structure import taken

KNOTS, PAIR_KNOTS = 16, 5
"""Knots of a table of one variable, and of each variable of a table of two, while tables are chosen."""
FINE_KNOTS, FINE_PAIR_KNOTS = 48, 9
"""The same of tables that stay."""
STEPS, CONVERGED = 60, 0.02
"""Most steps of the levels, and the change of their logarithms below which they have converged."""
LEAST_EXPLAINED = 0.1
"""Least share of a joint's residual mean square that the state must explain."""
LEAST_SHARE = 0.02
"""Least share of a table in the mean squares of all tables; the others are left out."""
FLAT = 1e-3
"""Prior precision of the constant, in units of the residual's variance."""


@dataclass(frozen=True)
class Samples:
    """Residual torques of some runs at their smoothed motion."""

    at: Points
    residual: FloatArray
    """(N, n) [N m]"""
    weight: FloatArray
    """(N, n) share of each residual's variance that is noise, not dry friction that holds a joint at rest"""
    level: FloatArray
    """(n,) rms noise level of the torques in the smoother: its residuals are smaller, for it follows its own model"""
    run: IndexArray
    """(N,) the run of each sample, from 0"""

    def plus(self, law: StateTorque) -> Samples:
        """The same with the torque of `law` added: the residuals of a model that has it, as without."""
        residual = self.residual.copy()
        residual[:, law.joint or 0] += law.torque(self.at)
        return replace(self, residual=residual)


@dataclass(frozen=True)
class LearntTorque:
    """A torque law, and how well it is known."""

    law: StateTorque
    covariance: FloatArray
    """(1 + B, 1 + B) of the constant, then of the values of each table, widened to the scatter between runs; given
    the model's parameters and the motion"""
    noise_nm: float
    """Noise level of the torque [N m]: what it leaves of the residual, or the smoother's level if that is larger."""
    correlation: float
    """Samples of that residual that count as one."""
    explained_nm: float
    """Rms of its torque over the samples, without the constant [N m]."""

    def std(self, at: Points) -> FloatArray:
        """(N,) standard deviation of its torque at N points [N m]."""
        columns = columns_of(self.law.tables, at, self.law.joint or 0)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", columns, self.covariance, columns), 0.0)))


def samples_of(smoothed: Sequence[SmoothedRun]) -> Samples:
    """Samples, evenly taken, of the smoothed runs; the motor's torque is the measured one, as in a simulation."""
    parts, residuals, weights, levels, runs = [], [], [], [], []
    count = taken(sum(one.problem.total for one in smoothed))
    for k, one in enumerate(smoothed):
        x, m = one.state.x, one.problem.mechanism
        parts.append(np.stack([x.q.T, x.v.T, one.drive.T, smooth_sign(x.v.T, m.velocity_scales[:, None])])[..., count])
        residuals.append((one.drive - one.problem.motor_torque(one.state.x, one.state.beta))[count])
        weights.append(one.problem.torque_weight(one.state.noise)[count])
        levels.append(one.problem.torque_level(one.state.noise)[count])
        runs.append(np.full(parts[-1].shape[-1], k))
    q, v, u, sign = np.concatenate(parts, axis=-1)
    nothing = np.zeros(q.shape[-1])
    run = np.concatenate(runs).astype(np.intp)
    return Samples(Points(q, v, np.zeros_like(q), u, sign, nothing, nothing, run.astype(np.float64)),
                   np.concatenate(residuals), np.concatenate(weights),
                   np.sqrt(np.mean(np.concatenate(levels) ** 2, axis=0)), run)


def blank_tables(at: Points, joint: int, mechanism: Mechanism) -> list[Table]:
    """Tables that are tried at a joint, without values: knots halfway between even steps and even quantiles."""
    driven = [Variable("motor torque", j) for j in mechanism.actuated if j == joint or joint in mechanism.passive]
    angle, rate = Variable("angle", joint), Variable("rate", joint)
    others = [Variable("angle", j) for j in range(mechanism.n) if j != joint and not mechanism.exchanged]
    tried: list[tuple[tuple[Variable, ...], bool]] = [((x,), False) for x in (angle, rate, *driven, *others)]
    tried += [((x,), True) for x in (angle, *driven, *others)]
    tried += [((angle, x), False) for x in (rate, *driven, *others)]
    out = [_blank(variables, directed, at, KNOTS, PAIR_KNOTS) for variables, directed in tried]
    return [table for table in out if all(k.size > 2 for k in table.knots)]


def _blank(variables: tuple[Variable, ...], directed: bool, at: Points, alone: int, paired: int) -> Table:
    knots = tuple(_knots(x.of(at), alone if len(variables) == 1 else paired) for x in variables)
    nothing = np.zeros(tuple(k.size for k in knots))
    return Table(variables, knots, nothing, nothing, directed)


def _knots(x: FloatArray, count: int) -> FloatArray:
    even = np.linspace(x.min(), x.max(), count)
    return np.unique(0.5 * (even + np.quantile(x, np.linspace(0.0, 1.0, count))))


def columns_of(tables: Sequence[Table], at: Points, joint: int) -> FloatArray:
    """(N, 1 + B) derivatives of a law's torque by its constant and by the values of its tables."""
    return np.concatenate([np.ones((at.q.shape[-1], 1)), *(t.columns(at, joint) for t in tables)], axis=1)


def roughness(table: Table) -> FloatArray:
    """(B, B) quadratic form of a table's values: its mean square, and that of its slope over the range."""
    masses, slopes = np.ones((1, 1)), np.zeros((1, 1))
    for knots in table.knots:
        x = (knots - knots[0]) / (knots[-1] - knots[0])
        step = np.diff(np.eye(x.size), axis=0)
        slope, mass = step.T @ (step / np.diff(x)[:, None]), np.eye(x.size) / x.size
        slopes = np.kron(slopes, mass) + np.kron(masses, slope)
        masses = np.kron(masses, mass)
    return np.asarray(slopes + masses)


def learn_torque(samples: Samples, joint: int, mechanism: Mechanism) -> LearntTorque | None:
    """The torque law of one joint; None where the state explains less than `LEAST_EXPLAINED` of the residual.

    Tables without a share are left out first; those that stay get finer knots.
    """
    weight = np.sqrt(samples.weight[:, joint])
    if not np.any(weight * samples.residual[:, joint]):
        return None
    tables, correlation = blank_tables(samples.at, joint, mechanism), 1.0
    for finer in (False, True):
        tables, gram = [_blank(t.variables, t.directed, samples.at, FINE_KNOTS, FINE_PAIR_KNOTS)
                        for t in tables] if finer else tables, None
        for _ in range(1 + len(tables)):
            fit = _Fit(samples, joint, tables, weight, correlation, gram)
            correlation, gram = correlation_time(fit.left, samples.run), fit.gram
            kept = fit.shares >= LEAST_SHARE * fit.shares.sum()
            if kept.all():
                break
            mask = np.append(True, np.repeat(kept, [t.values.size for t in tables]))
            tables, gram = [t for t, k in zip(tables, kept) if k], gram[np.ix_(mask, mask)]
    fit = _Fit(samples, joint, tables, weight, correlation, gram)
    if fit.power < LEAST_EXPLAINED * (fit.power + fit.noise):
        return None
    return fit.told(samples.run, float(samples.level[joint]))


class _Fit:
    """Values of some tables at one joint, fitted to the samples under their `weight` (N,); `gram` of their columns, if
    known."""

    def __init__(self, samples: Samples, joint: int, tables: Sequence[Table], weight: FloatArray, correlation: float,
                 gram: FloatArray | None) -> None:
        self.joint, self.tables, self.correlation = joint, tables, correlation
        self.columns = weight[:, None] * columns_of(tables, samples.at, joint)
        self.residual = weight * samples.residual[:, joint]
        self.count = float(np.sum(weight**2))
        stops = 1 + np.cumsum([t.values.size for t in tables], dtype=int)
        self.places = [slice(int(stop) - t.values.size, int(stop)) for stop, t in zip(stops, tables)]
        self.gram = self.columns.T @ self.columns if gram is None else gram
        self.centre = self.columns.T @ weight / self.count
        square = float(self.residual @ self.residual)
        self.mean, self.covariance, self.noise = maximise_evidence(
            self.gram / correlation, self.columns.T @ self.residual / correlation, square / correlation,
            self.count / correlation, [roughness(t) for t in tables], self.places)

    @property
    def shares(self) -> FloatArray:
        """Variance of each table's torque over the samples."""
        squares = [self.mean[p] @ self.gram[p, p] @ self.mean[p] / self.count for p in self.places]
        return np.maximum(np.array(squares) - [(self.centre[p] @ self.mean[p]) ** 2 for p in self.places], 0.0)

    @property
    def left(self) -> FloatArray:
        """(N,) weighted residual that the tables leave."""
        return self.residual - self.columns @ self.mean

    def inflation(self, run: IndexArray) -> float:
        """Variance of the torque by its scatter between runs over that by the covariance, at least 1.

        Scores of the runs give the scatter (sandwich estimator, White 1982).
        """
        which = np.unique(run)
        left = self.left
        scores = np.stack([self.columns[run == k].T @ left[run == k] for k in which])
        moved = scores @ self.covariance / (self.noise * self.correlation)
        scatter = np.einsum("ki,ij,kj->", moved, self.gram, moved) * which.size / max(which.size - 1, 1)
        return max(1.0, float(scatter / np.sum(self.covariance * self.gram)))

    @property
    def power(self) -> float:
        """Variance of the torque over the samples."""
        return max(float(self.mean @ self.gram @ self.mean) / self.count - float(self.centre @ self.mean) ** 2, 0.0)

    def told(self, run: IndexArray, level: float) -> LearntTorque:
        """The law with tables of mean zero over the samples, but for directed ones; the constant takes the means."""
        turn = np.eye(self.mean.size)
        for table, here in zip(self.tables, self.places):
            if not table.directed:
                turn[0, here] = self.centre[here]
                turn[here, here] -= self.centre[here]
        wider = self.inflation(run) * max(1.0, level**2 / self.noise)
        mean, covariance = turn @ self.mean, wider * turn @ self.covariance @ turn.T
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        tables = [replace(t, values=mean[p].reshape(t.values.shape), std=std[p].reshape(t.values.shape))
                  for t, p in zip(self.tables, self.places)]
        return LearntTorque(StateTorque(self.joint, tables, float(mean[0])), covariance,
                            max(level, float(np.sqrt(self.noise))), self.correlation, float(np.sqrt(self.power)))


def maximise_evidence(gram: FloatArray, right: FloatArray, square: float, count: float, forms: Sequence[FloatArray],
                      places: Sequence[slice]) -> tuple[FloatArray, FloatArray, float]:
    """Posterior mean (1 + B,) and covariance of the constant and all values, and the noise's variance.

    `gram`, `right` and `square` are Phi^T Phi, Phi^T r and r^T r of `count` samples; `forms` the K_g at these `places`.
    """
    noise = square / count
    levels = np.full(len(forms), 1.0 / noise)
    for _ in range(STEPS):
        before = np.log(levels)
        precision = np.zeros_like(gram)
        precision[0, 0] = FLAT / (square / count)
        for level, form, place in zip(levels, forms, places):
            precision[place, place] = level * form
        covariance = np.asarray(np.linalg.inv(gram / noise + precision), dtype=np.float64)
        mean = covariance @ right / noise
        free = 1.0
        for k, (form, place) in enumerate(zip(forms, places)):
            own = len(form) - levels[k] * float(np.sum(covariance[place, place] * form))
            own = min(max(own, 1e-6), float(len(form)))
            levels[k] = min(own / max(float(mean[place] @ form @ mean[place]), 1e-300), 1e8 * count / square)
            free += own
        left = square - 2.0 * float(mean @ right) + float(mean @ gram @ mean)
        noise = max(left, 1e-9 * square) / max(count - free, 1.0)
        if np.all(np.abs(np.log(levels) - before) < CONVERGED):
            break
    return mean, covariance, noise


def correlation_time(residual: FloatArray, run: IndexArray) -> float:
    """Integrated autocorrelation time of a residual (N,) in samples, at least 1: up to the first negative pair of lags
    (Geyer 1992)."""
    parts = [residual[run == k] - residual[run == k].mean() for k in np.unique(run)]
    most = min(min(p.size for p in parts) // 2, 400)
    power = sum(float(p @ p) for p in parts)
    if power == 0.0 or most < 3:
        return 1.0
    rho = np.array([sum(float(p[lag:] @ p[: p.size - lag]) for p in parts) / power for lag in range(most)])
    pairs = rho[: most // 2 * 2].reshape(-1, 2).sum(axis=1)
    last = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else pairs.size
    return max(1.0, float(2.0 * pairs[:last].sum() - 1.0))
