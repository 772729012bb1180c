"""Least squares of records under readings of their columns: what each reading leaves, and what is impossible by it.

A record obeys tau = Z(q, qd, qdd) beta with a possible beta under the right reading of its columns only. No window of
the record counts for much more than another, and each is predicted by parameters of others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.calibration.windows import CLEAR, bounded, cut, inverse, typical, usual
from estimator.fitting import faults, free_mask
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import differentiate, lowpass, split_signals

SLOW_HZ = 3.0
"""Band in which the equation of motion is asked: gravity's and the links' inertia, little of what drives add."""
OVERSAMPLED = 16.0
"""Samples of the thinned motion a period of that band."""
MOST_SAMPLES = 20_000
"""Of all runs together; from longer ones the beginning is taken."""
PERIODS = 1.5
"""Length of a window in periods of that band; in a record that is too short for that, the half or a quarter of it."""
WEIGHT_SHARE = 0.3
"""Least residual of a joint as a share of the largest: a passive joint's equation alone ends at parameters of zero."""
FOLDS = 4
"""Parts of the records, each of which is predicted by the others."""
POSES = 20
"""Instants at which the inertia matrix is looked at."""
MOST_JUDGED = 64
"""Readings; of more, those that plain least squares likes best."""
LEAST_SPAN, MOST_SPAN = 0.1, 20.0
"""How far an angle goes that was moved for an identification [rad]. A unit that makes it less is not tried; an angle
that goes further turned, or is in another unit, or in counts."""


@dataclass(frozen=True)
class Remedy:
    """One reading of the columns: q = angles @ q_read + zero, tau = torques @ tau_read."""

    what: str
    """What looks wrong."""
    write: str
    """The correction."""
    angles: FloatArray
    """(n, n)"""
    zero: FloatArray
    """(n,)"""
    torques: FloatArray
    """(n, n)"""
    changes: int = 1

    @property
    def scales(self) -> bool:
        """Whether it changes the size of an angle. The right unit leaves less torque, not other parameters alone."""
        return not bool(np.isin(np.abs(self.angles), (0.0, 1.0)).all())

    def __str__(self) -> str:
        return f"{self.what}: {self.write}"


R = TypeVar("R", bound=Remedy)


@dataclass(frozen=True)
class Reading(Generic[R]):
    """Least squares of the records under one reading of their columns."""

    remedy: R
    left: float
    """Typical residual of a window as a share of its torque, by the parameters of other windows."""
    faults: tuple[str, ...]
    positive: bool
    """Whether the inertia matrix is positive definite, whatever the scatter of its estimate."""
    beta: FloatArray
    """(p,) with gravity along the line at which the mechanism hangs"""
    hangs_rad: float = 0.0
    """Joint 1's angle on that line, where it is estimated."""

    def told(self, nothing: Reading[R]) -> str:
        """The remedy, and what it gains over the columns as they are."""
        before, after = (f"{100.0 * left:.{0 if left > 0.1 else 1}f} %" for left in (nothing.left, self.left))
        if CLEAR * self.left < nothing.left:
            return f"{self.remedy}; with it the residual falls from {before} to {after} of the torque"
        return f"{self.remedy}; with it the parameters are possible and the residual is {after} of the torque"


@dataclass(frozen=True)
class Motion:
    """Filtered motion of all segments: (m, n) each, and the rows at which a segment ends."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    ends: tuple[int, ...]
    rate_hz: float

    def thinned(self) -> Motion:
        """The same at the lowest rate that shows slow motion."""
        thin = max(1, int(self.rate_hz / (OVERSAMPLED * slow_band(self.rate_hz))))
        parts = [slice(a, b) for a, b in pairwise([0, *self.ends])]
        q, qd, qdd, tau = (np.concatenate([x[part][::thin] for part in parts])
                           for x in (self.q, self.qd, self.qdd, self.tau))
        counts = [len(range(part.start, part.stop, thin)) for part in parts]
        return Motion(q, qd, qdd, tau, tuple(np.cumsum(counts)), self.rate_hz / thin)


def as_it_is(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> Reading[Remedy]:
    """Least squares of the records as they are read now. Raises `FitError`."""
    motion = filtered_motion(datasets, mechanism, options).thinned()
    return read(motion, mechanism, options, [nothing_changed(mechanism.n)])[0]


def nothing_changed(n: int) -> Remedy:
    return Remedy("", "", np.eye(n), np.zeros(n), np.eye(n), 0)


def filtered_motion(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> Motion:
    """Filtered motion of all segments at their own rate. Raises `FitError`."""
    share = min(1.0, MOST_SAMPLES / max(sum(map(len, datasets)), 1))
    parts = [data.part(slice(0, max(int(share * len(data)), min(len(data), 200)))) for data in datasets]
    signals = split_signals(parts, mechanism, replace(options, hold="linear"))
    rate = signals[0].rate_hz
    cutoff = min(4.0 * slow_band(rate), 0.4 * rate)
    segments = []
    for s in signals:
        k = differentiate(s, mechanism, cutoff, options.filter_order, fused=True)
        segments.append([*k, lowpass(s.torque, cutoff, rate, options.filter_order)])
    q, qd, qdd, tau = (np.concatenate(rows) for rows in zip(*segments))
    return Motion(q, qd, qdd, tau, tuple(np.cumsum([len(rows[0]) for rows in segments])), rate)


def slow_band(rate_hz: float) -> float:
    """Cutoff of slow least squares at this rate [Hz]."""
    return min(SLOW_HZ, 0.1 * rate_hz)


class Equations(NamedTuple):
    """tau = Z beta of all windows, with further columns behind the parameters'."""

    grams: FloatArray
    """(W, n, k + 1, k + 1) mean products of the free parameters' columns and, behind them, of what these explain"""
    free: BoolArray
    """(p + more,)"""
    start: FloatArray
    """(p + more,) of which those that are not free are kept"""
    samples_per_dof: float
    length: int
    """Samples a window."""

    def solved(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k,) the free parameters, and (k, k) their covariance, by windows of `weights` (W,).

        Joints are weighted by their own residual's variance, found in three passes.
        """
        joints = np.einsum("w,wnab->nab", weights, self.grams)
        level = np.ones(len(joints))
        for _ in range(3):
            whole = np.einsum("n,nab->ab", 1.0 / level, joints)
            spread = inverse(whole[:-1, :-1])
            found = spread @ whole[:-1, -1]
            level = np.maximum(_squares(joints, found), 1e-18 * joints[:, -1, -1].max() + 1e-300) / weights.sum()
            level = np.maximum(level, WEIGHT_SHARE**2 * level.max())
        return found, self.samples_per_dof / self.length * spread

    def shares(self, found: FloatArray) -> FloatArray:
        """(W,) residual as a share of the torque of the window, or of the usual one where that is larger."""
        torque = self.grams[:, :, -1, -1].sum(axis=1)
        return np.sqrt(_squares(self.grams, found).sum(axis=1) / np.maximum(torque, usual(torque)))

    def judged(self) -> tuple[FloatArray, FloatArray, float]:
        """(p + constants,) all parameters, their standard deviations, and the typical share of a window.

        The share is by the parameters of the other `FOLDS` - 1 parts of the records, whose scatter is the least
        standard deviation (jackknife): a record of little motion says less of a parameter than its noise does.
        """
        size = np.einsum("wncc->wnc", self.grams).sum(axis=1)
        leverage = np.mean(size / [usual(column) for column in size.T], axis=1)
        weights = bounded(lambda w: self.shares(self.solved(w)[0]) ** 2, leverage)
        found, spread = self.solved(weights)
        held, by_others = np.zeros(len(self.grams)), []
        for part in np.array_split(np.arange(len(held)), FOLDS):
            others = weights.copy()
            others[part] = 0.0
            by_others.append(self.solved(others)[0])
            held[part] = self.shares(by_others[-1])[part]
        variance = np.maximum(np.diag(spread), (FOLDS - 1) * np.var(by_others, axis=0))
        beta, std = self.start.copy(), np.zeros(len(self.start))
        beta[self.free], std[self.free] = found, np.sqrt(np.maximum(variance, 0.0))
        return beta, std, typical(held, self.grams[:, :, -1, -1].sum(axis=1))


def _squares(grams: FloatArray, found: FloatArray) -> FloatArray:
    """Mean square of the residual of each of (..., k + 1, k + 1) at the parameters `found` (k,)."""
    x = np.append(found, -1.0)
    return np.maximum(grams @ x @ x, 0.0)


class SlowRows(NamedTuple):
    """tau = Z beta of all samples, low-passed."""

    parts: list[tuple[int, FloatArray]]
    """First sample of each segment that is long enough, and (L, n, k + n + 1) its rows without their ends: columns of
    the free parameters, the torques as they are read, and what the other parameters take."""
    free: BoolArray
    """(p + more,)"""
    start: FloatArray
    """(p + more,)"""
    length: int
    """Samples a window."""

    def explained(self, torques: FloatArray) -> list[tuple[int, FloatArray]]:
        """`parts` with rows (L, n, k + 1), of which the last is what tau = torques @ tau_read leaves to explain."""
        k = int(self.free.sum())
        made = np.append(torques, np.full((len(torques), 1), -1.0), axis=1)
        return [(first, np.append(rows[..., :k], np.einsum("lja,ja->lj", rows[..., k:], made)[..., None], axis=2))
                for first, rows in self.parts]


def slow_rows(motion: Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy, unknown: bool = False
              ) -> SlowRows:
    """Rows of slow least squares under one reading of the angles.

    Behind the parameters stand constants of the driven joints and, of columns of which nothing is known, gravity's
    columns with joint 1 a quarter turn ahead.
    """
    q, qd, qdd = (x @ remedy.angles.T for x in (motion.q, motion.qd, motion.qdd))
    q, still = q + remedy.zero, np.zeros_like(q)
    ahead = [mechanism.regressor(q + 0.5 * np.pi * np.eye(mechanism.n)[0], still, still)[
        ..., gravity_of(mechanism)]] if unknown else []
    constants = np.broadcast_to(np.eye(mechanism.n)[:, list(mechanism.actuated)], (*q.shape, len(mechanism.actuated)))
    z = np.concatenate([mechanism.regressor(q, qd, qdd), *ahead, constants], axis=2)
    free, beta = free_mask(mechanism, options)
    mask = np.append(free, np.ones(z.shape[2] - len(free), bool))
    offset = [k for j, k in mechanism.offset_columns.items() if j in mechanism.actuated]
    mask[offset] = False  # the constants stand for them
    start = np.append(np.where(free, 0.0, beta), np.zeros(len(mask) - len(free)))
    torques = np.broadcast_to(motion.tau[:, None, :], (*q.shape, mechanism.n))
    rows = np.concatenate([z[:, :, mask], torques, (z[:, :, ~mask] @ start[~mask])[:, :, None]], axis=2)
    band = slow_band(motion.rate_hz)
    inner = []
    for where in np.split(np.arange(len(q)), motion.ends[:-1]):
        edge = min(int(0.5 * motion.rate_hz / band), len(where) // 10)
        inner.append((where, slice(edge, len(where) - edge)))
    whole = int(PERIODS * motion.rate_hz / band)
    length = next((length for length in (whole, whole // 2, whole // 4)
                   if sum((part.stop - part.start) // length for _, part in inner) >= FOLDS), whole)
    parts = [(int(where[part.start]), lowpass(rows[where], band, motion.rate_hz, options.filter_order)[part])
             for where, part in inner if part.stop - part.start > length]
    return SlowRows(parts, mask, start, length)


def gravity_of(mechanism: Mechanism) -> list[int]:
    """Columns of the parameters of gravity."""
    return [k for k, p in enumerate(mechanism.parameters) if p.term == "gravity"]


def equations(motion: Motion, rows: SlowRows, torques: FloatArray, unknown: bool) -> Equations | None:
    """Equations of all windows under one reading; None where there are fewer windows than parts."""
    windows = [cut(part, rows.length) for _, part in rows.explained(torques)]
    if sum(map(len, windows)) < FOLDS:
        return None
    every = np.concatenate(windows)
    if unknown:  # a constant torque supports no reading
        every[..., -1] -= every[..., -1].mean(axis=(0, 1))
    return Equations(np.einsum("wlna,wlnb->wnab", every, every) / rows.length, rows.free, rows.start,
                     max(1.0, 0.5 * motion.rate_hz / slow_band(motion.rate_hz)), rows.length)


def read(motion: Motion, mechanism: Mechanism, options: FitOptions, remedies: Sequence[R], unknown: bool = False
         ) -> list[Reading[R]]:
    """Least squares under each of `remedies`, of which those of the same angles follow one another. Of columns that
    are `unknown`, such as a stranger's, joint 1 may hang anywhere.

    Of more than `MOST_JUDGED`: those that leave least by plain least squares, and those of them that change nothing.
    """
    def rows_of(remedies: Sequence[R]) -> Iterator[tuple[SlowRows, list[R]]]:
        for _, same in groupby(remedies, lambda one: (one.angles.tobytes(), one.zero.tobytes())):
            alike = list(same)
            yield slow_rows(motion, mechanism, options, alike[0], unknown), alike

    if len(remedies) > MOST_JUDGED:
        left = np.concatenate([_plainly_left(rows, np.array([one.torques for one in same]))
                               for rows, same in rows_of(remedies)])
        changed, half = np.array([one.changes > 0 for one in remedies]), MOST_JUDGED // 2
        remedies = [remedies[k] for k in sorted({*np.argsort(left)[:half], *np.lexsort((left, changed))[:half]})]
    return [_judged(motion, mechanism, rows, one, unknown) for rows, same in rows_of(remedies) for one in same]


def _plainly_left(rows: SlowRows, torques: FloatArray) -> FloatArray:
    """(r,) share of the torque that least squares leaves with each of torques (r, n, n)."""
    if not rows.parts:
        return np.ones(len(torques))
    k, every = int(rows.free.sum()), np.concatenate([part for _, part in rows.parts])
    grams = np.einsum("lja,ljb->jab", every, every)
    made = np.append(torques, np.full((*torques.shape[:2], 1), -1.0), axis=2)
    power = np.einsum("rja,jab,rjb->r", made, grams[:, k:, k:], made)
    wanted = np.einsum("jka,rja->rk", grams[:, :k, k:], made)
    explained = np.sum(wanted @ inverse(grams[:, :k, :k].sum(axis=0)) * wanted, axis=1)
    return np.sqrt(np.maximum(1.0 - explained / np.maximum(power, 1e-300), 0.0))


def _judged(motion: Motion, mechanism: Mechanism, rows: SlowRows, remedy: R, unknown: bool) -> Reading[R]:
    own, p, tilt = equations(motion, rows, remedy.torques, unknown), mechanism.p, 0.0
    if own is None:
        return Reading(remedy, 1.0, ("too short",), False, np.zeros(p))
    found, std, left = own.judged()
    if unknown:
        along = gravity_of(mechanism)
        ahead = slice(p, p + len(along))
        heavy = int(np.argmax(np.hypot(found[along], found[ahead])))
        tilt = float(np.arctan2(found[ahead][heavy], found[along][heavy]))
        found[along] = np.cos(tilt) * found[along] + np.sin(tilt) * found[ahead]
        std[along] = np.hypot(np.cos(tilt) * std[along], np.sin(tilt) * std[ahead])
    q = motion.q @ remedy.angles.T + remedy.zero
    masses = mechanism.inertia_matrix(q[:: max(1, len(q) // POSES)], found[:p])
    return Reading(remedy, left, faults(mechanism, found[:p], std[:p], q), bool(np.linalg.eigvalsh(masses).min() > 0.0),
                   found[:p], -tilt)
