"""One joint's motion as a spline, seen by several sensors whose errors are unknown: maximum likelihood of both.

Each sensor column is `f(theta, q, qd, qdd) + noise` of the motion q(t - lag). The motion is a quintic spline, so that
angle, rate and acceleration cannot contradict each other, and no measured signal stands in for a true one: theta is
not drawn towards zero by the noise of a differentiated regressor. The spline's coefficients are eliminated by their
banded normal equations; each column's noise is estimated from what is left, degrees of freedom counted.

Intervals come from leaving out one block of time after the other (delete-one jackknife of the last linearisation), so
that they hold for coloured errors too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from daq import FloatArray
from estimator.errors import FitError
from estimator.numerics import student_quantile
from estimator.signals import white_noise_level

Predict = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
"""(theta (p,), q, qd, qdd each (n,)) -> readings (n, c)."""

DEGREE = 5
MARGIN_S = 0.15
"""The spline goes on beyond the record by this, so that a lag can be tried."""
STEP = 1e-6
ITERATIONS, ROUNDS = 40, 3
BLOCKS = 20
PROBES = 8


class Sensor(NamedTuple):
    """Columns that share one delay."""

    predict: Predict
    lag: int | None = None
    """Index in theta of the time [s] by which these columns are late; None: they are the clock."""


@dataclass(frozen=True)
class Track:
    """One record without a gap."""

    time_s: FloatArray
    """(n,) increasing [s]."""
    readings: Sequence[FloatArray]
    """By sensor: (n, c)."""
    start: FloatArray
    """(n,) first guess of q [rad]."""


@dataclass(frozen=True)
class PathFit:
    """Result of the search."""

    theta: FloatArray
    covariance: FloatArray
    """(p, p), by the jackknife over blocks."""
    freedom: int
    """Of Student's t for intervals: blocks less one."""
    deviance: float
    """-2 log likelihood up to a constant, priors included: what fits of the same readings are compared by."""
    noise: Sequence[FloatArray]
    """By sensor: standard deviation of each column."""
    paths: Sequence[BSpline]
    """By track: q over time since the track's first sample [s]."""

    @property
    def half(self) -> FloatArray:
        """(p,) half of each 95 % interval."""
        return student_quantile(self.freedom) * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def fit_path(sensors: Sequence[Sensor], tracks: Sequence[Track], theta: FloatArray, prior_std: FloatArray,
             knot_s: float, rounds: int = ROUNDS, iterations: int = ITERATIONS) -> PathFit:
    """Theta and the motion of every track, from the guess `theta` (p,), about which it has a prior spread (p,).

    `knot_s`: spacing of the spline's knots; motion faster than about 1 / (2 knot_s) counts as noise. A wide prior
    keeps what the data does not tell finite; a spread near zero holds a parameter. `rounds`: how often the noise is
    estimated anew, `iterations`: steps allowed in each. Raises `FitError`.
    """
    problem = _Problem(sensors, tracks, theta, prior_std, knot_s)
    for _ in range(rounds):
        problem.minimise(iterations)
        problem.update_noise()
    problem.minimise(iterations)
    covariance = problem.jackknife()
    return PathFit(problem.theta, covariance, BLOCKS - 1, problem.deviance(), problem.noise,
                   [track.spline() for track in problem.parts])


class _Part:
    """One track with its spline."""

    def __init__(self, track: Track, knot_s: float) -> None:
        self.time = track.time_s - track.time_s[0]
        self.readings = track.readings
        spans = int(np.ceil((self.time[-1] + 2 * MARGIN_S) / knot_s))
        self.step = knot_s
        self.knots = -MARGIN_S + knot_s * np.arange(-DEGREE, spans + DEGREE + 1)
        self.size = spans + DEGREE
        if self.time.size < 2 * self.size:
            raise FitError(f"{self.time.size} samples are too few for a motion of {self.size} knots")
        self.plain = self.designs(0.0)
        value = self.plain[0]
        normal = (value.T @ value + 1e-9 * diags_array(np.ones(self.size))).tocsc()
        self.coefficients: FloatArray = splu(normal).solve(value.T @ track.start)

    def designs(self, lag: float) -> list[csr_array]:
        """Sparse maps (n, size) from coefficients to q, qd, qdd and the third derivative at the times less `lag`."""
        at = np.clip(self.time - lag, -MARGIN_S, self.time[-1] + MARGIN_S)
        out = []
        down: csr_array = diags_array(np.ones(self.size)).tocsr()
        for order in range(4):
            knots = self.knots[order: self.knots.size - order]
            out.append(csr_array(BSpline.design_matrix(at, knots, DEGREE - order)) @ down)
            rows = down.shape[0]
            eye: csr_array = diags_array(np.full(rows, 1.0 / self.step)).tocsr()
            down = (eye[1:] - eye[:-1]) @ down
        return out

    def spline(self) -> BSpline:
        return BSpline(self.knots, self.coefficients, DEGREE)


class _Linear(NamedTuple):
    """One sensor of one part, linearised: residual = left - of_path @ dc - of_theta @ dtheta, by column."""

    left: FloatArray
    of_path: Sequence[csr_array]
    of_theta: FloatArray
    """(n, c, p)"""


class _Problem:
    def __init__(self, sensors: Sequence[Sensor], tracks: Sequence[Track], theta: FloatArray, prior_std: FloatArray,
                 knot_s: float) -> None:
        self.sensors, self.parts = sensors, [_Part(track, knot_s) for track in tracks]
        self.theta, self.prior_mean = theta.copy(), theta.copy()
        self.weight = np.diag(prior_std**-2.0)
        self.noise = [np.array([max(np.median([white_noise_level(track.readings[s][:, c]) for track in tracks]), 1e-9)
                                for c in range(tracks[0].readings[s].shape[1])]) for s in range(len(sensors))]
        self.rng = np.random.default_rng(0)

    # -- the model -------------------------------------------------------------------------------------------

    def motion(self, part: _Part, sensor: Sensor, theta: FloatArray, coefficients: FloatArray,
               ) -> tuple[list[csr_array], list[FloatArray]]:
        designs = part.plain if sensor.lag is None else part.designs(float(theta[sensor.lag]))
        return designs, [design @ coefficients for design in designs]

    def cost(self, theta: FloatArray, coefficients: Sequence[FloatArray]) -> float:
        off = theta - self.prior_mean
        total = float(off @ self.weight @ off)
        for part, c in zip(self.parts, coefficients):
            for s, sensor in enumerate(self.sensors):
                _, motion = self.motion(part, sensor, theta, c)
                left = (part.readings[s] - sensor.predict(theta, *motion[:3])) / self.noise[s]
                total += float(np.sum(left**2))
        return total

    def linearise(self, part: _Part, s: int) -> _Linear:
        sensor, theta = self.sensors[s], self.theta
        designs, motion = self.motion(part, sensor, theta, part.coefficients)
        base = motion[:3]
        by_motion = []
        for k in range(3):
            up, down = ([m + sign * STEP if j == k else m for j, m in enumerate(base)] for sign in (1, -1))
            by_motion.append((sensor.predict(theta, *up) - sensor.predict(theta, *down)) / (2 * STEP))
        columns = part.readings[s].shape[1]
        of_path = [sum((diags_array(by_motion[k][:, c]) @ designs[k] for k in (1, 2)),
                       diags_array(by_motion[0][:, c]) @ designs[0]).tocsr() for c in range(columns)]
        of_theta = np.empty((part.time.size, columns, theta.size))
        for k in range(theta.size):
            move = np.zeros(theta.size)
            move[k] = STEP
            of_theta[:, :, k] = (sensor.predict(theta + move, *base) - sensor.predict(theta - move, *base)) / (2 * STEP)
        if sensor.lag is not None:
            of_theta[:, :, sensor.lag] = -sum(by_motion[k] * motion[k + 1][:, None] for k in range(3))
        noise = self.noise[s]
        left = (part.readings[s] - sensor.predict(theta, *base)) / noise
        return _Linear(left, [j / noise[c] for c, j in enumerate(of_path)], of_theta / noise[:, None])

    # -- the minimum -----------------------------------------------------------------------------------------

    def deviance(self) -> float:
        logs = sum(part.time.size * float(np.sum(np.log(noise))) for part in self.parts for noise in self.noise)
        return self.cost(self.theta, [part.coefficients for part in self.parts]) + 2.0 * logs

    def minimise(self, iterations: int) -> None:
        """Gauss-Newton with step halving. Raises `FitError` where it does not converge."""
        cost = self.cost(self.theta, [part.coefficients for part in self.parts])
        for _ in range(iterations):
            dtheta, dpaths = self.step()
            size = 1.0
            while size > 1e-4:
                theta = self.theta + size * dtheta
                paths = [part.coefficients + size * d for part, d in zip(self.parts, dpaths)]
                new = self.cost(theta, paths)
                if new <= cost:
                    break
                size *= 0.5
            else:
                return  # no descent any more: machine precision
            gain, cost, self.theta = cost - new, new, theta
            for part, path in zip(self.parts, paths):
                part.coefficients = path
            if gain < 1e-7 * max(cost, 1.0):
                return
        raise FitError("the sensors' errors could not be fitted: no convergence")

    def step(self) -> tuple[FloatArray, list[FloatArray]]:
        schur = self.weight.copy()
        gradient = self.weight @ (self.prior_mean - self.theta)
        pieces = []
        for part in self.parts:
            linear = [self.linearise(part, s) for s in range(len(self.sensors))]
            solve, cross, right = self.eliminate(part, linear)
            inner = solve(np.column_stack([cross, right]))
            for piece in linear:
                flat = piece.of_theta.reshape(-1, self.theta.size)
                schur += flat.T @ flat
                gradient += flat.T @ piece.left.ravel()
            schur -= cross.T @ inner[:, :-1]
            gradient -= cross.T @ inner[:, -1]
            pieces.append(inner)
        dtheta = np.asarray(np.linalg.solve(schur, gradient), dtype=np.float64)
        return dtheta, [inner[:, -1] - inner[:, :-1] @ dtheta for inner in pieces]

    def eliminate(self, part: _Part, linear: Sequence[_Linear],
                  ) -> tuple[Callable[[FloatArray], FloatArray], FloatArray, FloatArray]:
        """Solver of the path's normal equations, their coupling with theta (size, p), their right side (size,)."""
        normal = csr_array((part.size, part.size))
        cross = np.zeros((part.size, self.theta.size))
        right = np.zeros(part.size)
        for piece in linear:
            for c, j in enumerate(piece.of_path):
                normal = normal + j.T @ j
                cross += j.T @ piece.of_theta[:, c]
                right += j.T @ piece.left[:, c]
        # Beyond the record's ends nothing is measured: there a coefficient stays where it is.
        diagonal = normal.diagonal()
        normal = normal + diags_array(np.full(part.size, 1e-9 * float(diagonal.max())))
        return splu(normal.tocsc()).solve, cross, right

    # -- noise and intervals -----------------------------------------------------------------------------------

    def update_noise(self) -> None:
        """Standard deviation of every column from what is left, less what the path has taken up of it."""
        left = [np.zeros(noise.shape) for noise in self.noise]
        free = [np.zeros(noise.shape) for noise in self.noise]
        for part in self.parts:
            linear = [self.linearise(part, s) for s in range(len(self.sensors))]
            solve, _, _ = self.eliminate(part, linear)
            probes = self.rng.choice([-1.0, 1.0], (part.size, PROBES))
            solved = solve(probes)
            for s, piece in enumerate(linear):
                for c, j in enumerate(piece.of_path):
                    taken = float(np.sum((j @ probes) * (j @ solved))) / PROBES
                    free[s][c] += max(part.time.size - taken, 0.1 * part.time.size)
                    left[s][c] += float(np.sum(piece.left[:, c] ** 2))
        self.noise = [np.maximum(noise * np.sqrt(a / b), 1e-9) for noise, a, b in zip(self.noise, left, free)]

    def jackknife(self) -> FloatArray:
        """Covariance of theta from leaving out each of `BLOCKS` blocks of time."""
        p = self.theta.size
        scores, shares = np.zeros((BLOCKS, p)), np.zeros((BLOCKS, p, p))
        total = sum(part.time.size for part in self.parts)
        done = 0
        for part in self.parts:
            linear = [self.linearise(part, s) for s in range(len(self.sensors))]
            solve, cross, _ = self.eliminate(part, linear)
            inner = solve(cross)
            block = np.minimum((done + np.arange(part.time.size)) * BLOCKS // total, BLOCKS - 1)
            done += part.time.size
            for piece in linear:
                for c, j in enumerate(piece.of_path):
                    own = piece.of_theta[:, c] - j @ inner
                    for b in np.unique(block):
                        rows = block == b
                        scores[b] += own[rows].T @ piece.left[rows, c]
                        shares[b] += own[rows].T @ own[rows]
        whole = shares.sum(axis=0) + self.weight
        moves = np.array([np.linalg.solve(whole - share, score) for share, score in zip(shares, scores)])
        moves -= moves.mean(axis=0)
        bread = np.linalg.inv(whole)
        covariance: FloatArray = (BLOCKS - 1) / BLOCKS * moves.T @ moves + bread @ self.weight @ bread
        return covariance
