"""Level and time constant of each joint's coloured disturbance torque, by marginal likelihood.

Model error is seldom white. Taken for white noise it biases inertias low and makes intervals too narrow. So each joint
may have a disturbance of standard deviation s and time constant T (`estimator.likelihood.disturbance`). The motion and
the disturbance are integrated out around the fitted motion (Laplace), with H the information matrix of the latents and
R the covariance of all residuals:

    -2 log p = least weighted squares + log det H + log det R

A joint gets a disturbance where that raises log p by more than the two parameters cost (Schwarz, Ann. Stat. 6, 1978).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from daq import FloatArray
from estimator.fitting.excerpt import excerpt
from estimator.fitting.initial_guess import noise_floors
from estimator.fitting.noise_update import TORQUE_SHARE, floors_under, most_noise
from estimator.fitting.second_ahead import errors_ahead
from estimator.free_runs import FittedModel, log_ratio
from estimator.likelihood import OFF, LatentProblem, Latents, Noise, Process, State, add_reading
from estimator.numerics import BlockTridiagonal, Swept, eliminate
from estimator.options import FitOptions
from estimator.signals import SignalSet

TIME_CONSTANTS = (3.0, 10.0, 40.0, 160.0)
"""Time constants that are screened, in samples."""
SCREENED = 0.35
"""Disturbance that is screened for, as a share of the noise: where one that small is unlikely there is none."""
MOST_EVALUATIONS = 40
"""Most likelihoods evaluated for one joint. (Measured: 4 to 24 are needed.)"""
FLAT = 0.3
"""Slope of log p by the logarithm of a level or time constant that ends a search: where that is known to 30 %, the last
0.004 of log p are ahead."""
LONGEST_S = 10.0
"""Longest time constant [s]: a longer one is a constant."""
SHORTEST = 3.0
"""Shortest time constant [samples]: a shorter one is white. (Measured under a PD loop at 200 Hz: one of 0.8 samples
took three quarters of the white noise, and errors grew from 1.2 to 2.7 standard deviations.)"""
WORSE = 0.02
"""Growth of the rms error a second ahead that is material."""
SAME = 0.1
"""Relative change of a level or a time constant that ends their search: a tenth of what a record tells of them."""
EXCERPT = 3000
"""Most samples by which they are sought."""
SMALLEST = 1e-3
"""Least disturbance and white noise, as a share of their sum."""


class Disturbance(NamedTuple):
    """Disturbances of the n joints."""

    level: FloatArray
    """(n,) [N m], 0 where there is none"""
    time_constant: FloatArray
    """(n,) [s]"""
    white: FloatArray
    """(n,) level of the white noise in addition to it [N m]"""

    def put(self, noise: Noise) -> Noise:
        """`noise` with these levels."""
        return replace(noise, torque=self.white, disturbance=self.level, time_constant=self.time_constant)


def of_noise(noise: Noise) -> Disturbance:
    """The disturbance in force."""
    n = noise.torque.size
    if not noise.disturbance.size:
        return Disturbance(np.zeros(n), np.ones(n), noise.torque)
    return Disturbance(noise.disturbance, noise.time_constant, noise.torque)


class MarginalLikelihood:
    """log p of the torque's noise and disturbance, linearised at one motion; see the module's text."""

    def __init__(self, problem: LatentProblem, x: Latents, beta: FloatArray, noise: Noise) -> None:
        """`problem` is a disturbed one. Its equation of motion and the other sensors keep the levels of `noise`."""
        self.problem, self.noise = problem, noise
        self.floors = floors_under(noise, noise_floors(problem, problem.mechanism, beta[: problem.mechanism.p]))
        begin = replace(noise, disturbance=noise.torque, time_constant=np.full(problem.n, 10.0 * problem.dt))
        point = problem.motion_equations(x, beta, begin)
        self.residual, self.e = point.residuals["torque"], point.residuals["e"]
        self.base = point.chain
        self.others = point.objective + self._add(self.base, begin, -1.0)

    def _add(self, chain: BlockTridiagonal, noise: Noise, sign: float) -> float:
        """Add torque samples and disturbances to `chain`, `sign` times; returns their part of the objective."""
        p, n = self.problem, self.problem.n
        weight = sign / p.torque_variance(noise)
        process = Process.of(noise, p.dt)
        process.add(chain, self.e, p.ends, sign)
        squares = sum(add_reading(chain, (2 * n + j, 3 * n + j), weight[:, j], self.residual[:, j]) for j in range(n))
        return sign * float(process.squares(self.e, p.ends).sum()) + squares

    def with_stiction(self, known: FloatArray) -> Self:
        """The same, given what dry friction leaves open at each torque sample (N, 2, n)."""
        own = copy(self)
        own.problem = self.problem.with_stiction(known)
        return own

    def __call__(self, disturbance: Disturbance) -> float:
        """log p up to a constant; -inf where the equations cannot be solved."""
        noise = disturbance.put(self.noise)
        try:
            return self._value(noise, *self._solved(noise))
        except np.linalg.LinAlgError:
            return -np.inf

    def climb(self, disturbance: Disturbance, joint: int) -> tuple[float, FloatArray]:
        """log p as above, and its derivatives (3,) by the logarithms of one joint's level, time constant and white
        noise.

        By Fisher's identity (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39, 1977) they are those of the log
        likelihood of motion and readings together, in the mean over motions given the readings.
        """
        p, n, noise = self.problem, self.problem.n, disturbance.put(self.noise)
        try:
            solved, squares = self._solved(noise)
        except np.linalg.LinAlgError:
            return -np.inf, np.zeros(3)
        value = self._value(noise, solved, squares)
        diagonal, upper = solved.inverse_blocks()
        step = -solved.solution(np.ones(1))
        u, e = 2 * n + joint, 3 * n + joint
        process = Process.of(noise, p.dt)
        by_variance, by_constant = process.score(self.e + step[:, 3 * n :], np.einsum("kii->ki", diagonal)[:, 3 * n :],
                                                 np.einsum("kii->ki", upper)[:, 3 * n :], p.ends)
        square = (self.residual[:, joint] + step[:, u] + step[:, e]) ** 2
        square += diagonal[:, u, u] + diagonal[:, e, e] + 2.0 * diagonal[:, u, e]
        variance = p.torque_variance(noise)[:, joint]
        own = p.torque_level(noise)[:, joint] ** 2
        slope = np.array([2.0 * by_variance[joint], by_constant[joint],
                          2.0 * float(np.sum(own / variance * (1.0 - square / variance)))])
        if noise.disturbance[joint] < OFF * noise.torque[joint]:  # as small as `Process` lets it be
            slope[[2, 0]] += slope[0], -slope[0]
        return value, -0.5 * slope

    def _value(self, noise: Noise, solved: Swept, squares: float) -> float:
        p = self.problem
        of_rows = float(np.sum(np.log(p.torque_variance(noise)))) + Process.of(noise, p.dt).log_determinant(p.ends)
        return -0.5 * (squares - float(solved.product()[0, 0]) + solved.log_determinant() + of_rows)

    def smoothed(self, disturbance: Disturbance) -> FloatArray:
        """(N, n) most likely disturbance torques on the joints [N m]. Raises `LinAlgError`."""
        solved, _ = self._solved(disturbance.put(self.noise))
        return -(self.e - solved.solution(np.ones(1))[:, 3 * self.problem.n :])

    def _solved(self, noise: Noise) -> tuple[Swept, float]:
        chain = BlockTridiagonal(self.base.rows.copy(), 1)
        squares = self.others + self._add(chain, noise, 1.0)
        return eliminate(chain), squares


def disturbed_problem(signals: Sequence[SignalSet], plain: LatentProblem) -> LatentProblem:
    """The problem `plain` of the same `signals`, with a disturbance at every joint."""
    if plain.disturbed:
        return plain
    return LatentProblem(signals, plain.mechanism, plain.collocation.hold).with_disturbance()


def disturbance_likelihood(signals: Sequence[SignalSet], problem: LatentProblem, state: State,
                           disturbed: Callable[[Sequence[SignalSet]], LatentProblem] | None = None,
                           most: float = EXCERPT) -> MarginalLikelihood:
    """At a fit's motion and parameters; of a long record the first part of each segment, `most` samples in all.

    `disturbed` makes the disturbed problem of these parts, by default one without effects.
    """
    parts, where = excerpt(signals, most)
    own = (LatentProblem(parts, problem.mechanism, problem.collocation.hold).with_disturbance() if disturbed is None
           else disturbed(parts))
    stiction = problem.stiction(state.noise)
    own = own.with_stiction(None if stiction is None else stiction[where])
    x = state.x.of(where)
    return MarginalLikelihood(own, x if x.e is not None else replace(x, e=np.zeros_like(x.u)), state.beta,
                              state.noise.at(where))


def predicts_worse(signals: Sequence[SignalSet], options: FitOptions, than: FittedModel, model: FittedModel) -> bool:
    """Whether a model predicts a second ahead materially worse than another one, for sure.

    A disturbance that stands for structure of the model may favour parameters that no longer simulate the machine.
    """
    ratio, half = log_ratio(errors_ahead(signals, [than, model], options))
    return ratio - half > np.log(1.0 + WORSE)


def alike(before: Disturbance, after: Disturbance) -> bool:
    """Whether all levels and time constants are the same within SAME."""
    pairs = [(before.level, after.level), (before.time_constant, after.time_constant)]
    return np.array_equal(before.level > 0.0, after.level > 0.0) and all(
        bool(np.all(np.abs(np.log(a[after.level > 0.0] / b[after.level > 0.0])) < SAME)) for a, b in pairs)


def most_disturbance(problem: LatentProblem) -> float:
    """Highest level of a disturbance [N m]; with more the model explains too little of the torque to be one."""
    return TORQUE_SHARE * max(float(np.max(problem.torque_spread)), 1e-300)


def find_disturbance(likelihood: MarginalLikelihood, begin: Disturbance, options: FitOptions) -> Disturbance:
    """The likeliest disturbance of every joint, 0 where it is not worth its two parameters; from `begin`.

    What `options` give stays as given.
    """
    found, problem = begin, likelihood.problem
    cost = np.log(problem.total)
    known_white = [options.torque_noise(j, j in problem.mechanism.actuated) is not None for j in range(problem.n)]
    for j in range(problem.n):
        given = options.disturbance(j)
        if given is not None:
            found = _with(found, j, *given, found.white[j])
            continue
        none = _with(found, j, 0.0, found.time_constant[j], np.hypot(found.white[j], found.level[j])
                     if not known_white[j] else found.white[j])
        again = bool(found.level[j] > 0.0)
        best = found if again else _screened(likelihood, none, j)
        if best is None:
            found = none
            continue
        best, reached = _climbed(likelihood, best, j, known_white[j])
        found = best if reached > likelihood(none) + cost else none
    return found


def _screened(likelihood: MarginalLikelihood, none: Disturbance, joint: int) -> Disturbance | None:
    """The likeliest of a few time constants; None where all are less likely than no disturbance."""
    plain, p = likelihood(none), likelihood.problem
    tried = [_with(none, joint, SCREENED * none.white[joint], T * p.dt, none.white[joint])
             for T in TIME_CONSTANTS if T * p.dt < LONGEST_S]
    values = [likelihood(one) for one in tried]
    best = int(np.argmax(values))
    return tried[best] if values[best] > plain else None


def _climbed(likelihood: MarginalLikelihood, begin: Disturbance, joint: int, known_white: bool
             ) -> tuple[Disturbance, float]:
    """The likeliest level, time constant and white noise of one joint near `begin`, and their log p."""
    from scipy.optimize import minimize

    p = likelihood.problem
    most = most_disturbance(p)
    whole = float(np.hypot(begin.level[joint], begin.white[joint]))
    least = max(SMALLEST * whole, float(likelihood.floors.torque[joint]))
    low = np.log([SMALLEST * whole, SHORTEST * p.dt, least])
    white = most_noise(p, joint, likelihood.floors, True) if joint in p.mechanism.actuated else most
    high = np.log([max(most, 2.0 * SMALLEST * whole), LONGEST_S, max(white, 2.0 * least)])
    free = 2 if known_white else 3

    def at(theta: FloatArray) -> Disturbance:
        level, constant, *white = np.exp(theta)
        return _with(begin, joint, float(level), float(constant), float(white[0]) if white else begin.white[joint])

    def unlikely(theta: FloatArray) -> tuple[float, FloatArray]:
        value, slope = likelihood.climb(at(theta), joint)
        return -value, -slope[:free]

    start = np.log([begin.level[joint], begin.time_constant[joint], begin.white[joint]])
    found = minimize(unlikely, np.clip(start, low, high)[:free], jac=True, method="L-BFGS-B",
                     bounds=list(zip(low[:free].tolist(), high[:free].tolist(), strict=True)),
                     options={"maxfun": MOST_EVALUATIONS, "gtol": FLAT})
    return at(found.x), -float(found.fun)


def _with(disturbance: Disturbance, joint: int, level: float, constant: float, white: float) -> Disturbance:
    """`disturbance` with one joint's values."""
    out = Disturbance(*(values.copy() for values in disturbance))
    out.level[joint], out.time_constant[joint], out.white[joint] = level, constant, white
    return out
