"""What `estimator.likelihood.assembly_numba` is held to: the same sums from rows of the Jacobian, by arrays.

Rows come with the sample last, as arrays over samples make them; the normal equations have it first, as elimination
wants them. What the terms add comes from the table of terms, not from the kernels.
"""

from collections.abc import Callable

import numpy as np

from daq import FloatArray
from estimator.likelihood import Latents, Noise
from estimator.likelihood.normal_equations import Accumulators, Extra
from estimator.model import ACCEL, ANGLE, RATE, RATE_FROM, RATE_TO, Collocation, Motion, Samples, after
from estimator.signals import accelerometer_at, accelerometer_slopes, imu_channels

Evaluate = Callable[[Collocation, Motion, FloatArray], tuple[FloatArray, FloatArray]]


def evaluate(c: Collocation, motion: Motion, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Z (p, n, S, K) in joint rows and d(Z beta)/d(features) (n, S, 5, n, K) at S points an interval."""
    z, slopes = c.terms(motion)
    return c.to_joint(z), c.feature_slopes(slopes, beta, motion.angle.shape[1:]).transpose(0, 3, 1, 2, 4)


def add_motion(c: Collocation, x: Latents, beta: FloatArray, weight: FloatArray, intervals: slice, left: Samples,
               extra: Extra | None, accumulators: Accumulators, between: FloatArray | None = None) -> None:
    """Add the equation of motion on `intervals`, which begin at samples `left`, each row times its joint's weight."""
    b, n = accumulators.chain.block, c.mechanism.n
    rows = motion_rows(c, x, beta, weight, intervals, left, extra, between)
    own = 3 * n  # a disturbance has no part in the equation of motion
    rows = np.insert(rows, np.repeat([own, 2 * own], b - own), 0.0, axis=1)[:, : 2 * b + accumulators.chain.width]
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


def add_accelerometer(c: Collocation, x: Latents, beta: FloatArray, measured: FloatArray, noise: Noise, here: slice,
                      extra: Extra | None, accumulators: Accumulators, accel: FloatArray) -> None:
    """Add both axes' samples `here` of S IMUs, `measured` (S, 2, N); put their rows, unscaled, into accel (S, N, 2, b +
    1 + parameters)."""
    b = accumulators.chain.block
    correlation = np.array([[1.0, noise.accel_correlation], [noise.accel_correlation, 1.0]])
    for k, levels in enumerate(noise.accel):
        rows = accelerometer_rows(c, x, beta, measured[k], here, extra, imu=k)
        rows = np.insert(rows, np.repeat([3 * c.mechanism.n], b - 3 * c.mechanism.n), 0.0, axis=1)
        rows = rows[:, : b + accumulators.chain.width]
        transposed = accel[k, here] = _transposed(rows)
        precision = np.linalg.inv(np.outer(levels, levels) * correlation)
        own, columns = transposed[:, :, :b], transposed[:, :, b:]
        weighted = precision @ columns
        accumulators.square[:] += np.einsum("kra,krb->ab", columns, weighted)
        accumulators.chain.diagonal[here] += own.swapaxes(1, 2) @ (precision @ own)
        accumulators.chain.right[here] += own.swapaxes(1, 2) @ weighted


def motion_rows(c: Collocation, x: Latents, beta: FloatArray, weight: FloatArray, intervals: slice, left: Samples,
                extra: Extra | None = None, between: FloatArray | None = None, by: Evaluate = evaluate) -> FloatArray:
    """Weighted rows of the equation of motion, (2 n, 2 b + 1 + p, K): by both ends' latents, residual, parameters."""
    n, p = c.mechanism.n, c.mechanism.p
    b = 3 * n
    z, own = by(c, c.motion(x.q, x.v, left), beta)  # (p, n, 2, K), (n, 2, 5, n, K)
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
                       extra: Extra | None = None, by: Evaluate = evaluate, imu: int = 0) -> FloatArray:
    """Rows (2, b + 1 + p, K) of an accelerometer's two axes: by the latents, residual, by the parameters.

    Accelerations come from the equation of motion at the sample, not from the cubic: friction that changes sign
    inside an interval makes the acceleration jump there, and the cubic's value at its end would carry
    that jump to the wrong side (measured: 5 % on the knee's Coulomb level).
    """
    m, n = c.mechanism, c.mechanism.n
    b, place = 3 * n, m.imus[imu]
    q, v, u = (np.ascontiguousarray(a[here].T) for a in (x.q, x.v, x.u))
    added = None
    if extra is not None:
        u = u - extra.torque_at_samples[:, here]
        added = None if extra.sample_slopes is None else extra.sample_slopes[..., here]
    qdd, by_latents, by_beta, inverse = acceleration(c, q, v, u, beta, added, by)
    count = 0 if extra is None else extra.sample_columns.shape[0]
    rows = np.zeros((2, b + 1 + m.p + count, q.shape[1]))
    _, by_angle, by_rate, felt = accelerometer_slopes(m, place, q, v, qdd)
    rows[:, :b] = np.einsum("riN,sijN->rsjN", felt, by_latents).reshape(2, b, -1)
    rows[:, :n] += by_angle
    rows[:, n : 2 * n] += by_rate
    rows[:, b] = np.stack(accelerometer_at(m, place, q, v, qdd)) - measured[:, here]
    rows[:, b + 1 : b + 1 + m.p] = np.einsum("riN,ipN->rpN", felt, by_beta)
    if extra is not None:
        rows[:, b + 1 + m.p :] = -np.einsum("riN,ijN,kjN->rkN", felt, inverse, extra.sample_columns[:, :, here])
        for axis, channel in enumerate(imu_channels(imu)[1:]):
            if channel in extra.readings:
                rows[axis, b] += extra.readings[channel][here]
            if channel in extra.reading_columns:
                which, values = extra.reading_columns[channel]
                rows[axis, b + 1 + m.p + which] += values[:, here]
    return rows


def gram(matrices: FloatArray) -> FloatArray:
    """A^T A of each of many small matrices (m, r, c)."""
    return np.asarray(matrices.swapaxes(1, 2) @ matrices.copy())


def _transposed(rows: FloatArray) -> FloatArray:
    height, width, count = rows.shape
    return rows.reshape(-1, count).T.copy().reshape(count, height, width)


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


def acceleration(c: Collocation, q: FloatArray, v: FloatArray, u: FloatArray, beta: FloatArray,
                 added: FloatArray | None, by: Evaluate) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Accelerations of the joints at samples, from the equation of motion there, with their derivatives.

    q, v, u (n, N). Returns qdd (n, N), its derivatives by q, v and u (3, n, n, N) and by beta (n, p, N), and D^-1 (n,
    n, N). From Z(q, v, qdd) beta = u by implicit differentiation. `added` (n, 5, n, N)
    are derivatives by features of torque already taken off u.
    """
    at, rate = q[:, None], v[:, None]
    z, own = by(c, Motion(at, rate, np.zeros_like(at), rate, rate), beta)
    inverse = invert_small(own[:, 0, ACCEL])
    excess = u - (beta @ z.reshape(len(beta), -1)).reshape(u.shape)
    qdd = np.einsum("ijN,jN->iN", inverse, excess)
    z, own = by(c, Motion(at, rate, qdd[:, None], rate, rate), beta)
    own = own[:, 0]  # (n, 5, n, N)
    if added is not None:
        own = own + added
        inverse = invert_small(own[:, ACCEL])
    by_angle = np.einsum("ijN,jbN->ibN", inverse, own[:, ANGLE])
    by_rate = np.einsum("ijN,jbN->ibN", inverse, own[:, RATE] + own[:, RATE_FROM] + own[:, RATE_TO])
    by_beta = np.einsum("ijN,pjN->ipN", inverse, z[:, :, 0])
    return qdd, np.stack([-by_angle, -by_rate, inverse]), -by_beta, inverse
