"""Columns whose sign, unit, order or gear is wrong, found by trying the corrections.

A record obeys tau = Z(q, qd, qdd) beta with a possible beta under the right reading of its columns only. Each likely
mistake is corrected and least squares repeated, in which no window of the records counts for much more than another.
The correction with a possible beta and the smallest residual is reported; parameters of other windows predict each
window. Mistakes that no motion shows, such as the torque's scale, are not tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.calibration.units import TRIED, TWICE, correction
from estimator.calibration.windows import CLEAR, bounded, cut, typical, usual
from estimator.fitting import faults, free_mask
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import angle_column, differentiate, lowpass, split_signals, torque_column

SLOW_HZ = 3.0
"""Band in which the equation of motion is asked: gravity's and the links' inertia, little of what drives add."""
OVERSAMPLED = 16.0
"""Samples of the thinned motion a period of that band."""
MOST_SAMPLES = 20_000
"""Of all runs together; from longer ones the beginning is taken."""
ALIKE = 1.25
"""Readings that leave less than so many times the least are not told apart: those with the fewest changes are named."""
MOST_LEFT = 0.5
"""Largest torque residual of a right reading, as a share of the torque."""
GEAR_STEPS = np.exp(np.linspace(np.log(0.25), np.log(4.0), 25))
"""Factors of an angle that are tried; a gear ratio that is wrong by any factor lies near one."""
COUNT_SPANS = np.exp(np.linspace(np.log(0.1), np.log(20.0), 45))
"""Spans [rad] that are tried for an angle that goes further than any, as counts of an encoder do."""
NEAR_ONE = 0.1
"""Factors closer to one are the scatter of such a search."""
EQUAL = 1e-3
"""Residuals that differ by a smaller share are equal."""
PERIODS = 1.5
"""Length of a window in periods of that band."""
WEIGHT_SHARE = 0.3
"""Least residual of a joint as a share of the largest: a passive joint's equation alone ends at parameters of zero."""
FOLDS = 4
"""Parts of the records, each of which is predicted by the others."""
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


@dataclass(frozen=True)
class Reading:
    """Least squares of the records under one reading of their columns."""

    remedy: Remedy
    left: float
    """Typical residual of a window as a share of its torque, by the parameters of other windows."""
    faults: tuple[str, ...]

    def told(self, nothing: Reading) -> str:
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


def as_it_is(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> Reading:
    """Least squares of the records as they are read now. Raises `FitError`."""
    motion = filtered_motion(datasets, mechanism, options).thinned()
    return _read(motion, mechanism, options, nothing_changed(mechanism.n))


def find_remedies(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float = 1.0
                  ) -> tuple[Reading, tuple[Reading, ...]]:
    """The records as they are, and the corrected readings, the best first; none if no correction helps.

    On the IMU path the pivot's columns are not corrected: the accelerometer checks them. Raises `FitError`.
    """
    motion = filtered_motion(datasets, mechanism, options).thinned()
    nothing = _read(motion, mechanism, options, nothing_changed(mechanism.n))
    imu = options.sensors == "imu"
    found = [_read(motion, mechanism, options, remedy)
             for remedy in _likely(mechanism, imu, gear_ratio, np.ptp(motion.q, axis=0))]
    for j in options.encoders_of(mechanism.n):
        span = float(np.ptp(motion.q[:, j]))
        steps = GEAR_STEPS if span < MOST_SPAN else COUNT_SPANS / span
        reading = _best_gear(motion, mechanism, options, j, steps)
        found += [] if reading is None else [reading]
    cures = [r for r in found if not r.faults and r.left < MOST_LEFT and _better(r, nothing)]
    least = min((r.left for r in cures), default=0.0)
    near = [r for r in cures if r.left <= ALIKE * least]
    fewest = min((r.remedy.changes for r in near), default=0)
    return nothing, tuple(sorted((r for r in near if r.remedy.changes == fewest), key=lambda r: round(r.left, 3)))


def _better(cured: Reading, nothing: Reading) -> bool:
    """Whether a remedy is called for: it leaves far less, or no more where the record makes no mechanism."""
    if nothing.faults and not cured.remedy.scales:
        return cured.left <= (1.0 + EQUAL) * nothing.left
    return CLEAR * cured.left < nothing.left


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
    """tau = Z beta of all windows under one reading, with constants of the driven joints behind the parameters."""

    grams: FloatArray
    """(W, n, k + 1, k + 1) mean products of the free parameters' columns and, behind them, of what these explain."""
    free: BoolArray
    """(p + constants,)"""
    start: FloatArray
    """(p + constants,) of which those that are not free are kept"""
    samples_per_dof: float
    length: int
    """Samples a window."""

    def solved(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k,) the free parameters, and (k, k) their covariance, by windows of `weights` (W,).

        Joints are weighted by their own residual's variance, found in three passes.
        """
        joints = np.einsum("w,wnab->nab", weights, self.grams)
        level, ridge = np.ones(len(joints)), 1e-12 * np.eye(joints.shape[1] - 1)
        for _ in range(3):
            whole = np.einsum("n,nab->ab", 1.0 / level, joints)
            scale = np.sqrt(np.maximum(np.diag(whole)[:-1], 1e-300))
            inverse = np.linalg.inv(whole[:-1, :-1] / np.outer(scale, scale) + ridge) / np.outer(scale, scale)
            found = inverse @ whole[:-1, -1]
            level = np.maximum(_squares(joints, found), 1e-18 * joints[:, -1, -1].max() + 1e-300) / weights.sum()
            level = np.maximum(level, WEIGHT_SHARE**2 * level.max())
        return found, self.samples_per_dof / self.length * inverse

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
    """First sample of each segment that is long enough, and (L, n, k + 1) its rows without their ends."""
    free: BoolArray
    """(p + constants,)"""
    start: FloatArray
    """(p + constants,)"""
    length: int
    """Samples a window."""


def slow_rows(motion: Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy) -> SlowRows:
    """Rows of slow least squares under one reading, with constants of the driven joints behind the parameters."""
    q, qd, qdd = (x @ remedy.angles.T for x in (motion.q, motion.qd, motion.qdd))
    constants = np.zeros((len(q), mechanism.n, len(mechanism.actuated)))
    for column, j in enumerate(mechanism.actuated):
        constants[:, j, column] = 1.0
    free, beta = free_mask(mechanism, options)
    z = np.concatenate([mechanism.regressor(q + remedy.zero, qd, qdd), constants], axis=2)
    offset = [k for j, k in mechanism.offset_columns.items() if j in mechanism.actuated]
    mask = np.append(free, np.ones(constants.shape[2], dtype=bool))
    mask[offset] = False  # the constants stand for them
    start = np.append(np.where(free, 0.0, beta), np.zeros(constants.shape[2]))
    tau = motion.tau @ remedy.torques.T - z[:, :, ~mask] @ start[~mask]
    rows = np.concatenate([z[:, :, mask], tau[:, :, None]], axis=2)
    band = slow_band(motion.rate_hz)
    edge, length = int(0.5 * motion.rate_hz / band), int(PERIODS * motion.rate_hz / band)
    parts = []
    for where in np.split(np.arange(len(q)), motion.ends[:-1]):
        if len(where) > 2 * edge + length:
            slow = lowpass(rows[where], band, motion.rate_hz, options.filter_order)
            parts.append((int(where[0]) + edge, slow[edge : len(where) - edge]))
    return SlowRows(parts, mask, start, length)


def equations(motion: Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy) -> Equations | None:
    """Equations of all windows under one reading; None where there are fewer windows than parts."""
    rows = slow_rows(motion, mechanism, options, remedy)
    windows = [cut(part, rows.length) for _, part in rows.parts]
    if sum(map(len, windows)) < FOLDS:
        return None
    every = np.concatenate(windows)
    return Equations(np.einsum("wlna,wlnb->wnab", every, every) / rows.length, rows.free, rows.start,
                     max(1.0, 0.5 * motion.rate_hz / slow_band(motion.rate_hz)), rows.length)


def _read(motion: Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy) -> Reading:
    rows = equations(motion, mechanism, options, remedy)
    if rows is None:
        return Reading(remedy, 1.0, ("too short",))
    found, std, left = rows.judged()
    q = motion.q @ remedy.angles.T + remedy.zero
    return Reading(remedy, left, faults(mechanism, found[: mechanism.p], std[: mechanism.p], q))


def _scaled(mechanism: Mechanism, factors: Mapping[str, float], changes: int = 1) -> Remedy:
    """The reading of columns (angles and torques) times these factors."""
    n = mechanism.n
    what, write = correction(factors)
    angles, torques = (np.diag([factors.get(of(mechanism, j), 1.0) for j in range(n)])
                       for of in (angle_column, _torque_column))
    return Remedy(what, write, angles, np.zeros(n), torques, changes)


def _torque_column(mechanism: Mechanism, j: int) -> str:
    return torque_column(mechanism, j) if mechanism.force_unit != "V" else "duty"


def _likely(mechanism: Mechanism, imu: bool, gear_ratio: float, span: FloatArray) -> Iterator[Remedy]:
    """The mistakes that people make, undone one by one and, where signs are concerned, together; `span` (n,) is how far
    each angle goes as it is read."""
    n, turns = mechanism.n, mechanism.length_unit == "rad"
    nothing, eye = nothing_changed(n), np.eye(n)
    angles = list(range(int(imu), n))
    q, tau = ([of(mechanism, j) for j in range(n)] for of in (angle_column, _torque_column))
    signs = [tau[j] for j in mechanism.actuated] + [q[j] for j in angles]
    for count in range(1, len(signs) + 1):
        for which in combinations(signs, count):
            yield _scaled(mechanism, dict.fromkeys(which, -1.0), count)
    for those in sorted({tuple(angles), *((j,) for j in angles)}) if turns else ():
        for factor in (*TRIED["rad"].values(), TWICE):
            if factor != 1.0 and factor * span[list(those)].max() >= LEAST_SPAN:
                yield _scaled(mechanism, {q[j]: factor for j in those})
    for j in angles if gear_ratio != 1.0 else ():
        for factor, said in ((gear_ratio, "divided by the gear ratio twice"),
                             (1.0 / gear_ratio, "of the motor's side")):
            yield replace(_scaled(mechanism, {q[j]: factor}), what=f"{q[j]} looks {said}")
    for j, k in combinations(range(n), 2):
        swapped = eye.copy()
        swapped[[j, k]] = swapped[[k, j]]
        both = j in mechanism.actuated and k in mechanism.actuated
        for kinds, what, changes in (({"angles": swapped}, f"{q[j]} and {q[k]}", 2),
                                     ({"torques": swapped}, f"{tau[j]} and {tau[k]}", 2),
                                     ({"angles": swapped, "torques": swapped}, f"joints {j + 1} and {k + 1}", 3)):
            if (both or "torques" not in kinds) and (j in angles or "angles" not in kinds):
                yield replace(nothing, **kinds, what=f"{what} look interchanged", changes=changes,
                              write="give each column the other's name under [columns]")
    if turns and not imu:
        if mechanism.gravity_mps2 > 0.0:
            yield replace(nothing, zero=np.pi * eye[0], what=f"gravity looks upside down, or {q[0]} counted from "
                          "upright", write=f'set name = "{q[0]}" and offset = 3.14159265 under [columns.{q[0]}]')
        if n > 1:
            yield replace(nothing, angles=eye - np.eye(n, k=-1), changes=2, what="the angles look absolute, each "
                          "counted from the vertical", write="subtract the angle of the link before from each before "
                          "it is read")


def _best_gear(motion: Motion, mechanism: Mechanism, options: FitOptions, joint: int, factors: FloatArray
               ) -> Reading | None:
    """The factor of one joint's angle that leaves least, by search; None where it is near one, or gravity is absent."""
    if mechanism.length_unit == "m" or mechanism.gravity_mps2 == 0.0:
        return None
    column = angle_column(mechanism, joint)

    def at(log_factor: float) -> Reading:
        scaled = _scaled(mechanism, {column: float(np.exp(log_factor))}, 2)
        write = f"correct the gear ratio that it was divided by, or {scaled.write}" if factors is GEAR_STEPS else \
            f"{scaled.write}, or what a count is exactly"
        return _read(motion, mechanism, options, replace(scaled, write=write))

    steps = np.log(factors)
    coarse = [at(step) for step in steps]
    sound = [k for k, reading in enumerate(coarse) if not reading.faults]
    if not sound:
        return None
    best = min(sound, key=lambda k: coarse[k].left)
    if best in (0, len(steps) - 1):
        return None
    low, mid, high = (coarse[best + side].left ** 2 for side in (-1, 0, 1))
    bend = low - 2.0 * mid + high
    shift = 0.5 * (low - high) / bend if bend > 0.0 else 0.0
    fine = at(steps[best] + float(np.clip(shift, -1.0, 1.0)) * (steps[1] - steps[0]))
    return None if abs(np.log(fine.remedy.angles[joint, joint])) < NEAR_ONE else fine
