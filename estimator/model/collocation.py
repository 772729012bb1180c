"""The equation of motion on every sampling interval at once: two-point Gauss collocation.

Between two samples each joint's angle is the cubic through the angles and rates at both ends, and
tau = Z(q, qd, qdd) beta holds at the two Gauss points (fourth order for smooth motion). Angle, rate and
acceleration are one function, so they cannot contradict each other; a torque that jumps or kinks at a
sample is represented exactly, because nothing is asked of the acceleration across samples. The Coulomb
sign at a Gauss point is its exact mean over that half of the interval for a rate linear in time.

Everything is vectorised over intervals; the last array axis is the interval.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from daq import FloatArray
from estimator.model.mechanism import Mechanism
from estimator.model.regressor_numba import FastTerms
from estimator.numerics import jit

Samples = slice | NDArray[np.intp]
GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))
MOMENT = 2.0 * np.sqrt(3.0)
"""Half the difference of the values at the Gauss points, by the first moment that they stand for."""
HOLDS = ("zero", "linear", "average", "smooth")
ANGLE, RATE, ACCEL, RATE_FROM, RATE_TO = range(5)
"""Features of the motion at a Gauss point; the last two are the rates at the ends of its half interval."""


def after(samples: Samples) -> Samples:
    """The samples one later; a slice stays one, for it costs no copies."""
    return slice(samples.start + 1, samples.stop + 1) if isinstance(samples, slice) else samples + 1


def hermite(s: float, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights of (q0, v0, q1, v1) in angle, rate and acceleration at fraction s of an interval dt; each (4,)."""
    angle = np.array([2 * s**3 - 3 * s**2 + 1, (s**3 - 2 * s**2 + s) * dt, -2 * s**3 + 3 * s**2, (s**3 - s**2) * dt])
    rate = np.array([(6 * s**2 - 6 * s) / dt, 3 * s**2 - 4 * s + 1, (-6 * s**2 + 6 * s) / dt, 3 * s**2 - 2 * s])
    accel = np.array([(12 * s - 6) / dt**2, (6 * s - 4) / dt, (-12 * s + 6) / dt**2, (6 * s - 2) / dt])
    return angle, rate, accel


def hold_weights(hold: str) -> FloatArray:
    """(2, 2) torque at each Gauss point as weights of the samples at the interval's ends.

    zero: the sample before. linear: a ramp. average: a sample is the mean over a window centred on its
    stamp, so it acts until half-way. smooth: as linear; `Collocation.between` adds the curve.
    """
    if hold == "zero":
        return np.array([[1.0, 0.0], [1.0, 0.0]])
    if hold == "average":
        return np.array([[1.0, 0.0], [0.0, 1.0]])
    return np.array([[1.0 - GAUSS[0], GAUSS[0]], [1.0 - GAUSS[1], GAUSS[1]]])


def invert_small(matrices: FloatArray) -> FloatArray:
    """Inverses of many small matrices (n, n, N) with sound pivots, by Gauss-Jordan on all of them at once.

    A vanishing pivot gives values that are not finite.
    """
    a = matrices.copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k in range(a.shape[0]):
            pivot, column = 1.0 / a[k, k], a[:, k].copy()
            row = a[k] * pivot
            a -= column[:, None] * row
            a[:, k] = column * -pivot
            a[k] = row
            a[k, k] = pivot
    return a


def mean_sign(a: FloatArray, b: FloatArray, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean of v / sqrt(v^2 + scale^2) for v running linearly from a to b, and its derivatives by a and b.

    It is (a + b) / (|a|_scale + |b|_scale), with |v|_scale the root.
    """
    ra, rb = np.sqrt(a * a + scale**2), np.sqrt(b * b + scale**2)
    total = ra + rb
    mean = (a + b) / total
    return mean, (1.0 - mean * a / ra) / total, (1.0 - mean * b / rb) / total


class Motion(NamedTuple):
    """Features at the Gauss points of K intervals; each array (n, 2, K)."""

    angle: FloatArray
    rate: FloatArray
    accel: FloatArray
    rate_from: FloatArray
    rate_to: FloatArray


@dataclass(frozen=True)
class Slope:
    """One non-zero derivative of one parameter's term."""

    row: int
    feature: int
    joint: int
    value: FloatArray | float
    """(2, K)"""


class Collocation:
    """Regressor and derivatives at the Gauss points for one mechanism, step and hold."""

    def __init__(self, mechanism: Mechanism, dt_s: float, hold: str) -> None:
        self.mechanism, self.dt, self.hold = mechanism, dt_s, hold

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
        return hold_weights(self.hold)

    def motion(self, q: FloatArray, v: FloatArray, left: Samples) -> Motion:
        """Features on the intervals from each sample of `left` to the next; q, v (N, n)."""
        right = after(left)
        ends = np.stack([q[left].T, v[left].T, q[right].T, v[right].T], axis=1)
        n, _, count = ends.shape
        features = self.basis.transpose(1, 0, 2).reshape(10, 4) @ ends
        return Motion(*features.reshape(n, 5, 2, count).swapaxes(0, 1).copy())

    def torque(self, u: FloatArray, left: Samples) -> FloatArray:
        """Torque at the Gauss points (n, 2, K) from samples u (N, n)."""
        w = self.torque_weights
        return w[:, 0, None] * u[left].T[:, None, :] + w[:, 1, None] * u[after(left)].T[:, None, :]

    def between(self, u: FloatArray, ends: NDArray[np.intp]) -> FloatArray | None:
        """Torque at the Gauss points beyond `torque` (n, 2, K), from samples u (N, n) of stretches that end before
        samples `ends`: of a smooth torque, what its spline has over a straight line. None for the other holds.

        A straight line between samples of what curves is low by the square of the step: of a torque of 3 Hz on a grid
        of 100 Hz 0.3 %, and all inertias come out smaller by as much. The Gauss points stand for integral and first
        moment, here those of the cubic with the spline's slopes at both samples.
        """
        if self.hold != "smooth":
            return None
        parts = []
        for part in np.split(u, ends[:-1]):
            d = CubicSpline(np.arange(len(part)), part).derivative()(np.arange(len(part))).T
            d0, d1, rise = d[:, :-1], d[:, 1:], np.diff(part, axis=0).T
            moment = MOMENT * (rise / 60.0 - (d0 + d1) / 120.0)
            parts.append(np.stack([(d0 - d1) / 12.0 - moment, (d0 - d1) / 12.0 + moment], axis=1))
        return np.concatenate(parts, axis=2)

    def terms(self, motion: Motion) -> tuple[FloatArray, list[list[Slope]]]:
        """Z (p, n, 2, K) in link rows for rigid terms, joint rows for the others, and each term's slopes.

        Rigid terms live in absolute link angles; `to_joint` turns rows, and features, to joint ones.
        """
        m = self.mechanism
        t = m.transform
        theta, thetad, thetadd = ((t @ x.reshape(m.n, -1)).reshape(x.shape)
                                  for x in (motion.angle, motion.rate, motion.accel))
        z = np.zeros((m.p, m.n, *motion.angle.shape[1:]))
        slopes: list[list[Slope]] = []
        for k, (_, _, _, term, at) in enumerate(m.parameters):
            if term == "inertia":
                i, j = at
                if i == j:
                    z[k, i] = thetadd[i]
                    slopes.append([Slope(i, ACCEL, i, 1.0)])
                    continue
                c, s = np.cos(theta[i] - theta[j]), np.sin(theta[i] - theta[j])
                si, sj = s * thetad[i], s * thetad[j]
                z[k, i] = c * thetadd[j] + sj * thetad[j]
                z[k, j] = c * thetadd[i] - si * thetad[i]
                di = c * thetad[j] ** 2 - s * thetadd[j]
                dj = -c * thetad[i] ** 2 - s * thetadd[i]
                slopes.append([
                    Slope(i, ANGLE, i, di), Slope(i, ANGLE, j, -di), Slope(i, RATE, j, 2 * sj), Slope(i, ACCEL, j, c),
                    Slope(j, ANGLE, i, dj), Slope(j, ANGLE, j, -dj), Slope(j, RATE, i, -2 * si), Slope(j, ACCEL, i, c)])
            elif term == "gravity":
                i = at[0]
                z[k, i] = m.gravity * np.sin(theta[i])
                slopes.append([Slope(i, ANGLE, i, m.gravity * np.cos(theta[i]))])
            else:
                j = at[0]
                z[k, j], found = self._joint_term(term, j, motion)
                slopes.append(found)
        return z, slopes

    def _joint_term(self, term: str, j: int, motion: Motion) -> tuple[FloatArray, list[Slope]]:
        if term == "viscous":
            return motion.rate[j], [Slope(j, RATE, j, 1.0)]
        if term == "rotor":
            return motion.accel[j], [Slope(j, ACCEL, j, 1.0)]
        if term == "offset":
            return np.ones_like(motion.rate[j]), []
        mean, by_from, by_to = mean_sign(motion.rate_from[j], motion.rate_to[j], self.mechanism.velocity_scale)
        return mean, [Slope(j, RATE_FROM, j, by_from), Slope(j, RATE_TO, j, by_to)]

    @cached_property
    def fast(self) -> FastTerms:
        """The compiled counterpart of `evaluate`."""
        return FastTerms(self.mechanism)

    def evaluate(self, motion: Motion, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Z (p, n, S, K) in joint rows and d(Z beta)/d(features) (n, S, 5, n, K) at S points an interval."""
        if jit.ready():
            return self.fast(*motion, beta)
        z, slopes = self.terms(motion)
        return self.to_joint(z), self._slopes(slopes, beta, motion.angle.shape[1:])

    @cached_property
    def _rigid(self) -> NDArray[np.bool_]:
        return np.array([a.term in ("inertia", "gravity") for a in self.mechanism.parameters])

    def to_joint(self, z: FloatArray) -> FloatArray:
        """Z (p, n, 2, K) with every row a joint's."""
        out, rigid = z.copy(), z[self._rigid]
        transposed = self.mechanism.transform.T @ rigid.reshape(*rigid.shape[:2], -1)
        out[self._rigid] = transposed.reshape(rigid.shape)
        return out

    def jacobian(self, slopes: list[list[Slope]], beta: FloatArray, shape: tuple[int, ...],
                 added: FloatArray | None = None) -> FloatArray:
        """d(Z beta)/d(q0, v0, q1, v1): (n, 2, 4, n, K), row joint, Gauss point, end variable, its joint.

        `added` (n, 5, n, 2, K) are derivatives by features of torque that comes from elsewhere.
        """
        return self.by_ends(self._slopes(slopes, beta, shape), added)

    def by_ends(self, own: FloatArray, added: FloatArray | None = None) -> FloatArray:
        """`jacobian` from derivatives by the features of the motion (n, 2, 5, n, K)."""
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

    def acceleration(self, q: FloatArray, v: FloatArray, u: FloatArray, beta: FloatArray, joint: int = 0,
                     added: FloatArray | None = None) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Acceleration of one joint at samples, from the equation of motion there, with its derivatives.

        q, v, u (n, N). Returns qdd (N,), its derivatives by q, v and u (3, n, N) and by beta (p, N), and the
        joint's row of D^-1 (n, N). From Z(q, v, qdd) beta = u by implicit differentiation. `added` (n, 5, n, N)
        are derivatives by features of torque already taken off u.
        """
        at, rate = q[:, None], v[:, None]
        z, own = self.evaluate(Motion(at, rate, np.zeros_like(at), rate, rate), beta)
        inverse = invert_small(own[:, 0, ACCEL])
        excess = u - (beta @ z.reshape(len(beta), -1)).reshape(u.shape)
        qdd = np.einsum("ijN,jN->iN", inverse, excess)
        z, own = self.evaluate(Motion(at, rate, qdd[:, None], rate, rate), beta)
        own = own[:, 0]  # (n, 5, n, N)
        if added is not None:
            own = own + added
            inverse = invert_small(own[:, ACCEL])
        row = inverse[joint]
        by_angle = np.einsum("jN,jbN->bN", row, own[:, ANGLE])
        by_rate = np.einsum("jN,jbN->bN", row, own[:, RATE] + own[:, RATE_FROM] + own[:, RATE_TO])
        by_beta = np.einsum("jN,pjN->pN", row, z[:, :, 0])
        return qdd[joint], np.stack([-by_angle, -by_rate, row]), -by_beta, row
