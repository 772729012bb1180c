"""Sums of the normal equations from rows of the Jacobian, by arrays and products of many small matrices.

Rows come with the sample last, as arrays over samples make them; the normal equations have it first, as elimination
wants them. `estimator.likelihood.assembly_numba` does the same with compiled kernels.
"""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.likelihood.normal_equations import Accumulators, Extra, Latents
from estimator.model import Collocation, Samples, after
from estimator.numerics import gram
from estimator.signals import ACCEL_X, ACCEL_Y, accelerometer


def add_motion(c: Collocation, x: Latents, beta: FloatArray, weight: FloatArray, intervals: slice, left: Samples,
               extra: Extra | None, accumulators: Accumulators, between: FloatArray | None = None) -> None:
    """Add the equation of motion on `intervals`, which begin at samples `left`, each row times its joint's weight."""
    b, n = accumulators.chain.block, c.mechanism.n
    rows = motion_rows(c, x, beta, weight, intervals, left, extra, between)
    columns = rows[:, 2 * b :]
    accumulators.square[:] += np.sum(columns @ columns.swapaxes(1, 2), axis=0)
    accumulators.misfit[:] += np.sum(columns[:, 0] ** 2, axis=-1).reshape(n, 2).sum(axis=1)
    transposed = _transposed(rows)
    first, second, rest = transposed[:, :, :b], transposed[:, :, b : 2 * b], transposed[:, :, 2 * b :]
    diagonal, lower, sides = accumulators.chain.diagonal, accumulators.chain.lower, accumulators.chain.right
    right = after(left)
    diagonal[left] += gram(first)
    diagonal[right] += gram(second)
    lower[left] = second.swapaxes(1, 2) @ first
    sides[left] += first.swapaxes(1, 2) @ rest
    sides[right] += second.swapaxes(1, 2) @ rest


def add_accelerometer(c: Collocation, x: Latents, beta: FloatArray, measured: FloatArray, weight: float, here: slice,
                      extra: Extra | None, accumulators: Accumulators, accel: FloatArray) -> None:
    """Add both axes' samples `here`; put their rows, unscaled, into accel (N, 2, b + 1 + parameters)."""
    b = accumulators.chain.block
    rows = accelerometer_rows(c, x, beta, measured, here, extra)
    columns = rows[:, b:]
    accumulators.square[:] += np.sum(columns @ columns.swapaxes(1, 2), axis=0) * weight
    transposed = accel[here] = _transposed(rows)
    own = transposed[:, :, :b]
    back = own.swapaxes(1, 2) * weight
    accumulators.chain.diagonal[here] += back @ own
    accumulators.chain.right[here] += back @ transposed[:, :, b:]


def motion_rows(c: Collocation, x: Latents, beta: FloatArray, weight: FloatArray, intervals: slice, left: Samples,
                extra: Extra | None = None, between: FloatArray | None = None) -> FloatArray:
    """Weighted rows of the equation of motion, (2 n, 2 b + 1 + p, K): by both ends' latents, residual, parameters."""
    n, p = c.mechanism.n, c.mechanism.p
    b = 3 * n
    z, own = c.evaluate(c.motion(x.q, x.v, left), beta)  # (p, n, 2, K), (n, 2, 5, n, K)
    count = z.shape[-1]
    residual = (beta @ z.reshape(p, -1)).reshape(n, 2, count) - c.torque(x.u, left)
    added = None
    if between is not None:
        residual -= between[:, :, intervals]
    if extra is not None:
        residual += extra.torque[:, :, intervals]
        z = np.concatenate([z, extra.torque_columns[:, :, :, intervals]])
        added = None if extra.slopes is None else extra.slopes[..., intervals]
    scale, jac = weight[:, None], c.by_ends(own, added).reshape(n, 2, 2, 2, n, count)
    rows = np.zeros((n, 2, 2 * b + 1 + len(z), count))
    ends = rows[:, :, : 2 * b].reshape(n, 2, 2, 3, n, -1)  # joint, Gauss point; end, variable, joint
    np.multiply(jac, scale[:, :, None, None, None], out=ends[:, :, :, :2])
    for i in range(n):
        ends[i, :, :, 2, i] = -scale[i] * c.torque_weights[:, :, None]
    np.multiply(residual, scale, out=rows[:, :, 2 * b])
    np.multiply(z.transpose(1, 2, 0, 3), scale[:, :, None], out=rows[:, :, 2 * b + 1 :])
    return rows.reshape(2 * n, -1, count)


def accelerometer_rows(c: Collocation, x: Latents, beta: FloatArray, measured: FloatArray, here: slice,
                       extra: Extra | None = None) -> FloatArray:
    """Rows (2, b + 1 + p, K) of the accelerometer's two axes: by the latents, residual, by the parameters.

    q1dd comes from the equation of motion at the sample, not from the cubic: friction that changes sign
    inside an interval makes the acceleration jump there, and the cubic's value at its end would carry
    that jump to the wrong side (measured: 5 % on the knee's Coulomb level).
    """
    m, n = c.mechanism, c.mechanism.n
    b, lever, g = 3 * n, m.lever_arm, m.gravity_mps2
    q, v, u = (np.ascontiguousarray(a[here].T) for a in (x.q, x.v, x.u))
    added = None
    if extra is not None:
        u = u - extra.torque_at_samples[:, here]
        added = None if extra.sample_slopes is None else extra.sample_slopes[..., here]
    qdd, by_latents, by_beta, inverse = c.acceleration(q, v, u, beta, 0, added)
    count = 0 if extra is None else extra.sample_columns.shape[0]
    rows = np.zeros((2, b + 1 + m.p + count, qdd.size))
    rows[0, :b] = lever * by_latents.reshape(b, -1)
    rows[0, 0] += g * np.cos(q[0])
    rows[1, 0] = g * np.sin(q[0])
    rows[1, n] = -2.0 * lever * v[0]
    rows[:, b] = np.stack(accelerometer(q[0], v[0], qdd, lever, g)) - measured[:, here]
    rows[0, b + 1 : b + 1 + m.p] = lever * by_beta
    if extra is not None:
        rows[0, b + 1 + m.p :] = -lever * np.einsum("jN,kjN->kN", inverse, extra.sample_columns[:, :, here])
        for axis, channel in enumerate((ACCEL_X, ACCEL_Y)):
            if channel in extra.readings:
                rows[axis, b] += extra.readings[channel][here]
            if channel in extra.reading_columns:
                rows[axis, b + 1 + m.p :] += extra.reading_columns[channel][:, here]
    return rows


def _transposed(rows: FloatArray) -> FloatArray:
    height, width, count = rows.shape
    return rows.reshape(-1, count).T.copy().reshape(count, height, width)
