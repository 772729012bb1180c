"""`Segments`: a record cut into segments of about a second, simulated and linearised each from its own initial state.

Arrays over all samples of all segments; the last axis of derivatives is parameters, initial state, defect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.likelihood import MeasuredRuns
from estimator.model import Mechanism
from estimator.numerics import propagate
from estimator.signals import SignalSet, accelerometer_slopes

CHUNK = 20_000
"""Samples, about, whose sensitivities are in memory at a time."""
ROUNDS, INNER = 8, 8
"""Most rounds of Newton steps, and steps a round, that bring a simulation to its equation; a round has those segments
that are not there yet. (Measured: where dry friction turns round a segment may take 60 steps, most take 3.)"""
CONVERGED = 1e-6
"""Share of the torque's spread, or where none acts of the largest term's, by which a simulation may miss its equation.
(Measured: with 1e-3 the loss does not converge.)"""


class Linear(NamedTuple):
    """Segments, linearised at one motion."""

    products: FloatArray
    """(S, C, m, m) of the columns parameters, initial state, residual; by segment and channel"""
    motion: FloatArray
    """(N, 2 n, m) how angles and rates move with them; by the last column towards their equation"""


class Part(NamedTuple):
    """Some segments, whose N samples and K intervals are put one after the other."""

    segments: IndexArray
    size: IndexArray
    """Samples of each."""
    rows: IndexArray
    """(N,) samples in all."""
    first: IndexArray
    """Each segment's first, among the N."""
    intervals: IndexArray
    """(K,) intervals in all."""
    starts: IndexArray
    """Each segment's first, among the K."""
    left: IndexArray
    """(K,) samples, among the N, that begin an interval."""


class Segments:
    """Shooting segments of all gap-free records, and their measurements."""

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str, seconds: float
                 ) -> None:
        self.data = MeasuredRuns(signals, mechanism, hold)
        d = self.data
        self.n, self.state = d.n, 2 * d.n
        edges = [0]
        for begin, end in zip([0, *d.ends[:-1]], d.ends):
            count = min(max(1, round((end - begin) * d.dt / seconds)), max(1, (end - begin) // 2))
            edges += np.linspace(begin, end, count + 1).astype(int)[1:].tolist()
        self.edges = np.array(edges)
        self.first, self.size = self.edges[:-1], np.diff(self.edges)
        inner = np.ones(d.total, bool)
        inner[self.edges[1:] - 1] = False
        self.left = np.flatnonzero(inner)
        """Samples that begin an interval of a segment."""
        torque = d.collocation.torque(d.torque, self.left)
        if d.between is not None:
            torque = torque + d.between[:, :, np.searchsorted(d.left, self.left)]
        self.torque = torque
        """(n, 2, K) at the Gauss points."""
        self.encoders = np.flatnonzero(d.has_encoder)
        self.channels = len(self.encoders) + 3 * d.imu_count
        start = np.searchsorted(self.left, self.first)
        self.intervals = np.append(start, self.left.size)
        """Number of each segment's first interval."""

    def floors(self) -> FloatArray:
        """(C,) half of what neighbouring samples show of each channel's noise: no level falls below it."""
        shown = self.data.shown
        levels = [shown.encoder[self.encoders]]
        if self.data.imu_count:
            levels += [np.concatenate([[g], *a.reshape(1, -1)]) for g, a in zip(shown.gyro, shown.accel)]
        return np.maximum(0.5 * np.concatenate(levels), 1e-9)

    def parts(self, which: IndexArray | None = None) -> Iterator[Part]:
        """All segments, or those called `which`, some at a time."""
        which = np.arange(len(self.first)) if which is None else which
        group = np.cumsum(self.size[which]) // CHUNK
        for segments in np.split(which, np.flatnonzero(np.diff(group)) + 1):
            size = self.size[segments]
            rows, first = _ranges(self.first[segments], size)
            intervals, starts = _ranges(self.intervals[segments], size - 1)
            yield Part(segments, size, rows, first, intervals, starts, self.left[intervals]
                        - np.repeat(self.first[segments] - first, size - 1))

    def equation(self, part: Part, q: FloatArray, v: FloatArray, beta: FloatArray
                 ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Defect (2 n, K), its slopes by both ends (2 n, 2, 2 n, K), and regressor (p, 2 n, K) at a part's motion."""
        c = self.data.collocation
        z, slopes = c.fast(*c.motion(q, v, part.left), beta)
        z = z.reshape(len(beta), self.state, -1)
        defect = np.tensordot(beta, z, 1) - self.torque[:, :, part.intervals].reshape(self.state, -1)
        return defect, c.by_ends(slopes).reshape(self.state, 2, self.state, -1), z

    def linearise(self, q: FloatArray, v: FloatArray, beta: FloatArray, free: BoolArray) -> Linear:
        """At the motion q, v (N, n), which need not obey the equation."""
        width = int(free.sum()) + self.state + 1
        products = np.empty((len(self.first), self.channels, width, width))
        motion = np.zeros((self.data.total, self.state, width))
        begin = np.zeros((self.state, width))
        begin[:, -1 - self.state : -1] = np.eye(self.state)
        for part in self.parts():
            defect, slopes, z = self.equation(part, q[part.rows], v[part.rows], beta)
            right = np.zeros((self.state, width, defect.shape[-1]))
            right[:, : width - 1 - self.state] = -z[free].swapaxes(0, 1)
            right[:, -1] = -defect
            moved = np.zeros((len(part.rows), self.state, width))
            moved[part.first] = begin
            propagate(slopes, right, part.left, moved)
            motion[part.rows] = moved
            products[part.segments] = _by_segment(part, self.readings(part, q, v, moved))
        return Linear(products, motion)

    def readings(self, part: Part, q: FloatArray, v: FloatArray, motion: FloatArray | None) -> FloatArray:
        """(C, N, m) derivatives of a part's readings, the last column with what they are off by; without `motion`
        that column alone."""
        d, n, where = self.data, self.n, part.rows
        q, v = q[where], v[where]
        width = 1 if motion is None else motion.shape[2]
        moved = np.zeros((len(q), 2 * n, 1)) if motion is None else motion
        out = np.empty((self.channels, len(q), width))
        for c, j in enumerate(self.encoders):
            share = 1.0 if d.spread is None else d.spread[where, j, None]
            out[c] = moved[:, j]
            out[c, :, -1] += q[:, j] - d.angles[where, j]
            out[c] /= share
        if not d.imu_count:
            return out
        acceleration, known = self._acceleration(part, np.concatenate([q, v], axis=1)[:, :, None])
        by_motion, _ = self._acceleration(part, moved)
        c = len(self.encoders)
        for k, place in enumerate(d.mechanism.imus):
            joints = list(d.turned_by[k])
            out[c] = moved[:, [n + j for j in joints]].sum(axis=1)
            out[c, :, -1] += v[:, joints].sum(axis=1) - d.gyro[k, where]
            felt, *slopes = accelerometer_slopes(d.mechanism, place, q.T, v.T, acceleration[:, :, 0].T)
            for axis in range(2):
                row = sum(np.einsum("jN,Njm->Nm", slope[axis], part) for slope, part in
                          zip(slopes, (moved[:, :n], moved[:, n:], by_motion)))
                out[c + 1 + axis] = row
                out[c + 1 + axis, :, -1] += felt[axis] - d.accel[k, axis, where]
                out[c + 1 + axis] *= known[:, None]
            c += 3
        return out

    def _acceleration(self, part: Part, state: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(N, n, m) of states (N, 2 n, m), and where there is one: not at the ends of segments.

        By both neighbours' angles and rates, 2 (q+ - 2 q + q-) / h^2 - (v+ - v-) / (2 h), with an error of h^4: that of
        the equation of motion at a sample has the noise of its torque in it.
        """
        n, h = self.n, self.data.dt
        q, v = state[:, :n], state[:, n:]
        out = np.zeros_like(q)
        out[1:-1] = 2.0 * (q[2:] - 2.0 * q[1:-1] + q[:-2]) / h**2 - (v[2:] - v[:-2]) / (2.0 * h)
        known = np.ones(len(q), bool)
        known[part.first] = known[part.first + part.size - 1] = False
        return out, known

    def simulate(self, q: FloatArray, v: FloatArray, beta: FloatArray) -> tuple[FloatArray, FloatArray,
                                                                              BoolArray]:
        """Motion (N, n) from each segment's first state, near q, v; and (S,) whether it was found.

        Newton's method on all segments at once, each with steps of its own length.
        """
        q, v, found = q.copy(), v.copy(), np.zeros(len(self.first), bool)
        for _ in range(ROUNDS):
            for part in self.parts(np.flatnonzero(~found)):
                q[part.rows], v[part.rows], found[part.segments] = self._newton(part, q[part.rows], v[part.rows], beta)
            if found.all():
                break
        return q, v, found

    def _newton(self, part: Part, q: FloatArray, v: FloatArray, beta: FloatArray
                ) -> tuple[FloatArray, FloatArray, BoolArray]:
        of, samples = (np.repeat(np.arange(part.size.size), count) for count in (part.size - 1, part.size))
        share = np.ones(part.size.size)
        defect, slopes, z = self.equation(part, q, v, beta)
        scale = float(np.std(self.data.torque, axis=0).max()) or float(np.max(np.abs(beta) * np.std(z, axis=(1, 2))))
        norm = _norm(part, defect)
        for _ in range(INNER):
            active = ~(norm <= CONVERGED * scale)
            if not active.any():
                break
            step = np.zeros((len(q), self.state, 1))
            propagate(slopes, -defect[:, None], part.left, step)
            step = np.nan_to_num(step[:, :, 0] * (share * active)[samples, None], posinf=0.0, neginf=0.0)
            trial_q, trial_v = q + step[:, : self.n], v + step[:, self.n :]
            tried = self.equation(part, trial_q, trial_v, beta)
            found = _norm(part, tried[0])
            better = active & (found < (1.0 - 0.1 * share) * norm)
            share = np.where(better, np.minimum(1.0, 2.0 * share), np.where(active, 0.25 * share, share))
            norm = np.where(better, found, norm)
            at, moved = better[of], better[samples]
            defect[:, at], slopes[..., at] = tried[0][:, at], tried[1][..., at]
            q[moved], v[moved] = trial_q[moved], trial_v[moved]
        return q, v, norm <= CONVERGED * scale

    def squares(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """(S, C) summed squared residuals of a motion."""
        out = np.empty((len(self.first), self.channels))
        for part in self.parts():
            residual = self.readings(part, q, v, None)[:, :, 0]
            out[part.segments] = np.add.reduceat(residual**2, part.first, axis=1).T
        return out


def _ranges(first: IndexArray, size: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Numbers from each of `first` on, so many each; and where each begins."""
    begin = np.cumsum(size) - size
    return np.repeat(first - begin, size) + np.arange(int(size.sum())), begin


def _norm(part: Part, defect: FloatArray) -> FloatArray:
    """(S,) root mean square defect of each segment."""
    return np.asarray(np.sqrt(np.add.reduceat(np.sum(defect**2, axis=0), part.starts) / (part.size - 1)))


def _by_segment(part: Part, columns: FloatArray) -> FloatArray:
    """(S, C, m, m) products of columns (C, N, m), summed over each segment."""
    index = np.arange(part.size.max())
    rows = np.minimum(part.first[:, None] + index, columns.shape[1] - 1)
    padded = columns[:, rows] * (index < part.size[:, None])[:, :, None]
    return (padded.swapaxes(-1, -2) @ padded).swapaxes(0, 1)
