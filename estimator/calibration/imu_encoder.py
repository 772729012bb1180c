"""Errors of an IMU by an encoder at the IMU's own link: scales, biases, lag, lever arm.

    gyro  = (1 + s) qd + b
    accel = U R(turn) (l qdd - e qd^2 + g sin q, -l qd^2 - e qdd - g cos q) + b_a,    U = [[1 + s_x, k], [k, 1 + s_y]]

each late by a time of its own. Readings and angle go through one zero-phase low pass, and are compared in its band.
The encoder's derivatives are noisy regressors, which least squares would shrink: the gyro's rate and its derivative
are the instruments for them, the encoder's for the gyro's. Parameters come from the first blocks of time, the others
say what they are worth. Intervals are from leaving out one block after the other, so that coloured errors count.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from daq import FloatArray
from estimator.errors import FitError
from estimator.numerics import student_quantile
from estimator.signals import lowpass

SIGNALS = ("gyro_radps", "accel_x_mps2", "accel_y_mps2", "angle_rad")
"""What is compared; the last is the angle that the accelerometer shows, atan2(a_x, -a_y)."""
BLOCKS, FEWEST, BLOCK_S = 40, 12, 1.0
"""Most and fewest blocks, and the shortest: longer than the errors are coloured, one cycle of a leg or so."""
FARTHEST_S = 0.1
ITERATIONS = 30
STEP = 1e-6
FARTHEST_SCALE = 0.3
MOVING = 0.2
"""Share of the median's motion that a block must have for a lag of its own."""
WANDER = 0.1
"""Lags that differ by less than this share of a sample are one lag."""
SLOW = 3.0
"""Standard deviations by which the lags' successive differences must fall short of independent ones."""


class Term(NamedTuple):
    """One error of the IMU."""

    name: str
    meaning: str
    unit: str
    prior: float
    """Spread of what may be: far beyond any working IMU, it keeps finite what the motion does not tell."""
    widest: float
    """Half of a 95 % interval beyond which the term counts as not determined."""


GYRO = (Term("gyro_bias", "gyro bias", "rad/s", 0.5, 0.02),
        Term("gyro_scale", "gyro scale, beyond 1", "", 0.5, 0.03),
        Term("gyro_late", "gyro late by", "s", 0.1, 0.003))
ACCEL = (Term("accel_bias_x", "accelerometer bias x", "m/s2", 3.0, 0.1),
         Term("accel_bias_y", "accelerometer bias y", "m/s2", 3.0, 0.1),
         Term("accel_scale_x", "accelerometer scale x, beyond 1", "", 0.5, 0.03),
         Term("accel_scale_y", "accelerometer scale y, beyond 1", "", 0.5, 0.03),
         Term("accel_skew", "x into y and y into x alike", "", 0.5, 0.03),
         Term("accel_turn", "angle by gravity beyond the encoder's", "rad", 0.5, 0.03),
         Term("lever_arm", "lever arm", "m", 1.0, 0.02),
         Term("side_offset", "IMU off the line from the pivot", "m", 1.0, 0.02),
         Term("accel_late", "accelerometer late by", "s", 0.1, 0.003))
LEVER, SIDE_OFFSET, LATE = 6, 7, 8
"""Of `ACCEL`: those that are held where the motion does not tell them, so that they do not spoil the others."""
HELD = 1e-9
Predict = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]


class Segment(NamedTuple):
    """Samples of one run without a gap."""

    q_rad: FloatArray
    """(n,)"""
    imu: FloatArray
    """(n, 3) gyro, accelerometer x and y, as the link's frame has them."""


@dataclass(frozen=True)
class Found:
    """One term's value."""

    term: Term
    value: float
    half: float
    """Half of the 95 % interval."""

    @property
    def determined(self) -> bool:
        return bool(self.half <= self.term.widest)


@dataclass(frozen=True)
class EncoderFit:
    """Result, with intervals and errors on blocks not fitted."""

    found: tuple[Found, ...]
    """Of `GYRO`, then `ACCEL`."""
    held: tuple[str, ...]
    """Terms that this motion does not determine. Fixed values: the given lever arm, side offset 0, the gyro's lag."""
    lags_s: FloatArray
    """(k,) the gyro's lag by block of the whole record, blocks with little motion left out."""
    lag_wanders: bool
    """The lags come and go slowly: they were taken out block by block, and there is no one lag."""
    before: FloatArray
    """(4, 2) of `SIGNALS`: rms of reading less encoder over the blocks not fitted, and half its 95 % interval."""
    after: FloatArray
    """The same with all terms taken out."""
    fitted_s: float
    checked_s: float
    block_s: float
    blocks: int
    """That were fitted."""
    cutoff_hz: float

    def __getitem__(self, name: str) -> Found:
        return next(f for f in self.found if f.term.name == name)


def fit_imu(segments: Sequence[Segment], rate_hz: float, cutoff_hz: float, lever_m: float, gravity_mps2: float,
            lag_s: float = 0.0) -> EncoderFit:
    """Errors of the IMU; `lever_m` is what is known of the lever arm, `lag_s` a first guess.

    Raises `FitError` for too short a record, one that does not move, or a lag that is not found.
    """
    pieces = _cut(segments, rate_hz, cutoff_hz)
    count = sum(len(p.blocks) for p in pieces)
    if count < FEWEST:
        raise FitError(f"{count} s without a gap are too few, at least {FEWEST} blocks of {BLOCK_S:g} s are needed: "
                       "record for longer")
    if max(float(np.ptp(p.q)) for p in pieces) < 0.1:
        raise FitError("the encoder moves by less than 0.1 rad: swing or drive the link while it is recorded")
    shift = [np.full(p.q.size, lag_s) for p in pieces]

    gyro = _Fit(pieces, (0,), GYRO, _gyro, [p.encoder for p in pieces], np.zeros(3))
    gyro.run(shift)
    lags, at = gyro.block_lags(shift)
    wanders = _wanders(lags, rate_hz)
    if wanders:
        shift = [np.interp(np.arange(p.q.size), *_knots(at, lags, k)) for k, p in enumerate(pieces)]
        gyro.theta[-1] = 0.0
        gyro.run(shift)
    by_gyro = [p.by_gyro(s + gyro.theta[-1], gyro.theta) for p, s in zip(pieces, shift)]

    predict = partial(accelerometer, gravity_mps2=gravity_mps2)
    start = np.zeros(len(ACCEL))
    start[LEVER], start[LATE] = lever_m, gyro.theta[-1]
    accel = _Fit(pieces, (1, 2), ACCEL, predict, by_gyro, start)
    accel.run(shift)
    half = accel.half()
    held = [k for k in (LEVER, SIDE_OFFSET, LATE) if half[k] > ACCEL[k].widest]
    if held:
        accel = _Fit(pieces, (1, 2), ACCEL, predict, by_gyro, start)
        accel.prior[held] = HELD
        accel.run(shift)
    for part, scales in ((gyro, [1]), (accel, [2, 3, 4, 5])):
        if np.abs(part.theta[scales]).max() > FARTHEST_SCALE:
            raise FitError(f"IMU and encoder do not show one motion: a scale or angle comes out {FARTHEST_SCALE:g} off "
                           "or more; check axes and signs (legid doctor --move), and that the two sit on one link")
    before, after = _check(pieces, shift, gyro, accel, start)
    fitted = _fitted(count)
    seconds = sum(b.stop - b.start for p in pieces for b in p.blocks) / rate_hz
    found = []
    for part in (gyro, accel):
        value, half = part.theta.copy(), part.half()
        value[-1] += float(np.mean(np.concatenate(shift)))
        half[-1] = np.inf if wanders else half[-1]
        found += [Found(t, float(v), float(h)) for t, v, h in zip(part.terms, value, half)]
    return EncoderFit(tuple(found), tuple(ACCEL[k].name for k in held), lags, wanders, before, after,
                      seconds * fitted / count, seconds * (1 - fitted / count), seconds / count, fitted, cutoff_hz)


def accelerometer(theta: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity_mps2: float) -> FloatArray:
    """(n, 2) readings by the module's formula; theta as `ACCEL`, its lag not used."""
    bias_x, bias_y, scale_x, scale_y, skew, turn, lever, side_offset = theta[:8]
    x = lever * qdd - side_offset * qd**2 + gravity_mps2 * np.sin(q)
    y = -lever * qd**2 - side_offset * qdd - gravity_mps2 * np.cos(q)
    c, s = np.cos(turn), np.sin(turn)
    x, y = c * x - s * y, s * x + c * y
    return np.column_stack([(1 + scale_x) * x + skew * y + bias_x, skew * x + (1 + scale_y) * y + bias_y])


def _gyro(theta: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
    return np.asarray((theta[0] + (1.0 + theta[1]) * qd)[:, None])


class _Motion(NamedTuple):
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


class _Piece:
    """A segment, low-passed, with its blocks."""

    def __init__(self, segment: Segment, rate_hz: float, cutoff_hz: float, trim: int) -> None:
        n = segment.q_rad.size
        self.dt = 1.0 / rate_hz
        self.worth = min(2.0 * cutoff_hz / rate_hz, 1.0)
        """Independent samples a sample, of noise that fills the band."""
        time = np.arange(n) * self.dt
        self.time = time[trim: n - trim]
        angle = CubicSpline(time, lowpass(segment.q_rad, cutoff_hz, rate_hz))
        self.imu = CubicSpline(time, lowpass(segment.imu, cutoff_hz, rate_hz))
        self.q = angle(self.time)
        self.encoder = _Motion(self.q, angle(self.time, 1), angle(self.time, 2))
        self.blocks: list[slice] = []

    def by_gyro(self, late: FloatArray, theta: FloatArray) -> _Motion:
        """The motion with rate and acceleration of the gyro, its errors taken out."""
        rate = (self.imu(self.time + late)[:, 0] - theta[0]) / (1.0 + theta[1])
        return _Motion(self.q, rate, self.imu(self.time + late, 1)[:, 0] / (1.0 + theta[1]))


def _cut(segments: Sequence[Segment], rate_hz: float, cutoff_hz: float) -> list[_Piece]:
    """Pieces with their blocks, all of about one length; what is near an end, where the filter rings, is left out."""
    trim = int(np.ceil(rate_hz * max(2.0 / cutoff_hz, 1.2 * FARTHEST_S)))
    least = int(np.ceil(BLOCK_S * rate_hz))
    pieces = [_Piece(s, rate_hz, cutoff_hz, trim) for s in segments if s.q_rad.size >= 2 * trim + least]
    size = max(least, sum(p.q.size for p in pieces) // BLOCKS)
    for piece in pieces:
        edges = np.linspace(0, piece.q.size, max(piece.q.size // size, 1) + 1).astype(int)
        piece.blocks = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    return pieces


def _fitted(count: int) -> int:
    return (count + 1) // 2


class _Fit:
    """Gauss-Newton with instruments over the first blocks. Term -1 of theta is a lag in addition to the given one."""

    def __init__(self, pieces: Sequence[_Piece], columns: tuple[int, ...], terms: tuple[Term, ...], predict: Predict,
                 instruments: Sequence[_Motion], start: FloatArray) -> None:
        self.pieces, self.columns, self.terms, self.predict = pieces, columns, terms, predict
        self.instruments, self.start, self.theta = instruments, start, start.copy()
        self.prior = np.array([t.prior for t in terms])
        self.normals = self.rights = np.zeros(0)
        self.weight = np.zeros(len(terms))

    def run(self, shift: Sequence[FloatArray]) -> None:
        """Find theta, readings taken later by `shift` (n,) of each piece. Raises `FitError` for a lag out of reach."""
        for _ in range(ITERATIONS):
            self.normals, self.rights, variance = self._blocks(shift)
            half = _fitted(len(self.normals))
            self.weight = variance / self.pieces[0].worth / self.prior**2
            move = self._solve(self.normals[:half].sum(axis=0), self.rights[:half].sum(axis=0))
            self.theta = self.theta + move
            if abs(self.theta[-1]) > FARTHEST_S or not np.isfinite(self.theta).all():
                raise FitError(f"the IMU's lag against the encoder comes out beyond {FARTHEST_S:g} s: check that they "
                               "belong together, their signs and their clocks")
            if np.all(np.abs(move) < 1e-6 * self.prior):
                break
        self.normals, self.rights, variance = self._blocks(shift)

    def _solve(self, normal: FloatArray, right: FloatArray) -> FloatArray:
        """Step that the normal equations ask for, the prior included."""
        away = self.weight * (self.start - self.theta)
        return np.asarray(np.linalg.solve(normal + np.diag(self.weight), right + away))

    def _blocks(self, shift: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, float]:
        """By block Z'X (b, p, p) and Z'r (b, p), and the residual's variance over the fitted ones."""
        normals, rights, squares = [], [], []
        for piece, late, motion in zip(self.pieces, shift, self.instruments):
            at = piece.time + late + self.theta[-1]
            reading, slope = (piece.imu(at, k)[:, self.columns] for k in (0, 1))
            left = reading - self.predict(self.theta, *piece.encoder)
            x, z = self._slopes(piece.encoder, slope), self._slopes(motion, None, piece.dt)
            for b in piece.blocks:
                zb, xb, rb = (a[b].reshape(-1, a.shape[-1]) for a in (z, x, left[:, :, None]))
                normals.append(zb.T @ xb)
                rights.append(zb.T @ rb[:, 0])
                squares.append(float(np.mean(rb**2)))
        return np.array(normals), np.array(rights), float(np.mean(squares[: _fitted(len(squares))]))

    def _slopes(self, motion: _Motion, slope: FloatArray | None, dt: float = 0.0) -> FloatArray:
        """(n, c, p) derivative of the reading by theta; that by the lag is the `slope` of the reading, or the model's.
        """
        columns = []
        for k in range(self.theta.size - 1):
            step = STEP * np.eye(self.theta.size)[k]
            columns.append((self.predict(self.theta + step, *motion) - self.predict(self.theta - step, *motion))
                           / (2 * STEP))
        if slope is None:
            slope = np.gradient(self.predict(self.theta, *motion), dt, axis=0)
        return np.stack([*columns, -slope], axis=2)

    def half(self) -> FloatArray:
        """(p,) half of each 95 % interval: jackknife over the fitted blocks, and what the prior alone holds."""
        fitted = _fitted(len(self.normals))
        whole, right = self.normals[:fitted].sum(axis=0), self.rights[:fitted].sum(axis=0)
        moves = np.array([self._solve(whole - n, right - r) for n, r in
                          zip(self.normals[:fitted], self.rights[:fitted])])
        moves -= moves.mean(axis=0)
        bread = np.linalg.inv(whole + np.diag(self.weight))
        prior = np.einsum("ij,j,ij->i", bread, self.weight, bread) * self._noise()
        variance = (fitted - 1) / fitted * np.sum(moves**2, axis=0) + prior
        return np.asarray(student_quantile(fitted - 1) * np.sqrt(variance))

    def _noise(self) -> float:
        """Variance that the weights were made with."""
        return float(self.weight[0] * self.prior[0] ** 2)

    def block_lags(self, shift: Sequence[FloatArray]) -> tuple[FloatArray, list[tuple[int, float]]]:
        """(k,) lag by block, everything else as fitted, and (piece, sample) of each block's middle."""
        where = [(k, 0.5 * (b.start + b.stop - 1)) for k, p in enumerate(self.pieces) for b in p.blocks]
        motion = self.normals[:, -1, -1]
        keep = np.flatnonzero(motion > MOVING * np.median(motion))
        base = np.array([shift[k][int(at)] for k, at in where]) + self.theta[-1]
        lags = base[keep] + self.rights[keep, -1] / motion[keep]
        return lags, [where[k] for k in keep]


def _wanders(lags: FloatArray, rate_hz: float) -> bool:
    """Whether neighbours are more alike than chance has it (von Neumann's ratio), by an amount that counts."""
    n = lags.size
    if n < 4 or np.ptp(lags) < WANDER / rate_hz:
        return False
    ratio = float(np.sum(np.diff(lags) ** 2) / np.sum((lags - lags.mean()) ** 2)) * n / (n - 1)
    return ratio < 2.0 - SLOW * np.sqrt(4.0 * (n - 2) / (n**2 - 1))


def _knots(at: Sequence[tuple[int, float]], lags: FloatArray, piece: int) -> tuple[FloatArray, FloatArray]:
    """Samples and lags of one piece's blocks; the mean lag where it has none."""
    own = [(sample, lag) for (k, sample), lag in zip(at, lags) if k == piece] or [(0.0, float(lags.mean()))]
    samples, values = zip(*own)
    return np.array(samples), np.array(values)


def _check(pieces: Sequence[_Piece], shift: Sequence[FloatArray], gyro: _Fit, accel: _Fit, start: FloatArray,
           ) -> tuple[FloatArray, FloatArray]:
    """(4, 2) rms residual of the blocks not fitted, with half of its interval, before and after."""
    before: list[FloatArray] = []
    after: list[FloatArray] = []
    for piece, late in zip(pieces, shift):
        raw = piece.imu(piece.time)
        plain = np.column_stack([piece.encoder.qd, accel.predict(start, *piece.encoder)])
        known = np.column_stack([gyro.predict(gyro.theta, *piece.encoder), accel.predict(accel.theta, *piece.encoder)])
        late_gyro, late_accel = (piece.imu(piece.time + late + part.theta[-1]) for part in (gyro, accel))
        read = np.column_stack([late_gyro[:, 0], late_accel[:, 1:]])
        for reading, model, out in ((raw, plain, before), (read, known, after)):
            turn = _angle(reading) - _angle(model)
            left = np.column_stack([reading - model, (turn + np.pi) % (2 * np.pi) - np.pi])
            out += [np.mean(left[b] ** 2, axis=0) for b in piece.blocks]
    rest = slice(_fitted(len(before)), None)
    first, second = (np.array([_rms(column) for column in np.array(squares)[rest].T]) for squares in (before, after))
    return first, second


def _angle(imu: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(imu[:, 1], -imu[:, 2]))


def _rms(squares: FloatArray) -> tuple[float, float]:
    """(rms, half of its 95 % interval) from the blocks' mean squares."""
    rms = float(np.sqrt(squares.mean()))
    half = student_quantile(squares.size - 1) * float(squares.std(ddof=1)) / np.sqrt(squares.size)
    return rms, half / (2.0 * rms)
