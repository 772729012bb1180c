"""Maximum likelihood on short records with known noise: beta by damped steps on the profile likelihood.

The latents are brought to their best values for every beta that is tried (an inner Gauss-Newton on a smoothing
problem, which is tame), so the outer search goes downhill in p dimensions only. Steps in latents and beta
together, as `estimator.fitting.mle` takes them, are faster but start well only where filtering gives a good first
motion, which a noisy record of half a second does not.

A record is searched from several starts: a sum of squares that known noise cannot explain is a local minimum,
and sends the record to the next start. The search stays among bodies: a model whose inertia matrix is not
positive definite along the motion is refused, as nearly all false minima are there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.likelihood import BatchProblem, Noise, Point, Records
from estimator.model import Collocation, Mechanism
from estimator.numerics import pseudo_inverse
from estimator.options import FitOptions
from estimator.signals import SignalSet

Index = IndexArray
STARTS: tuple[tuple[int, float | None], ...] = ((3, None), (5, None), (2, 0.5), (2, 1.0), (3, 0.5), (2, 0.2))
"""In the order in which they are tried: polynomial degree of a noisy joint's first motion, and length [m] of the
uniform rods that are the first body (None: least squares on the first motion, which leads there in few steps where
angles are good, and where they are not is no body at all and costs one)."""
MISFIT_SPREADS = 1.5
"""A sum of squares this many standard deviations above its mean under the known noise is looked at again."""
SAME_MISFIT = 1e-2
"""Two starts that end this close to each other have found the same minimum, and the record is done."""
INNER_STEPS = 8
"""Most steps of the latents between two of beta."""
OUTER_STEPS = 60
"""Most linearisations of one search, counted in steps of the outer kind; an inner step counts a quarter."""
INNER_TOLERANCE = 1e-2
"""The latents are at their best where a step would lower the sum of squares by less than this."""
TOLERANCE = 0.02
"""A search ends when beta would move by less than this share of its standard deviation."""
EXACT_RAD = 1e-7
"""An encoder with less noise than this is taken as exact where a first motion is made."""
MOST_SAMPLES = 500
"""Longer records are started well by filtering."""
POLISH_STEPS = 2
"""Full steps from where a search ended."""
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-7, 1e8
"""Bounds of the damping, as a share of the information."""
REACH_RAD = 0.5
"""Steps that move an angle further are shortened: a linearisation means little there."""


@dataclass
class Searched:
    """The best that was found for R records."""

    beta: FloatArray
    """(R, p)"""
    covariance: FloatArray
    """(R, p, p)"""
    x: FloatArray
    """(R, N, 3 n) latents q, v, u"""
    objective: FloatArray
    """(R,) inf where no start led anywhere"""
    converged: BoolArray
    steps: IndexArray
    """(R,) linearisations spent"""

    def put(self, where: Index, other: Searched, better: BoolArray) -> None:
        """Take over the records of `other`, numbered by `where`, that are `better`."""
        to = where[better]
        for name in ("beta", "covariance", "x", "objective", "converged"):
            getattr(self, name)[to] = getattr(other, name)[better]
        self.steps[where] += other.steps


def empty(records: Records, p: int) -> Searched:
    """An empty result."""
    runs, samples, n = records.angles.shape
    return Searched(np.full((runs, p), np.nan), np.full((runs, p, p), np.nan), np.full((runs, samples, 3 * n), np.nan),
                    np.full(runs, np.inf), np.zeros(runs, bool), np.zeros(runs, dtype=np.intp))


def suits(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions) -> bool:
    """Whether this search can do a fit: one short record on the encoder path, nothing known but all noise."""
    return (len(signals) == 1 and len(signals[0].time_s) <= MOST_SAMPLES and not mechanism.followers
            and not options.fixed and not options.prior and not options.torque_correlation
            and knows_noise(mechanism, options))


def knows_noise(mechanism: Mechanism, options: FitOptions) -> bool:
    """Whether `options` give every level of the encoder path, so that none is estimated."""
    joints = range(mechanism.n)
    return (options.sensors == "encoder" and all(options.encoder_noise(j) is not None for j in joints)
            and all(options.torque_noise(j, j in mechanism.actuated) is not None for j in joints))


def known_noise(mechanism: Mechanism, options: FitOptions) -> Noise:
    """Noise levels of `options`, which `suits`."""
    none = np.zeros(mechanism.n)
    found = Noise(none, none).with_declared(options.noise, mechanism.actuated)
    return replace(found, torque=np.maximum(found.torque, 1e-9))


def expected_misfit(problem: BatchProblem, samples: int) -> tuple[float, float]:
    """Mean and standard deviation of the smallest sum of squares under the known noise."""
    noisy = len(problem.mechanism.actuated) + int(np.sum(problem.noise.encoder > EXACT_RAD))
    freedom = max(samples * noisy - problem.mechanism.p - 2 * problem.n, 1)
    return float(freedom), float(np.sqrt(2.0 * freedom))


def search(problem: BatchProblem, records: Records) -> Searched:
    """Best beta and motion of each record from up to len(STARTS) starts."""
    searched = empty(records, problem.mechanism.p)
    mean, spread = expected_misfit(problem, records.angles.shape[1])
    agreed = np.zeros(len(searched.objective), bool)
    for degree, length in STARTS:
        where = np.flatnonzero(~(searched.converged & (agreed | (searched.objective < mean + MISFIT_SPREADS * spread))))
        if where.size == 0:
            break
        part = records.pick(where)
        tried = descend(problem, part, *first_guess(problem, part, degree, length))
        same = np.isclose(tried.objective, searched.objective[where], rtol=0.0, atol=SAME_MISFIT)
        agreed[where] = same & tried.converged & searched.converged[where]
        better = (tried.objective < searched.objective[where] - 1e-3) | ~np.isfinite(searched.objective[where])
        searched.put(where, tried, better)
    return searched


def first_guess(problem: BatchProblem, records: Records, degree: int,
                length: float | None) -> tuple[FloatArray, FloatArray]:
    """Latents (R, N, 3 n) and beta (R, p): a smooth motion, and a body.

    Exact joints are splines. A noisy joint is a polynomial plus multiples of the exact joints' angles: momentum
    is smoother than any one rate, so where the others jerk, this one jerks in proportion. The body is one of
    uniform rods (`rods`), or least squares on that motion; noise in the motion biases the latter towards zero.
    """
    from scipy.interpolate import CubicSpline

    c = problem.collocation
    runs, samples, n = records.angles.shape
    time = np.arange(samples) * c.dt
    q, v = np.empty_like(records.angles), np.empty_like(records.angles)
    exact = [j for j in range(n) if problem.noise.encoder[j] <= EXACT_RAD]
    for j in exact:
        q[..., j], v[..., j] = records.angles[..., j], CubicSpline(time, records.angles[..., j], axis=1)(time, 1)
    s = 2.0 * time / time[-1] - 1.0
    shape = np.polynomial.chebyshev.chebvander(s, degree)
    slope = np.stack([np.polynomial.Chebyshev.basis(k).deriv()(s) for k in range(degree + 1)], axis=-1)
    shapes = np.concatenate([np.broadcast_to(shape, (runs, *shape.shape)), q[..., exact]], axis=-1)
    slopes = np.concatenate([np.broadcast_to(slope * 2.0 / time[-1], (runs, *shape.shape)), v[..., exact]], axis=-1)
    for j in sorted(set(range(n)) - set(exact)):
        weights = np.linalg.pinv(shapes) @ records.angles[..., j, None]
        q[..., j], v[..., j] = (shapes @ weights)[..., 0], (slopes @ weights)[..., 0]
    x = np.concatenate([q, v, records.torque], axis=-1)
    z, torque = interval_means(c, q, v, records.torque)
    return x, regress(c.mechanism, z, torque) if length is None else rods(c.mechanism, z, torque, length)


def interval_means(c: Collocation, q: FloatArray, v: FloatArray,
                   torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Z (R, M, n, p) and torque (R, M, n), each the mean over an interval, of motions q, v under torque (R, N, n)."""
    runs, samples, n = q.shape
    left = np.delete(np.arange(runs * samples), np.s_[samples - 1 :: samples])
    motion = c.motion(q.reshape(-1, n), v.reshape(-1, n), left)
    z = c.to_joint(c.terms(motion)[0]).mean(axis=2)  # (p, n, K)
    u = c.torque(torque.reshape(-1, n), left).mean(axis=1)
    inner = slice(2, samples - 3)  # splines and polynomials are worst at their ends
    return (z.reshape(*z.shape[:2], runs, samples - 1)[..., inner].transpose(2, 3, 1, 0),
            u.reshape(n, runs, samples - 1)[..., inner].transpose(1, 2, 0))


def rods(mechanism: Mechanism, z: FloatArray, torque: FloatArray, length: float) -> FloatArray:
    """beta (R, p) of equal uniform rods of this length [m], so heavy that they need as much torque as was measured.

    A rod of mass m whose end carries k others has p_ii = m length^2 (1/3 + k), p_ij = m length^2 (1/2 + k_j) with
    each j that it carries, and first moment m length (1/2 + k). z (R, M, n, p), torque (R, M, n).
    """
    carried = np.zeros(mechanism.n)
    for a in mechanism.parameters:
        if a.term == "inertia" and a.at[0] < a.at[1]:
            carried[a.at[0]] += 1.0
    shape = np.zeros(mechanism.p)
    inside = abs(mechanism.gravity) == 1.0  # gravity is part of the parameter, not a factor of it
    for k, a in enumerate(mechanism.parameters):
        if a.term == "inertia":
            shape[k] = length**2 * (1.0 / 3.0 if a.at[0] == a.at[1] else 0.5)
            shape[k] += length**2 * carried[a.at[1]]
        elif a.term == "gravity":
            shape[k] = length * (0.5 + carried[a.at[0]]) * (mechanism.gravity_mps2 if inside else 1.0)
    driven = list(mechanism.actuated)
    needed = np.einsum("rmnp,p->rmn", z[:, :, driven], shape)
    mass = np.sqrt(np.sum(torque[:, :, driven] ** 2, axis=(1, 2)) / np.sum(needed**2, axis=(1, 2)))
    return mass[:, None] * shape


def regress(mechanism: Mechanism, z: FloatArray, torque: FloatArray) -> FloatArray:
    """beta (R, p) by (28) from z (R, M, n, p) and torque (R, M, n).

    Joints are weighted by their own residual's variance, found in three passes. Masses, moments and friction are
    kept from falling below zero.
    """
    from scipy.optimize import lsq_linear

    runs = len(z)
    sigma = np.ones((runs, 1, mechanism.n))
    positive = np.array([a.term != "offset" and (a.term != "inertia" or a.at[0] == a.at[1])
                         for a in mechanism.parameters])
    low = np.where(positive, 0.0, -np.inf)
    for _ in range(3):
        a = (z / sigma[..., None]).reshape(runs, -1, z.shape[-1])
        scale = np.linalg.norm(a, axis=1)
        scale[scale == 0.0] = 1.0
        a = a / scale[:, None]
        y = (torque / sigma).reshape(runs, -1)
        beta: FloatArray = (np.linalg.pinv(a, rcond=1e-10) @ y[..., None])[..., 0]
        for r in np.flatnonzero((beta < low).any(axis=1)):
            beta[r] = lsq_linear(a[r], y[r], (low, np.inf), method="bvls").x
        beta /= scale
        residual = torque - np.einsum("rmnp,rp->rmn", z, beta)
        sigma = np.sqrt(np.mean(residual**2, axis=1, keepdims=True)) + 1e-9
    return beta


def descend(problem: BatchProblem, records: Records, x: FloatArray, beta: FloatArray) -> Searched:
    """Levenberg-Marquardt on the profile likelihood of every record at once, from x (R, N, 3 n) and beta (R, p)."""
    runs, p = beta.shape
    best = empty(records, p)
    at_score = np.zeros((runs, p))
    at_information, at_by_beta = np.zeros((runs, p, p)), np.zeros((*x.shape, p))
    damping = np.full(runs, 1e-2)
    inner = np.zeros(runs, int)
    budget = np.full(runs, float(OUTER_STEPS))
    x, beta = x.copy(), beta.copy()
    active = np.arange(runs)
    while active.size:
        point, ok = _linearise_each(problem, records, x, beta, active)
        ok &= _is_body(problem, x[active], beta[active])
        best.steps[active] += 1
        worth = point.decrease > INNER_TOLERANCE * (1.0 + 1e-3 * point.objective)
        moving = ok & worth & (inner[active] < INNER_STEPS)
        go = active[moving]
        x[go] += _shortened(point.step[moving], problem.n)
        inner[go] += 1
        budget[go] -= 0.25

        arrived = active[~moving]
        lower = ok[~moving] & (point.objective[~moving] < best.objective[arrived])
        good, bad = arrived[lower], arrived[~lower]
        kept = np.flatnonzero(~moving)[lower]
        first = ~np.isfinite(best.objective[good])
        best.x[good], best.beta[good] = x[good], beta[good]
        best.objective[good] = point.objective[kept]
        best.covariance[good] = pseudo_inverse(point.information[kept])
        at_information[good], at_score[good] = point.information[kept], point.score[kept]
        at_by_beta[good] = point.by_beta[kept]
        drop = np.einsum("ri,rij,rj->r", at_score[good], best.covariance[good], at_score[good])
        best.converged[good] = drop < TOLERANCE**2
        damping[good] = np.where(first, damping[good], np.maximum(damping[good] / 5.0, SMALLEST_DAMPING))
        damping[bad] = np.maximum(damping[bad] * 6.0, 1e-3)
        budget[arrived] -= 1.0
        lost = bad[~np.isfinite(best.objective[bad])]
        damping[lost] = np.inf

        again = arrived[~best.converged[arrived] & (damping[arrived] < LARGEST_DAMPING) & (budget[arrived] > 0.0)]
        if again.size:
            step = _damped_step(at_information[again], at_score[again], damping[again])
            x[again] = best.x[again] + _shortened(np.einsum("rkbp,rp->rkb", at_by_beta[again], step), problem.n)
            beta[again] = best.beta[again] + step
            inner[again] = 0
        active = np.sort(np.concatenate([go[budget[go] > 0.0], again]))
    _polish(problem, records, best)
    return best


def _polish(problem: BatchProblem, records: Records, best: Searched) -> None:
    """Full steps in latents and beta together from where searches ended: the minimum to machine precision."""
    for _ in range(POLISH_STEPS):
        where = np.flatnonzero(best.converged)
        if where.size == 0:
            return
        point, ok = _linearise_each(problem, records, best.x, best.beta, where)
        best.steps[where] += 1
        step = _damped_step(point.information, point.score, np.zeros(where.size))
        x, beta = best.x.copy(), best.beta.copy()
        x[where] += point.step + np.einsum("rkbp,rp->rkb", point.by_beta, step)
        beta[where] += step
        after, fine = _linearise_each(problem, records, x, beta, where)
        lower = ok & fine & (after.objective <= point.objective) & _is_body(problem, x[where], beta[where])
        to = where[lower]
        best.x[to], best.beta[to], best.objective[to] = x[to], beta[to], after.objective[lower]
        best.covariance[to] = pseudo_inverse(after.information[lower])


def _is_body(problem: BatchProblem, x: FloatArray, beta: FloatArray) -> BoolArray:
    """(R,) the inertia matrix is positive definite all along the motion; looked at on every fourth sample.

    Where it is not, the model is no body's, and minima of the sum of squares out there mean nothing.
    """
    inertia = problem.mechanism.inertia_matrix(x[:, ::4, : problem.n], beta[:, None])
    finite = np.asarray(np.isfinite(inertia).all(axis=(1, 2, 3)))
    lowest = np.linalg.eigvalsh(np.where(finite[:, None, None, None], inertia, 0.0))[..., 0]
    return np.asarray((lowest > 0.0).all(axis=1))


def _linearise_each(problem: BatchProblem, records: Records, x: FloatArray, beta: FloatArray,
                    active: Index) -> tuple[Point, BoolArray]:
    """The point of every active record, and whether it could be solved; one bad record does not stop the others."""
    try:
        return problem.linearise(records.pick(active), x[active], beta[active]), np.ones(active.size, bool)
    except np.linalg.LinAlgError:
        if active.size == 1:
            shape, p = x[active].shape, beta.shape[1]
            return Point(np.array([np.inf]), np.zeros(shape), np.zeros(1), np.zeros((*shape, p)),
                         np.eye(p)[None], np.zeros((1, p))), np.array([False])
    half = active.size // 2
    parts = [_linearise_each(problem, records, x, beta, part) for part in (active[:half], active[half:])]
    return Point(*(np.concatenate(pair) for pair in zip(*(part[0] for part in parts)))), np.concatenate(
        [part[1] for part in parts])


def _damped_step(information: FloatArray, score: FloatArray, damping: FloatArray) -> FloatArray:
    """(R, p) solution of (information + damping * its diagonal) step = -score."""
    return np.asarray(-(pseudo_inverse(information, damping) @ score[..., None])[..., 0])


def _shortened(step: FloatArray, n: int) -> FloatArray:
    """step (R, N, b) with no angle moved by more than REACH_RAD."""
    biggest = np.max(np.abs(step[..., :n]), axis=(1, 2))
    return step * np.minimum(1.0, REACH_RAD / np.maximum(biggest, 1e-300))[:, None, None]
