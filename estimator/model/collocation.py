"""The equation of motion on every sampling interval at once: two-point Gauss collocation.

Between two samples each joint's angle is the cubic through the angles and rates at both ends, and
tau = Z(q, qd, qdd) beta holds at the two Gauss points (fourth order for smooth motion). Angle, rate and
acceleration are one function, so they cannot contradict each other; a torque that jumps or kinks at a
sample is represented exactly, because nothing is asked of the acceleration across samples. The Coulomb
sign at a Gauss point is its exact mean over that half of the interval for a rate linear in time.

Everything is vectorised over intervals; the last array axis is the interval.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.model.features_numba import interval_features
from estimator.model.mechanism import Mechanism
from estimator.model.regressor_numba import FastTerms
from estimator.model.terms import ACCEL, ANGLE, RATE, RATE_FROM, RATE_TO, TERMS, Motion, Slope

Samples = slice | IndexArray
GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))
MOMENT = 2.0 * np.sqrt(3.0)
"""Half the difference of the values at the Gauss points, by the first moment that they stand for."""
SPLINE_REACH = 24
"""Samples beyond which a spline's slope feels nothing: 0.27^24 is 1e-14."""
HELD = "zero"
"""Hold of a torque that acts from its stamp until the next one: that of a digital controller."""
PAST = "past"
"""Hold of a reading that is the mean over the interval that ends at its stamp."""
TICKS = (2, 3, 4, 5, 10)
"""Ticks of a controller from one sample of its log to the next that are told apart; more are `smooth`."""
STEPPED = {HELD: 0.5, "average": 0.0, PAST: -0.5}
"""Holds of a torque that steps once a sample, to how late it acts in the mean [samples]."""
PARTS = {f"{hold}/{n}": late / n for hold, late in STEPPED.items() if late for n in TICKS}
"""Holds of a smooth torque between finer samples than the grid's, to how late it acts in the mean [samples]."""
HOLDS = (*STEPPED, *PARTS, "linear", "smooth")


def after(samples: Samples) -> Samples:
    """The samples one later; a slice stays one, for it costs no copies."""
    return slice(samples.start + 1, samples.stop + 1) if isinstance(samples, slice) else samples + 1


def hermite(s: float, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights of (q0, v0, q1, v1) in angle, rate and acceleration at fraction s of an interval dt; each (4,)."""
    angle = np.array([2 * s**3 - 3 * s**2 + 1, (s**3 - 2 * s**2 + s) * dt, -2 * s**3 + 3 * s**2, (s**3 - s**2) * dt])
    rate = np.array([(6 * s**2 - 6 * s) / dt, 3 * s**2 - 4 * s + 1, (-6 * s**2 + 6 * s) / dt, 3 * s**2 - 2 * s])
    accel = np.array([(12 * s - 6) / dt**2, (6 * s - 4) / dt, (-12 * s + 6) / dt**2, (6 * s - 2) / dt])
    return angle, rate, accel


def hold_weights(hold: str, late: float = 0.0) -> FloatArray:
    """(2, 2) torque at each Gauss point as weights of the samples at the interval's ends.

    `late` [samples] delays the torque further: of `zero` in [0, 1], where the sample before the interval's first takes
    the first one's place (it acts until `late`, the first one after), else of about half a sample at most.

    zero: the sample before. past: the sample after, which is the mean over the interval that ends at its stamp.
    linear: a ramp. average: a sample is the mean over a window centred on its stamp, so it acts until half-way. smooth:
    as linear; `Collocation.between` adds the curve. zero/N: held by a controller with N ticks a sample, of which the
    log has one: smooth, and late by `lag`. past/N: of a log with N samples for one of the grid, their mean. Raises
    ValueError for others.
    """
    if hold not in HOLDS:
        raise ValueError(f"hold {hold!r} is none of {HOLDS}")
    if hold == HELD and late:
        mean, moment = np.array([late, 1.0 - late]), 0.5 * MOMENT * late * (1.0 - late) * np.array([-1.0, 1.0])
        return np.stack([mean - moment, mean + moment])
    if hold == HELD:
        return np.array([[1.0, 0.0], [1.0, 0.0]])
    if hold == PAST:
        return np.array([[0.0, 1.0], [0.0, 1.0]])
    if hold == "average":
        return np.array([[1.0, 0.0], [0.0, 1.0]])
    return np.array([[1.0 - s, s] for s in (g - lag(hold) - late for g in GAUSS)])


def ticks_of(hold: str) -> int:
    """Ticks of the controller a sample of the log; 0 where the hold names no controller."""
    return 0 if not hold.startswith(HELD) else int(hold.partition("/")[2] or 1)


def lag(hold: str) -> float:
    """Samples by which a torque acts after its stamp in the mean: half a tick of the controller that holds it."""
    return STEPPED.get(hold, PARTS.get(hold, 0.0))


def curves(hold: str) -> bool:
    """Whether the torque between samples is a smooth curve through them."""
    return hold == "smooth" or hold in PARTS


def spline_slopes(u: FloatArray) -> FloatArray:
    """(N, n) slopes, per sample, of the cubic spline through u (N, n), continued by odd reflection beyond its ends.

    Slopes d of a cubic spline obey d[k-1] + 4 d[k] + d[k+1] = 3 (u[k+1] - u[k-1]); the inverse of (1, 4, 1) falls off
    by 2 - sqrt(3) a sample. Held to SciPy's `CubicSpline` by a test; that takes a third of a second to import.
    """
    pad = min(SPLINE_REACH + 1, len(u) - 1)
    wide = np.concatenate([2.0 * u[:1] - u[pad:0:-1], u, 2.0 * u[-1:] - u[-2 : -pad - 2 : -1]])
    weights = (np.sqrt(3.0) - 2.0) ** np.abs(np.arange(1 - pad, pad))
    weights /= 2.0 * weights.sum()  # 3 times an inverse whose rows sum to 1/6
    return np.stack([np.convolve(x[2:] - x[:-2], weights, "valid") for x in wide.T], axis=-1)


def _bend(s: float, d0: FloatArray, d1: FloatArray, rise: FloatArray) -> FloatArray:
    """(n, K) what a cubic with slopes d0, d1 and this rise over an interval has over a straight line at fraction s."""
    bend: FloatArray = (s**3 - 2 * s**2 + s) * d0 + (s**3 - s**2) * d1 + (3 * s**2 - 2 * s**3 - s) * rise
    return bend


class Collocation:
    """Regressor and derivatives at the Gauss points for one mechanism, step and hold."""

    def __init__(self, mechanism: Mechanism, dt_s: float, hold: str, late: float = 0.0) -> None:
        """`late`: further delay of the torque [samples], see `hold_weights`."""
        self.mechanism, self.dt, self.hold, self.late = mechanism, dt_s, hold, late

    @cached_property
    def basis(self) -> FloatArray:
        """(2, 5, 4) weights of (q0, v0, q1, v1) in each feature at each Gauss point."""
        basis = np.empty((2, 5, 4))
        for g, s in enumerate(GAUSS):
            basis[g, ANGLE], basis[g, RATE], basis[g, ACCEL] = hermite(s, self.dt)
            basis[g, RATE_FROM] = hermite(0.5 * g, self.dt)[1]
            basis[g, RATE_TO] = hermite(0.5 * (g + 1), self.dt)[1]
        return basis

    @cached_property
    def torque_weights(self) -> FloatArray:
        """(2, 2) of `hold_weights`."""
        return hold_weights(self.hold, self.late)

    def motion(self, q: FloatArray, v: FloatArray, left: Samples) -> Motion:
        """Features on the intervals from each sample of `left` to the next; q, v (N, n)."""
        samples = np.arange(left.start, left.stop) if isinstance(left, slice) else left
        return Motion(*interval_features(q, v, samples, self.basis))

    def torque(self, u: FloatArray, left: Samples) -> FloatArray:
        """Torque at the Gauss points (n, 2, K) from samples u (N, n)."""
        w = self.torque_weights
        return w[:, 0, None] * u[left].T[:, None, :] + w[:, 1, None] * u[after(left)].T[:, None, :]

    def between(self, u: FloatArray, ends: IndexArray) -> FloatArray | None:
        """Torque at the Gauss points beyond `torque` (n, 2, K), from samples u (N, n) of segments that end before
        samples `ends`: of a smooth torque, what its spline has over a straight line. None for holds without a curve.

        A straight line between samples of what curves is low by the square of the step: of a torque of 3 Hz on a grid
        of 100 Hz 0.3 %, and all inertias come out smaller by as much. The Gauss points stand for integral and first
        moment, here those of the cubic with the spline's slopes at both samples.
        """
        if not curves(self.hold):
            return None
        parts, late = [], lag(self.hold) + self.late
        for part in np.split(u, ends[:-1]):
            d = spline_slopes(part).T
            d0, d1, rise = d[:, :-1], d[:, 1:], np.diff(part, axis=0).T
            if late:
                parts.append(np.stack([_bend(g - late, d0, d1, rise) for g in GAUSS], axis=1))
                continue
            moment = MOMENT * (rise / 60.0 - (d0 + d1) / 120.0)
            parts.append(np.stack([(d0 - d1) / 12.0 - moment, (d0 - d1) / 12.0 + moment], axis=1))
        return np.concatenate(parts, axis=2)

    def terms(self, motion: Motion) -> tuple[FloatArray, list[list[Slope]]]:
        """Z (p, n, 2, K) in link rows for rigid terms, joint rows for the others, and each term's slopes.

        Rigid terms live in absolute link angles; `to_joint` turns rows, and features, to joint ones.
        """
        m, t = self.mechanism, self.mechanism.transform
        links = motion._replace(angle=m.from_zero(_turned(t, motion.angle)), rate=_turned(t, motion.rate),
                                accel=_turned(t, motion.accel))
        z = np.zeros((m.p, m.n, *motion.angle.shape[1:]))
        slopes: list[list[Slope]] = []
        for k, parameter in enumerate(m.parameters):
            parts, found = TERMS[parameter.term].linearised(parameter.at, links if parameter.rigid else motion, m.world)
            for row, values in parts:
                z[k, row] = values
            slopes.append(found)
        return z, slopes

    @cached_property
    def fast(self) -> FastTerms:
        """Regressor in joint rows and its slopes at one beta, compiled."""
        return FastTerms(self.mechanism)

    @cached_property
    def _rigid(self) -> BoolArray:
        return np.array([parameter.rigid for parameter in self.mechanism.parameters])

    def to_joint(self, z: FloatArray) -> FloatArray:
        """Z (p, n, 2, K) with every row a joint's."""
        out, rigid = z.copy(), z[self._rigid]
        transposed = self.mechanism.transform.T @ rigid.reshape(*rigid.shape[:2], -1)
        out[self._rigid] = transposed.reshape(rigid.shape)
        return out

    def jacobian(self, slopes: list[list[Slope]], beta: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """d(Z beta)/d(q0, v0, q1, v1): (n, 2, 4, n, K), row joint, Gauss point, end variable, its joint."""
        return self.by_ends(self._slopes(slopes, beta, shape))

    def by_ends(self, own: FloatArray, added: FloatArray | None = None) -> FloatArray:
        """`jacobian` from derivatives by the features of the motion (n, 2, 5, n, K).

        `added` (n, 5, n, 2, K) are derivatives by features of torque that comes from elsewhere.
        """
        n, count = self.mechanism.n, own.shape[-1]
        if added is not None:
            own = own + added.transpose(0, 3, 1, 2, 4)
        jac = self.basis.swapaxes(1, 2) @ own.reshape(n, 2, 5, n * count)
        return jac.reshape(n, 2, 4, n, count)

    def feature_slopes(self, slopes: list[list[Slope]], beta: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """d(Z beta)/d(features): (n, 5, n, *shape), row joint, feature, its joint."""
        return self._slopes(slopes, beta, shape).transpose(0, 2, 3, 1, 4)

    def _slopes(self, slopes: list[list[Slope]], beta: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """(n, S, 5, n, K) of shape (S, K)."""
        n, t = self.mechanism.n, self.mechanism.transform
        points, count = shape
        rigid = np.zeros((n, points, 3, n, count))
        own = np.zeros((n, points, 5, n, count))
        for k, found in enumerate(slopes):
            target = rigid if self._rigid[k] else own
            for slope in found:
                target[slope.row, :, slope.feature, slope.joint] += beta[k] * slope.value
        own[:, :, :3] += t.T @ (t.T @ rigid.reshape(n, -1)).reshape(rigid.shape)
        return own


def _turned(transform: FloatArray, values: FloatArray) -> FloatArray:
    """Of links (n, S, K) from those of joints."""
    return (transform @ values.reshape(len(values), -1)).reshape(values.shape)
