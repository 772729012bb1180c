"""Compiled evaluation of a mechanism's terms at many points: what `Collocation.terms` and its slopes do with arrays.

A strip of points at a time goes through all terms, so what they share stays in the processor's first cache, where
arrays over all points are read and written anew by every operation. A test holds both to the same values.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.model.mechanism import Mechanism
from estimator.model.terms import CODES
from estimator.numerics import at, compile_kernel

STRIP = 64
"""Points of a strip."""


class FastTerms:
    """Terms of one mechanism; see the module's text."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.table = np.array([(CODES[p.term], p.at[0], p.at[-1]) for p in mechanism.parameters],
                              dtype=np.int64)
        self.transform = np.ascontiguousarray(mechanism.transform, dtype=np.float64)

    def transposed(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cosine and sine of the links' angles, each (n, S, K), from the joints' (n, S, K)."""
        theta = self.mechanism.from_zero(self.transform @ angle.reshape(len(angle), -1))
        cosine, sine = np.empty(angle.shape), np.empty(angle.shape)
        _cosine_sine()(theta.ravel(), cosine.ravel(), sine.ravel())
        return cosine, sine

    def __call__(self, angle: FloatArray, rate: FloatArray, accel: FloatArray, rate_from: FloatArray,
                 rate_to: FloatArray, beta: FloatArray,
                 transposed: tuple[FloatArray, FloatArray] | None = None) -> tuple[FloatArray, FloatArray]:
        """Z (p, n, S, K) in joint rows and d(Z beta)/d(features) (n, S, 5, n, K) from contiguous features (n, S, K).

        `transposed`, if it is known, is that of the same angles.
        """
        n, points, count = rate.shape
        z, own = np.empty((len(beta), n, points, count)), np.empty((n, points, 5, n, count))
        m = self.mechanism
        _terms(n)(*(transposed or self.transposed(angle)), rate, accel, rate_from, rate_to, beta, self.table,
                  self.transform, float(m.gravity), m.velocity_scales**2, z, own, np.empty((2, n, STRIP)),
                  np.empty((n, 3, n, STRIP)), np.empty((n, 3, n, STRIP)), np.empty((2, STRIP)))
        return z, own


    def accelerate(self, angle: FloatArray, rate: FloatArray, torque: FloatArray, beta: FloatArray,
                   transposed: tuple[FloatArray, FloatArray] | None = None) -> tuple[FloatArray, FloatArray]:
        """Accelerations (n, 1, K) and inverse inertia matrix (n, n, K) at angles and rates (n, 1, K), torques (n, K).

        Not finite where the inertia matrix is singular.
        """
        n, _, count = rate.shape
        z, own = self(angle, rate, np.zeros_like(rate), rate, rate, beta, transposed)
        excess = torque - (beta @ z.reshape(len(beta), -1)).reshape(n, count)
        qdd, inverse = np.empty((n, 1, count)), np.empty((n, n, count))
        _accelerations(n)(own[:, 0], excess, qdd[:, 0], inverse, np.empty((n, n)))
        return qdd, inverse

    def forward_dynamics(self, q: FloatArray, v: FloatArray, tau: FloatArray, beta: FloatArray
                         ) -> tuple[FloatArray, FloatArray]:
        """Result of `accelerate`, (n, K) and (n, n, K), for samples (K, n)."""
        angle, rate = (np.ascontiguousarray(x.T)[:, None] for x in (q, v))
        qdd, inverse = self.accelerate(angle, rate, tau.T, beta)
        return qdd[:, 0], inverse


def invert(slopes: FloatArray) -> FloatArray:
    """(n, n, K) inverse of the inertia matrix that slopes by the features of the motion (n, 5, n, K) hold."""
    n, _, _, count = slopes.shape
    inverse = np.empty((n, n, count))
    _accelerations(n)(slopes, np.zeros((n, count)), np.empty((n, count)), inverse, np.empty((n, n)))
    return inverse


@cache
def _cosine_sine() -> Callable[..., None]:
    """Both of many angles, as far as a million radians, to the last digit or the one before.

    The reduction to an eighth of a turn in three steps and the polynomials are those of fdlibm (e_rem_pio2.c,
    k_cos.c, k_sin.c). The compiler turns them into vector instructions; the C library's functions go one by one.
    (Measured: 0.7 ns for the two of one angle, where numpy takes 17.)
    """

    def run(angle: Any, cosine: Any, sine: Any) -> None:
        for i in range(angle.size):
            k = np.rint(angle[i] * 6.36619772367581382433e-01)
            x = angle[i] - k * 1.57079632673412561417e00
            x = x - k * 6.07710050630396597660e-11
            x = x - k * 2.02226624879595063154e-21
            x2 = x * x
            c = x2 * (2.08757232129817482790e-09 + x2 * -1.13596475577881948265e-11)
            c = x2 * (2.48015872894767294178e-05 + x2 * -2.75573143513906633035e-07 + x2 * c)
            c = 1.0 - 0.5 * x2 + x2 * x2 * (4.16666666666666019037e-02 + x2 * -1.38888888888741095749e-03 + x2 * c)
            s = x2 * (-2.50507602534068634195e-08 + x2 * 1.58969099521155010221e-10)
            s = x2 * (-1.98412698298579493134e-04 + x2 * 2.75573137070700676789e-06 + x2 * s)
            s = x + x * x2 * (-1.66666666666666324348e-01 + x2 * 8.33333333332248946124e-03 + x2 * s)
            quarter = k - 4.0 * np.floor(0.25 * k)
            odd = (quarter == 1.0) | (quarter == 3.0)
            a, b = s if odd else c, c if odd else s
            cosine[i] = -a if (quarter == 1.0) | (quarter == 2.0) else a
            sine[i] = -b if quarter >= 2.0 else b

    return compile_kernel(run, "f1 f1 f1", exact=True)


@cache
def _terms(n: int) -> Callable[..., None]:
    """The kernel for n joints. Features count as in `terms`: angle, rate, acceleration, rate from, rate to."""
    INERTIA, GRAVITY, VISCOUS, COULOMB, ROTOR, OFFSET = (  # of another file, so they belong to the cache's key
        CODES[name] for name in ("inertia", "gravity", "viscous", "coulomb", "rotor", "offset"))

    def run(cosine: Any, sine: Any, rate: Any, accel: Any, rate_from: Any, rate_to: Any, beta: Any, table: Any,
            transform: Any, gravity: float, eps2: Any, z: Any, own: Any, line: Any, link: Any, half: Any,
            parts: Any) -> None:
        for g in range(rate.shape[1]):
            for start in range(0, rate.shape[2], STRIP):
                size = min(STRIP, rate.shape[2] - start)
                for i in range(n):
                    for w in range(size):
                        line[0, i, w], line[1, i, w] = 0.0, 0.0
                    for j in range(n):
                        t = transform[i, j]
                        if t != 0.0:
                            for w in range(size):
                                line[0, i, w] += t * rate[j, g, at(start + w)]
                                line[1, i, w] += t * accel[j, g, at(start + w)]
                        for f in range(3):
                            for w in range(size):
                                link[i, f, j, w] = 0.0
                        for f in range(5):
                            for w in range(size):
                                own[i, g, f, j, at(start + w)] = 0.0
                    for k in range(beta.shape[0]):
                        for w in range(size):
                            z[k, i, g, at(start + w)] = 0.0
                for k in range(beta.shape[0]):
                    code, i, j, b = table[k, 0], table[k, 1], table[k, 2], beta[k]
                    if code == INERTIA and i == j:
                        for w in range(size):
                            parts[0, w] = line[1, i, w]
                            link[i, 2, i, w] += b
                    elif code == INERTIA:
                        for w in range(size):
                            ci, cj = cosine[i, g, at(start + w)], cosine[j, g, at(start + w)]
                            ti, tj = sine[i, g, at(start + w)], sine[j, g, at(start + w)]
                            c, s = ci * cj + ti * tj, ti * cj - ci * tj
                            si, sj = s * line[0, i, w], s * line[0, j, w]
                            parts[0, w] = c * line[1, j, w] + sj * line[0, j, w]
                            parts[1, w] = c * line[1, i, w] - si * line[0, i, w]
                            di = b * (c * line[0, j, w] * line[0, j, w] - s * line[1, j, w])
                            dj = -b * (c * line[0, i, w] * line[0, i, w] + s * line[1, i, w])
                            link[i, 0, i, w] += di
                            link[i, 0, j, w] -= di
                            link[j, 0, i, w] += dj
                            link[j, 0, j, w] -= dj
                            link[i, 1, j, w] += 2.0 * b * sj
                            link[j, 1, i, w] -= 2.0 * b * si
                            link[i, 2, j, w] += b * c
                            link[j, 2, i, w] += b * c
                        for h in range(n):
                            t = transform[j, h]
                            if t != 0.0:
                                for w in range(size):
                                    z[k, h, g, at(start + w)] += t * parts[1, w]
                    elif code == GRAVITY:
                        for w in range(size):
                            parts[0, w] = gravity * sine[i, g, at(start + w)]
                            link[i, 0, i, w] += b * gravity * cosine[i, g, at(start + w)]
                    elif code == VISCOUS:
                        for w in range(size):
                            z[k, i, g, at(start + w)] = rate[i, g, at(start + w)]
                            own[i, g, 1, i, at(start + w)] += b
                    elif code == ROTOR:
                        for w in range(size):
                            z[k, i, g, at(start + w)] = accel[i, g, at(start + w)]
                            own[i, g, 2, i, at(start + w)] += b
                    elif code == OFFSET:
                        for w in range(size):
                            z[k, i, g, at(start + w)] = 1.0
                    elif code == COULOMB:
                        for w in range(size):
                            u, v = rate_from[i, g, at(start + w)], rate_to[i, g, at(start + w)]
                            ru, rv = np.sqrt(u * u + eps2[i]), np.sqrt(v * v + eps2[i])
                            share = 1.0 / (ru + rv)
                            mean = (u + v) * share
                            z[k, i, g, at(start + w)] = mean
                            own[i, g, 3, i, at(start + w)] += b * share * (1.0 - mean * u / ru)
                            own[i, g, 4, i, at(start + w)] += b * share * (1.0 - mean * v / rv)
                    if code in (INERTIA, GRAVITY):
                        for h in range(n):
                            t = transform[i, h]
                            if t != 0.0:
                                for w in range(size):
                                    z[k, h, g, at(start + w)] += t * parts[0, w]
                for f in range(3):  # T^T link T
                    for i in range(n):
                        for j in range(n):
                            for w in range(size):
                                half[i, f, j, w] = 0.0
                            for h in range(n):
                                t = transform[h, j]
                                if t != 0.0:
                                    for w in range(size):
                                        half[i, f, j, w] += link[i, f, h, w] * t
                    for h in range(n):
                        for i in range(n):
                            t = transform[h, i]
                            if t != 0.0:
                                for j in range(n):
                                    for w in range(size):
                                        own[i, g, f, j, at(start + w)] += t * half[h, f, j, w]

    return compile_kernel(run, "f3 f3 f3 f3 f3 f3 f1 i2 f2 d f1 f4 f5 f3 f4 f4 f2")


@cache
def _accelerations(n: int) -> Callable[..., None]:
    """The kernel that solves the equation of motion of n joints at N samples for the accelerations.

    From slopes (n, 5, n, N) by the features of the motion, whose third is the inertia matrix, and excess (n, N) torque
    it makes qdd (n, N) and inverse (n, n, N) of the inertia matrix. Without pivoting: that matrix is definite.
    """

    def run(slopes: Any, excess: Any, qdd: Any, inverse: Any, a: Any) -> None:
        for w in range(excess.shape[1]):
            for i in range(n):
                for j in range(n):
                    a[i, j] = slopes[i, 2, j, w]
            for k in range(n):
                pivot = 1.0 / a[k, k]
                a[k, k] = 1.0
                for j in range(n):
                    a[k, j] *= pivot
                for i in range(n):
                    if i != k:
                        f = a[i, k]
                        a[i, k] = 0.0
                        for j in range(n):
                            a[i, j] -= f * a[k, j]
            for i in range(n):
                t = 0.0
                for j in range(n):
                    inverse[i, j, w] = a[i, j]
                    t += a[i, j] * excess[j, w]
                qdd[i, w] = t

    return compile_kernel(run, "f4 f2 f2 f3 f2")
