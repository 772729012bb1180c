"""Columns whose sign, unit, order or gear is wrong, found by trying the corrections.

A record obeys tau = Z(q, qd, qdd) beta with a possible beta under the right reading of its columns only. Each likely
mistake is corrected and least squares repeated. The correction with a possible beta and the smallest residual is
reported, if it also predicts each part of the records by the other parts. Mistakes that no motion shows, such as the
torque's scale, are not tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import Dataset, FloatArray
from estimator.fitting import faults, free_mask, weighted_least_squares
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import angle_column, differentiate, lowpass, split_signals, torque_column

SLOW_HZ = 3.0
"""Band in which the equation of motion is asked: gravity's and the links' inertia, little of what drives add."""
OVERSAMPLED = 16.0
"""Samples of the thinned motion a period of that band."""
MOST_SAMPLES = 20_000
"""Of all runs together; from longer ones the beginning is taken."""
CLEAR = 1.4
"""A remedy must leave so many times less torque than the record as it is, or make a mechanism where that makes none."""
ALIKE = 1.25
"""Of readings that leave less than so many times the least, those with the fewest changes are named."""
MOST_LEFT = 0.5
"""Largest torque residual of a right reading, as a share of the torque."""
GEAR_STEPS = np.exp(np.linspace(np.log(0.25), np.log(4.0), 25))
"""Factors of an angle that are tried; a gear ratio that is wrong by any factor lies near one."""
COUNT_SPANS = np.exp(np.linspace(np.log(0.1), np.log(20.0), 45))
"""Spans [rad] that are tried for an angle that goes further than any, as counts of an encoder do."""
GEAR_CLEAR = 1.18
"""As CLEAR, for a factor; and ..."""
NEAR_ONE = 0.1
"""... factors closer to one are the scatter of such a search. (Measured on 26 real records as they are: the best factor
beyond that leaves 1.00 to 1.16 times less.)"""
EQUAL = 1e-3
"""Residuals that differ by a smaller share are equal."""
FOLDS = 4
"""Parts of the records, each of which is predicted by the others."""
LEAST_SPAN, MOST_SPAN = 0.1, 20.0
"""How far an angle goes that was moved for an identification [rad]. A unit that makes it less is not tried; an angle
that goes further turned, or is in another unit, or in counts."""
DEGREE = float(np.pi / 180.0)


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
    """Residual as a share of the torque."""
    faults: tuple[str, ...]
    clear: float = CLEAR
    """How many times less it must leave than the record as it is."""


@dataclass(frozen=True)
class _Motion:
    """Filtered motion of all segments, thinned: (m, n) each, and the rows at which a segment ends."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    ends: tuple[int, ...]
    rate_hz: float


def as_it_is(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> Reading:
    """Least squares of the records as they are read now. Raises `FitError`."""
    return _read(_filtered(datasets, mechanism, options), mechanism, options, _nothing(mechanism.n))


def find_remedies(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float = 1.0
                  ) -> tuple[Reading, tuple[Reading, ...]]:
    """The records as they are, and the corrected readings, the best first; none if no correction helps.

    On the IMU path the pivot's columns are not corrected: the accelerometer checks them. Raises `FitError`.
    """
    motion = _filtered(datasets, mechanism, options)
    nothing = _read(motion, mechanism, options, _nothing(mechanism.n))
    imu = options.sensors == "imu"
    found = [_read(motion, mechanism, options, remedy)
             for remedy in _likely(mechanism, imu, gear_ratio, np.ptp(motion.q, axis=0))]
    for j in options.encoders_of(mechanism.n):
        span = float(np.ptp(motion.q[:, j]))
        steps = GEAR_STEPS if span < MOST_SPAN else COUNT_SPANS / span
        reading = _best_gear(motion, mechanism, options, j, steps)
        found += [] if reading is None else [replace(reading, clear=GEAR_CLEAR)]
    cures = [r for r in found if not r.faults and r.left < MOST_LEFT and _better(r, nothing, r.left, nothing.left)]
    if cures:
        held = _held_out(motion, mechanism, options, nothing.remedy)
        cures = [r for r in cures if (own := _held_out(motion, mechanism, options, r.remedy)) < MOST_LEFT
                 and _better(r, nothing, own, held)]
    least = min((r.left for r in cures), default=0.0)
    near = [r for r in cures if r.left <= ALIKE * least]
    fewest = min((r.remedy.changes for r in near), default=0)
    return nothing, tuple(sorted((r for r in near if r.remedy.changes == fewest), key=lambda r: round(r.left, 3)))


def _better(cured: Reading, nothing: Reading, left: float, as_it_is: float) -> bool:
    """Whether a remedy that leaves `left` is called for: far less, or no more where the record makes no mechanism."""
    alike = bool(nothing.faults) and not cured.remedy.scales
    return left <= (1.0 + EQUAL) * as_it_is if alike else left * cured.clear < as_it_is


def _nothing(n: int) -> Remedy:
    return Remedy("", "", np.eye(n), np.zeros(n), np.eye(n), 0)


def _filtered(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> _Motion:
    share = min(1.0, MOST_SAMPLES / max(sum(map(len, datasets)), 1))
    parts = [data.part(slice(0, max(int(share * len(data)), min(len(data), 200)))) for data in datasets]
    signals = split_signals(parts, mechanism, replace(options, hold="linear"))
    rate = signals[0].rate_hz
    band = min(SLOW_HZ, 0.1 * rate)
    thin = max(1, int(rate / (OVERSAMPLED * band)))
    segments = []
    for s in signals:
        k = differentiate(s, mechanism, min(4.0 * band, 0.4 * rate), options.filter_order, fused=True)
        tau = lowpass(s.torque, min(4.0 * band, 0.4 * rate), rate, options.filter_order)
        segments.append([x[::thin] for x in (*k, tau)])
    q, qd, qdd, tau = (np.concatenate(rows) for rows in zip(*segments))
    return _Motion(q, qd, qdd, tau, tuple(np.cumsum([len(rows[0]) for rows in segments])), rate / thin)


class _Equations(NamedTuple):
    """tau = Z beta of all segments under one reading, with constants of the driven joints behind the parameters."""

    z: FloatArray
    """(m, n, p + constants)"""
    tau: FloatArray
    """(m, n)"""
    free: NDArray[np.bool_]
    """(p + constants,)"""
    start: FloatArray
    """(p + constants,) of which those that are not free are kept"""
    samples_per_dof: float

    def solved(self, where: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """beta by the rows `where`, and its standard deviation."""
        with np.errstate(all="ignore"):
            found, covariance, _ = weighted_least_squares(self.z[where], self.tau[where], self.free, self.start,
                                                          self.samples_per_dof)
        return found, np.sqrt(np.maximum(np.diag(covariance), 0.0))

    def left(self, error: FloatArray) -> float:
        """`error` (m, n) as a share of the torque that the free parameters have to explain."""
        known = self.tau - self.z[:, :, ~self.free] @ self.start[~self.free]
        return float(np.sqrt(np.mean(error**2) / max(float(np.mean(known**2)), 1e-300)))


def _equations(motion: _Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy) -> _Equations | None:
    """None where all segments are too short."""
    q, qd, qdd = (x @ remedy.angles.T for x in (motion.q, motion.qd, motion.qdd))
    constants = np.zeros((len(q), mechanism.n, len(mechanism.actuated)))
    for column, j in enumerate(mechanism.actuated):
        constants[:, j, column] = 1.0
    free, beta = free_mask(mechanism, options)
    z = np.concatenate([mechanism.regressor(q + remedy.zero, qd, qdd), constants], axis=2)
    tau = motion.tau @ remedy.torques.T
    band = min(SLOW_HZ, 0.1 * motion.rate_hz)
    edge = int(0.5 * motion.rate_hz / band)
    zs, taus = [], []
    for where in np.split(np.arange(len(q)), motion.ends[:-1]):
        if len(where) > 4 * edge + 8:
            inner = slice(edge, len(where) - edge)
            zs.append(lowpass(z[where], band, motion.rate_hz, options.filter_order)[inner])
            taus.append(lowpass(tau[where], band, motion.rate_hz, options.filter_order)[inner])
    if not zs:
        return None
    offset = [k for j, k in mechanism.offset_columns.items() if j in mechanism.actuated]
    mask = np.append(free, np.ones(constants.shape[2], dtype=bool))
    mask[offset] = False  # the constants stand for them
    start = np.append(np.where(free, 0.0, beta), np.zeros(constants.shape[2]))
    return _Equations(np.concatenate(zs), np.concatenate(taus), mask, start, max(1.0, 0.5 * motion.rate_hz / band))


def _read(motion: _Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy) -> Reading:
    rows = _equations(motion, mechanism, options, remedy)
    if rows is None:
        return Reading(remedy, 1.0, ("too short",))
    found, std = rows.solved(np.arange(len(rows.z)))
    q = motion.q @ remedy.angles.T + remedy.zero
    return Reading(remedy, rows.left(rows.tau - rows.z @ found),
                   faults(mechanism, found[: mechanism.p], std[: mechanism.p], q))


def _held_out(motion: _Motion, mechanism: Mechanism, options: FitOptions, remedy: Remedy) -> float:
    """`left` of each of `FOLDS` parts of the records by the parameters of the others."""
    rows = _equations(motion, mechanism, options, remedy)
    if rows is None:
        return 1.0
    every = np.arange(len(rows.z))
    parts = np.array_split(every, FOLDS)
    return rows.left(np.concatenate([rows.tau[part] - rows.z[part] @ rows.solved(np.setdiff1d(every, part))[0]
                                     for part in parts]))


def _likely(mechanism: Mechanism, imu: bool, gear_ratio: float, span: FloatArray) -> Iterator[Remedy]:
    """The mistakes that people make, undone one by one and, where signs are concerned, together; `span` (n,) is how far
    each angle goes as it is read."""
    n, length = mechanism.n, mechanism.length_unit
    nothing, eye = _nothing(n), np.eye(n)
    angles = list(range(int(imu), n))
    name = {("q", j): angle_column(mechanism, j) for j in range(n)} | {
        ("tau", j): torque_column(mechanism, j) if mechanism.force_unit != "V" else "duty" for j in range(n)}
    signs = [("tau", j) for j in mechanism.actuated] + [("q", j) for j in angles]
    for count in range(1, len(signs) + 1):
        for which in combinations(signs, count):
            flip = {kind: np.diag([-1.0 if (kind, j) in which else 1.0 for j in range(n)]) for kind in ("q", "tau")}
            columns = [name[key] for key in which]
            looks = "looks" if count == 1 else "look"
            yield replace(nothing, angles=flip["q"], torques=flip["tau"], changes=count,
                          what=f"{' and '.join(columns)} {looks} negated",
                          write=f"turn the sign, {_set(columns, 'sign = -1')}")
    if length == "rad":
        for those in sorted({tuple(angles), *((j,) for j in angles)}):
            columns = [name["q", j] for j in those]
            for factor, what, unit in ((DEGREE, "in degrees", 'unit = "deg"'),
                                       (2.0 * np.pi, "in turns", 'unit = "turn"'), (1e-3, "in mrad", 'unit = "mrad"'),
                                       (1.0 / DEGREE, "converted from degrees twice", f"scale = {1.0 / DEGREE:.6g}")):
                if factor * span[list(those)].max() < LEAST_SPAN:
                    continue
                scaled = np.diag([factor if j in those else 1.0 for j in range(n)])
                looks = "looks" if len(those) == 1 else "look"
                yield replace(nothing, angles=scaled, what=f"{' and '.join(columns)} {looks} {what}",
                              write=_set(columns, unit))
    for j in angles:
        for factor, said in ((gear_ratio, "divided by the gear ratio twice"),
                             (1.0 / gear_ratio, "of the motor's side")):
            if gear_ratio != 1.0:
                yield replace(nothing, angles=np.diag([factor if i == j else 1.0 for i in range(n)]),
                              what=f"{name['q', j]} looks {said}", write=_set([name["q", j]], f"scale = {factor:.6g}"))
    for j in range(n):
        for k in range(j + 1, n):
            swapped = eye.copy()
            swapped[[j, k]] = swapped[[k, j]]
            if j in angles:
                yield replace(nothing, angles=swapped, what=f"{name['q', j]} and {name['q', k]} look interchanged",
                              write="give each the other's name under [columns]", changes=2)
            if j in mechanism.actuated and k in mechanism.actuated:
                yield replace(nothing, torques=swapped, what=f"{name['tau', j]} and {name['tau', k]} look interchanged",
                              write="give each the other's name under [columns]", changes=2)
                if j in angles:
                    yield replace(nothing, angles=swapped, torques=swapped, changes=3,
                                  what=f"joints {j + 1} and {k + 1} look interchanged",
                                  write="give each column the other's name under [columns]")
    if mechanism.gravity_mps2 > 0.0 and not imu and length == "rad":
        yield replace(nothing, zero=np.pi * eye[0], what=f"gravity looks upside down, or {name['q', 0]} counted from "
                      "upright", write=_set([name["q", 0]], "offset = 3.14159265"))
    if n > 1 and length == "rad":
        relative = eye.copy()
        for j in range(1, n):
            relative[j, j - 1] = -1.0
        if not imu:
            yield replace(nothing, angles=relative, what="the angles look absolute, each counted from the vertical",
                          write="subtract the angle of the link before from each before it is read", changes=2)


def _best_gear(motion: _Motion, mechanism: Mechanism, options: FitOptions, joint: int, factors: FloatArray
               ) -> Reading | None:
    """The factor of one joint's angle that leaves least, by search; None where it is near one, or gravity is absent."""
    if mechanism.length_unit == "m" or mechanism.gravity_mps2 == 0.0:
        return None
    column = angle_column(mechanism, joint)

    def at(log_factor: float) -> Reading:
        factor = float(np.exp(log_factor))
        scaled = np.diag([factor if j == joint else 1.0 for j in range(mechanism.n)])
        size = f"{1.0 / factor:.3g} times too large" if factor < 1 else f"{factor:.3g} times too small"
        entry = _set([column], f"scale = {factor:.4g}")
        write = f"correct the gear ratio that it was divided by, or {entry}" if factors is GEAR_STEPS else \
            f"{entry}, or what a count is exactly"
        return _read(motion, mechanism, options, Remedy(
            f"{column} looks {size}", write,
            scaled, np.zeros(mechanism.n), np.eye(mechanism.n), 2))

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


def _set(columns: Sequence[str], entry: str) -> str:
    """What to write into rig.toml for each of these columns."""
    return "set " + " and ".join(f'name = "{c}" and {entry} under [columns.{c}]' for c in columns)
