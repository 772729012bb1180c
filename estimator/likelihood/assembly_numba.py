"""Sums of the normal equations, compiled.

One pass makes the weighted rows of a few samples, turns them and sums their products, with nothing in between.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Accumulators, Extra, Latents
from estimator.model import Collocation, Samples, invert
from estimator.numerics import at, compile_kernel, padded
from estimator.signals import accelerometer_slopes, imu_channels

STRIP = 32
"""Samples whose rows are made at a time."""
COMMON = 24
"""Up to this edge a chain's edge is a constant to the compiler, too, which makes the sums a third faster; each takes
seconds to compile, once on a machine. Beyond it the products of the right sides are left to BLAS."""


def add_motion(c: Collocation, x: Latents, beta: FloatArray, weight: FloatArray, intervals: slice, left: Samples,
               extra: Extra | None, accumulators: Accumulators, between: FloatArray | None = None) -> None:
    """Add the equation of motion on `intervals`, which begin at samples `left`, each row times its joint's weight.

    `weight` (n, K) is of these intervals, `between` (n, 2, ...) and what `extra` holds of all.
    """
    z, own = c.fast(*c.motion(x.q, x.v, left), beta)
    torque = (beta @ z.reshape(len(beta), -1)).reshape(z.shape[1:])
    if between is not None:
        torque -= between[:, :, intervals]
    if extra is not None:
        torque += extra.torque[:, :, intervals]
        z = np.concatenate([z, extra.torque_columns[:, :, :, intervals]])
        if extra.slopes is not None:
            own += extra.slopes[..., intervals].transpose(0, 3, 1, 2, 4)
    chain, u = accumulators.chain, np.ascontiguousarray(x.u)
    z = z[: chain.width - 1]  # none in a search of the motion alone
    fixed = _constant(chain.edge)
    if fixed == 0:  # of so many columns a library's matrix product is ten times as fast
        _add_squares(accumulators.square, torque - c.torque(x.u, left), z, weight, len(beta), extra)
    left = np.arange(left.start, left.stop) if isinstance(left, slice) else left
    height, full = 2 * c.mechanism.n, chain.rows.shape[2]
    _intervals(c.mechanism.n, chain.block, fixed)(
        z, own, torque, u, left, c.basis, c.torque_weights, np.ascontiguousarray(weight), chain.edge, chain.rows,
        accumulators.square, accumulators.misfit, np.zeros((height, full, STRIP)), np.zeros((height, full)),
        np.zeros((height, chain.edge)))


def add_accelerometer(c: Collocation, x: Latents, beta: FloatArray, measured: FloatArray, noise: Noise, here: slice,
                      extra: Extra | None, accumulators: Accumulators, accel: FloatArray) -> None:
    """Add samples `here` of both axes of S IMUs, `measured` (S, 2, N); put their rows, unscaled, into accel (S, N, 2,
    b + 1 + m).

    Accelerations come from the equation of motion at the sample, not from the cubic: friction that changes sign inside
    an interval makes the acceleration jump there, and the cubic's value at its end would carry that jump to the wrong
    side (measured: 5 % on the knee's Coulomb level).
    """
    m, n = c.mechanism, c.mechanism.n
    q, v, u = (np.ascontiguousarray(a[here].T)[:, None] for a in (x.q, x.v, x.u))
    transposed = c.fast.transposed(q)
    torque = u[:, 0] if extra is None else u[:, 0] - extra.torque_at_samples[:, here]
    qdd, inverse = c.fast.accelerate(q, v, torque, beta, transposed)
    z, own = c.fast(q, v, qdd, v, v, beta, transposed)
    if extra is not None:
        z = np.concatenate([z, extra.sample_columns[:, :, None, here]])
        if extra.sample_slopes is not None:
            own[:, 0] += extra.sample_slopes[..., here]
            inverse = invert(own[:, 0])
    chain, motion = accumulators.chain, (q[:, 0], v[:, 0], qdd[:, 0])
    z = z[: chain.width - 1]
    for k, place in enumerate(m.imus[: len(measured)]):
        turned = transposed[0][place.link, 0], transposed[1][place.link, 0]
        left, by_angle, by_rate, by_acceleration = accelerometer_slopes(m, place, *motion, turned=turned)
        left -= measured[k, :, here]
        if place.link == 0:  # along link 1 nothing feels an acceleration
            reach = place.lever_arm * inverse[:1]
        else:
            reach = np.einsum("rjN,jiN->riN", by_acceleration, inverse)
        columns = np.zeros((2, 0 if extra is None else len(extra.sample_columns), left.shape[1]))
        if extra is not None:
            for axis, channel in enumerate(imu_channels(k)[1:]):
                if channel in extra.readings:
                    left[axis] += extra.readings[channel][here]
                if channel in extra.reading_columns:
                    which, values = extra.reading_columns[channel]
                    columns[axis, which] = values[:, here]
        precision, rows = noise.accel_precision(k), accel[k, here]
        _samples(n, chain.block, _constant(chain.edge))(
            z[:, :, 0], own[:, 0], reach, by_angle, by_rate, left, columns, precision, chain.edge, chain.rows[here],
            rows, np.zeros((2, chain.edge, STRIP)), np.zeros((2, chain.edge)))
        accumulators.square[:] += _products(rows[:, :, chain.block :], precision)


def _add_squares(square: FloatArray, left: FloatArray, z: FloatArray, weight: FloatArray, p: int, extra: Extra | None
                 ) -> None:
    """Add products of the equation of motion's right sides to square (1 + m, 1 + m), joint by joint.

    The right sides are what is `left` (n, 2, K) and z (m, n, 2, K), each row times its joint's weight (n, K). Columns
    of `extra` that are zero at a joint add nothing there.
    """
    for j in range(len(left)):
        acts = np.ones(1 + len(z), dtype=bool)
        if extra is not None:
            acts[1 + p :] = extra.acts[: max(len(z) - p, 0), j]  # none in a search of the motion alone
        which = np.flatnonzero(acts)
        right = np.concatenate([left[None, j], z[which[1:] - 1, j]]) * weight[j]
        right = right.reshape(len(right), -1)
        square[np.ix_(which, which)] += right @ right.T


def _products(rows: FloatArray, precision: FloatArray) -> FloatArray:
    """(c, c) sum of the products of both axes' rows (N, 2, c) by `precision` (2, 2); one sum where axes are alike."""
    if precision[0, 1] == 0.0 and precision[0, 0] == precision[1, 1]:
        both = rows.reshape(-1, rows.shape[2])
        return np.asarray(precision[0, 0] * (both.T @ both))
    x, y = rows[:, 0], rows[:, 1]
    out = precision[0, 0] * (x.T @ x) + precision[1, 1] * (y.T @ y)
    if precision[0, 1] != 0.0:
        cross = precision[0, 1] * (x.T @ y)
        out += cross + cross.T
    return np.asarray(out)


def _constant(edge: int) -> int:
    """`edge` where there is to be a kernel for it alone, otherwise 0."""
    return edge if edge <= COMMON else 0


@cache
def _intervals(n: int, block: int, fixed: int) -> Callable[..., None]:
    """The kernel that adds K intervals of n joints to a chain of so large blocks; `fixed` is the chain's edge if that
    is a constant.

    From z (m, n, 2, K), own (n, 2, 5, n, K), torque (n, 2, K) that motion and effects need, samples u (N, n),
    left (K,), basis (2, 5, 4), holds (2, 2) and weight (n, K) it adds to rows (N, 3 n, f) of the chain, to square
    (1 + m, 1 + m), upper half, the products of the right sides where `fixed` is not 0, and to misfit (n,) each joint's
    share of the squares.
    line (2 n, f, STRIP), transposed (2 n, f) and after (2 n, edge) are zeros to work on.
    """
    b, height, whole = 3 * n, 2 * n, padded(fixed + block)

    def run(z: Any, own: Any, torque: Any, u: Any, left: Any, basis: Any, holds: Any, weight: Any, edge: int, rows: Any,
            square: Any, misfit: Any, line: Any, transposed: Any, after: Any) -> None:
        full, count, width = rows.shape[2], left.size, 1 + z.shape[0]
        if fixed > 0:
            edge, full = fixed, whole
        for start in range(0, count, STRIP):
            size = min(STRIP, count - start)
            for i in range(n):
                for g in range(2):
                    r = 2 * i + g
                    for w in range(size):
                        line[r, 2 * n + i, w] = -weight[i, at(start + w)] * holds[g, 0]
                        line[r, edge + 2 * n + i, w] = -weight[i, at(start + w)] * holds[g, 1]
                    for j in range(n):
                        for e in range(2):
                            for d in range(2):
                                for w in range(size):
                                    t = 0.0
                                    for f in range(5):
                                        t += basis[g, f, 2 * e + d] * own[i, g, f, j, at(start + w)]
                                    line[r, e * edge + d * n + j, w] = weight[i, at(start + w)] * t
                    for w in range(size):
                        k = left[at(start + w)]
                        acting = holds[g, 0] * u[at(k), i] + holds[g, 1] * u[at(k + 1), i]
                        t = weight[i, at(start + w)] * (torque[i, g, at(start + w)] - acting)
                        line[r, block, w] = t
                        misfit[i] += t * t
                    for k in range(width - 1):
                        for w in range(size):
                            line[r, block + 1 + k, w] = weight[i, at(start + w)] * z[k, i, g, at(start + w)]
            if fixed > 0:
                for c in range(width):
                    for d in range(c, width):
                        t = 0.0
                        for r in range(height):
                            for w in range(size):
                                t += line[r, block + c, w] * line[r, block + d, w]
                        square[c, d] += t
            for w in range(size):
                for r in range(height):
                    for c in range(full):
                        transposed[r, c] = line[r, c, w]
                    for c in range(edge):
                        after[r, c] = transposed[r, c]
                    for c in range(b):
                        after[r, c] = transposed[r, edge + c]
                k = left[at(start + w)]
                for i in range(b):
                    for c in range(full):
                        t = rows[at(k), i, c]
                        for r in range(height):
                            t += transposed[r, i] * transposed[r, c]
                        rows[at(k), i, c] = t
                for i in range(b):
                    for c in range(edge):
                        t = rows[at(k + 1), i, c]
                        for r in range(height):
                            t += after[r, i] * after[r, c]
                        rows[at(k + 1), i, c] = t

    return compile_kernel(run, "f4 f5 f3 f2 i1 f3 f2 f2 n f3 f2 f1 f3 f2 f2")


@cache
def _samples(n: int, block: int, fixed: int) -> Callable[..., None]:
    """The kernel that adds an accelerometer's two axes at N samples of n joints to a chain's first N rows.

    From z (m, n, N), slopes (n, 5, n, N), reach (r, n, N), by how much joints' torques show on the first r axes, the
    derivatives (2, n, N) of both axes by angle and rate at given accelerations, what is left of them (2, N), and the
    derivatives by the last of the m parameters of what effects add to that (2, k, N), it makes the unscaled rows (N, 2,
    block + 1 + m), and adds their products by `precision` (2, 2); line (2, edge, STRIP) and transposed (2, edge) are
    zeros to work on.
    """
    b = 3 * n

    def run(z: Any, slopes: Any, reach: Any, angle: Any, rate: Any, left: Any, columns: Any, precision: Any, edge: int,
            rows: Any, accel: Any, line: Any, transposed: Any) -> None:
        count, width, extra, felt = left.shape[1], 1 + z.shape[0], columns.shape[1], reach.shape[0]
        across, along, mixed = precision[0, 0], precision[1, 1], precision[0, 1]
        if fixed > 0:
            edge = fixed
        for start in range(0, count, STRIP):
            size = min(STRIP, count - start)
            for r in range(2):
                for j in range(n):
                    for w in range(size):
                        line[r, j, w], line[r, n + j, w] = angle[r, j, at(start + w)], rate[r, j, at(start + w)]
                for w in range(size):
                    line[r, block, w] = left[r, at(start + w)]
            for r in range(felt):
                for j in range(n):
                    for w in range(size):
                        by_angle, by_rate = 0.0, 0.0
                        for i in range(n):
                            f = reach[r, i, at(start + w)]
                            by_angle -= f * slopes[i, 0, j, at(start + w)]
                            by_rate -= f * (slopes[i, 1, j, at(start + w)] + slopes[i, 3, j, at(start + w)]
                                            + slopes[i, 4, j, at(start + w)])
                        line[r, j, w] += by_angle
                        line[r, n + j, w] += by_rate
                        line[r, 2 * n + j, w] = reach[r, j, at(start + w)]
                for k in range(width - 1):
                    for w in range(size):
                        t = 0.0
                        for i in range(n):
                            t -= reach[r, i, at(start + w)] * z[k, i, at(start + w)]
                        line[r, block + 1 + k, w] = t
            for k in range(extra):
                place = block + width - extra + k
                for w in range(size):
                    line[0, place, w] += columns[0, k, at(start + w)]
                    if felt > 1:
                        line[1, place, w] += columns[1, k, at(start + w)]
                    else:
                        line[1, place, w] = columns[1, k, at(start + w)]
            for w in range(size):
                for r in range(2):
                    for c in range(edge):
                        transposed[r, c] = line[r, c, w]
                    for c in range(block + width):
                        accel[at(start + w), r, c] = transposed[r, c]
                for i in range(b):
                    f = across * transposed[0, i] + mixed * transposed[1, i]
                    g = mixed * transposed[0, i] + along * transposed[1, i]
                    for c in range(edge):
                        rows[at(start + w), i, c] += f * transposed[0, c] + g * transposed[1, c]

    return compile_kernel(run, "f3 f4 f3 f3 f3 f2 f3 f2 n f3 f3 f3 f2")
