"""Maximum likelihood with one consistent latent motion: the default estimator.

Section IV of the paper with two changes: the latents are one trajectory whose rate and acceleration are its
derivatives (`estimator.collocation`), and noise levels are estimated instead of tuned by hand. With the right
ratio of noise levels this is total least squares along time, which does not shrink beta.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.dataset import Dataset
from estimator import oddeven
from estimator.batch import BatchProblem, Records
from estimator.effects.timing import SensorTimeSkew
from estimator.errors import FitError
from estimator.extended import ExtendedProblem, Stage
from estimator.identifiability import undetermined
from estimator.latent import LatentProblem, Latents, Linearised, Noise
from estimator.mechanism import Mechanism
from estimator.options import FitOptions
from estimator.result import FitResult, Trajectory
from estimator.search import EXACT_ENCODER, Searched, known_noise, search, suits
from estimator.sensors import accelerometer
from estimator.signals import quantum, white_noise_level
from estimator.signalset import SignalSet, angle_column, differentiate, split_signals
from estimator.wls import driven_first, free_mask, stack_regressors, weighted_least_squares

FloatArray = NDArray[np.float64]
MAX_ITERATIONS = 60
TOLERANCE = 0.05
"""Converged when a step moves no parameter by more than this share of its standard deviation."""
ANGLE_TOLERANCE = 1e-6
"""Converged, where no parameter is free, when no angle moves by more than this [rad]."""
LOOSE_AFTER = 15
LOOSE = 0.15
"""After so many steps this share of a standard deviation will do: a joint that reverses, or rests, close to a
sample makes the last digits swing."""
TORQUE_SHARE = 0.4
"""Most of a measured torque's spread that may be noise, and ..."""
PASSIVE_SHARE = 0.1
"""... the least model error of a passive joint as a share of the driven joints' noise. Without both a model that
is far wrong ends at beta = 0, where the passive joint's equation holds exactly and all torque is noise."""
REST_STEPS = 8
"""Steps in which rest is sought anew; then it is kept, so that the fit can settle."""
PASSIVE_WAIT = 1
STEEP = 0.95
PASSIVE_HASTE = 4.0
"""Where a passive joint's model error is nil its level falls by a constant factor a step; after PASSIVE_WAIT
steps a fall steeper than STEEP is taken to this power."""


@dataclass
class State:
    """Where a fit stands."""

    x: Latents
    beta: FloatArray
    noise: Noise
    covariance: FloatArray
    converged: bool = False
    iterations: int = 0


def fit_mle(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FitResult:
    """Identify by marginal maximum likelihood; see the module's text. Raises `FitError`."""
    start = time.perf_counter()
    signals = split_signals(datasets, mechanism, options)
    free, beta = free_mask(mechanism, options)
    if not any(np.any(s.torque) for s in signals) and bool(free.all()):
        raise FitError("every torque is zero, so the scale of the parameters is not determined; fix one with "
                       "--fix NAME=VALUE")
    problem = LatentProblem(signals, mechanism, options.hold)
    if suits(signals, mechanism, options):
        noise = known_noise(mechanism, options)
        state = state_of(search(BatchProblem(mechanism, signals[0].rate_hz, options.hold, noise),
                                Records(problem.angles[None], problem.torque[None])), 0, noise)
        return result_of(problem, signals, mechanism, options, state, free, time.perf_counter() - start)
    state = start_state(problem, signals, mechanism, options, free, beta)
    floors = noise_floors(problem, mechanism, state.beta)
    iterate(problem, state, free, options, floors)
    _refuse_collapse(problem, state, mechanism)
    bound_s = max(d.clock_bound_s for d in datasets)
    found = None
    if bound_s > 0.0 and problem.has_imu:
        state, found = _with_skew(problem, state, signals, free, options, floors, bound_s)
    result = result_of(problem, signals, mechanism, options, state, free, time.perf_counter() - start)
    return result if found is None else replace(result, assumptions=(*result.assumptions, found))


def _with_skew(problem: LatentProblem, state: State, signals: list[SignalSet], free: NDArray[np.bool_],
               options: FitOptions, floors: Noise, bound_s: float) -> tuple[State, str]:
    """`state` with the IMU's time line free against the controller's, and a sentence about it.

    Clocks that were put together by messages agree to within a bound only; tens of microseconds cost the pivot's
    viscous friction several standard deviations. Where the data cannot place the IMU better than the bound does,
    the lines stay as they are.
    """
    reach = np.zeros((problem.n, 2))
    blank = (0.0,) * len(signals)
    wide = ExtendedProblem(signals, problem.mechanism, options.hold,
                           Stage((0,) * len(signals), blank, blank, reach), (SensorTimeSkew(),))
    wide.rest = problem.rest
    again = State(state.x, np.append(state.beta, 0.0), state.noise, state.covariance)
    iterate(wide, again, np.append(free, True), options, floors)
    skew, std = float(again.beta[-1]), float(np.sqrt(again.covariance[-1, -1]))
    if not again.converged or std > bound_s:
        return state, (f"the IMU's time line is taken as it is, though known to {bound_s * 1e6:.0f} us only; the "
                       "motion does not place it better")
    if abs(skew) > bound_s:
        return state, (f"the IMU would fit best {skew * 1e6:.0f} us late against the controller, more than the clocks' "
                       f"{bound_s * 1e6:.0f} us: not allowed for, for something else is wrong; see legid diagnose")
    told = (f"the IMU is {skew * 1e6:.0f} +- {1.96 * std * 1e6:.0f} us late against the controller, by this motion "
            f"(clocks: within {bound_s * 1e6:.0f} us); allowed for")
    return State(again.x, again.beta[:-1], again.noise, again.covariance[:-1, :-1], True,
                 state.iterations + again.iterations), told


def state_of(found: Searched, record: int, noise: Noise) -> State:
    """What a search found for one of its records. Raises `FitError` where no start led anywhere."""
    if not np.isfinite(found.objective[record]):
        raise FitError("no start of the search led anywhere; the record is too short or too noisy")
    q, v, u = np.split(found.x[record], 3, axis=-1)
    return State(Latents(q, v, u), found.beta[record], noise, found.covariance[record],
                 bool(found.converged[record]), int(found.steps[record]))


def start_state(problem: LatentProblem, signals: list[SignalSet], mechanism: Mechanism, options: FitOptions,
           free: NDArray[np.bool_], beta: FloatArray) -> State:
    """Filtered motion, its least squares fit and rough noise levels."""
    rate = signals[0].rate_hz
    cutoff = options.cutoff(rate)
    motions = [differentiate(s, mechanism, min(2.0 * cutoff, 0.4 * rate), options.filter_order, fused=True)
               for s in signals]
    z, tau = stack_regressors(signals, motions, mechanism, cutoff, options.filter_order)
    start = beta
    beta, covariance, sigma = weighted_least_squares(z, tau, free, start, 1.0)
    if passive_joints(mechanism) and mechanism.actuated:
        beta = driven_first(z, tau, free, start, mechanism.actuated)
        sigma = np.maximum(np.sqrt(np.mean((tau - z @ beta) ** 2, axis=0)), 1e-3 * sigma)
    x = Latents(np.concatenate([k.q for k in motions]), np.concatenate([k.qd for k in motions]),
                problem.torque.copy())
    known = options.noise
    torque = np.maximum(sigma, [white_noise_level(problem.torque[:, j]) for j in range(mechanism.n)])
    if "torque_nm" in known:
        torque[list(mechanism.actuated)] = known["torque_nm"]
    if "passive_nm" in known:
        torque[passive_joints(mechanism)] = known["passive_nm"]
    encoder = np.full(mechanism.n, np.inf)
    for j in np.flatnonzero(problem.has_encoder):
        level = max(white_noise_level(problem.angles[:, j]), quantum(problem.angles[:, j]) / np.sqrt(12.0))
        given = options.encoder_noise(int(j))
        encoder[j] = max(level, 1e-7) if given is None else max(given, EXACT_ENCODER)
    gyro = accel = np.inf
    if problem.has_imu:
        gyro = known.get("gyro_radps", max(white_noise_level(problem.gyro), 1e-6))
        accel = known.get("accel_mps2", max(white_noise_level(problem.ax), white_noise_level(problem.ay), 1e-5))
    return State(x, beta, Noise(torque, encoder, gyro, accel), covariance)


def passive_joints(mechanism: Mechanism) -> list[int]:
    """Joints without a motor, 0-based."""
    return [j for j in range(mechanism.n) if j not in mechanism.actuated]


def _encoder_level(angle: FloatArray) -> float:
    """What differences between neighbours show of an encoder's error: its quantum, or white noise."""
    return max(white_noise_level(angle), quantum(angle) / np.sqrt(12.0))


def noise_floors(problem: LatentProblem, mechanism: Mechanism, beta: FloatArray) -> Noise:
    """Levels below which no estimate may fall: they only keep the equations solvable."""
    scale = max(float(np.std(problem.torque)), 1e-3 * float(np.max(np.abs(beta), initial=0.0)) * mechanism.gravity_mps2,
                1e-6)
    encoder = np.full(mechanism.n, np.inf)
    for j in np.flatnonzero(problem.has_encoder):
        encoder[j] = max(0.7 * _encoder_level(problem.angles[:, j]), 1e-8)
    gyro = accel = 0.0
    if problem.has_imu:
        gyro = 0.7 * white_noise_level(problem.gyro)
        accel = 0.7 * max(white_noise_level(problem.ax), white_noise_level(problem.ay))
    return Noise(np.full(mechanism.n, 2e-3 * scale), encoder, max(gyro, 1e-6), max(accel, 1e-5))


def iterate(problem: LatentProblem, state: State, free: NDArray[np.bool_], options: FitOptions,
            floors: Noise | None, limit: int = MAX_ITERATIONS) -> None:
    """Gauss-Newton on latents and the `free` parameters together, noise levels renewed each step.

    `floors` None keeps the noise levels. Sets `state.converged`; raises `FitError`.
    """
    index = np.flatnonzero(free)
    settled, share, lowest, change = 0, 1.0, np.inf, 0.0
    before = np.zeros(index.size)
    finds_rest = problem.rest is None
    for iteration in range(limit):
        state.iterations = iteration + 1
        if finds_rest and iteration < REST_STEPS:
            problem.rest = problem.rest_variance(state.x.v, state.beta)
        point = problem.linearise(state.x, state.beta, state.noise)
        try:
            factored = oddeven.factor(point.diagonal, point.lower)
        except np.linalg.LinAlgError:
            raise FitError("the equations of the fit became singular; the motion is not excited enough") from None
        columns = np.append(0, 1 + index)
        whole = columns.size == point.right.shape[1]
        halves = oddeven.halve(factored, point.right if whole else point.right[:, columns])
        product = halves.product()
        information = point.corner[np.ix_(index, index)] - product[1:, 1:]
        covariance = _pseudo_inverse(information)
        step_beta = -covariance @ (point.gradient_beta[index] - product[1:, 0])
        step = -oddeven.finish(factored, halves.combine(np.append(1.0, step_beta)[:, None]))
        step = step.reshape(problem.total, problem.block)
        del halves
        if iteration > 2:  # the first steps come from far off and their noise levels are rough
            along = float(step_beta @ information @ before)
            swings = along < -0.25 * float(before @ information @ before)
            share = max(0.1, 0.5 * share) if swings or point.objective > 1.05 * lowest else min(1.0, 1.2 * share)
            lowest = min(lowest, point.objective)
        before = step_beta
        damping = _shortest(step[:, : problem.n], share)
        state.x = state.x.moved(damping * step)
        state.beta = state.beta.copy()
        state.beta[index] += damping * step_beta
        state.covariance = np.zeros((state.beta.size, state.beta.size))
        state.covariance[np.ix_(index, index)] = covariance
        if not np.isfinite(state.beta).all():
            raise FitError("the fit ran away; the starting values are too far from the data")
        if floors is not None:
            residuals = problem.residuals_after(point, step, step_beta, index)
            change = _update_noise(problem, state, point, oddeven.inverse_diagonal(factored), residuals, options,
                                   floors)
        std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        moved = damping * float(np.max(np.abs(step_beta) / std, initial=0.0))
        if not index.size:
            moved = float(np.max(np.abs(step[:, : problem.n]))) / ANGLE_TOLERANCE * TOLERANCE
        enough = TOLERANCE if iteration < LOOSE_AFTER else LOOSE
        settled = settled + 1 if moved < enough and change < 0.01 else 0
        del point, factored  # before the next ones are made: they are large
        if settled >= 2:
            state.converged = True
            break


def _refuse_collapse(problem: LatentProblem, state: State, mechanism: Mechanism) -> None:
    """Raise where nearly all measured torque was put down to noise: then beta shrinks to nothing.

    With angles taken as exact and a large torque noise this is a maximum of the likelihood, and never the one
    that is meant (a drive with play, or time stamps that jitter, has larger angle errors than its encoder).
    """
    for j in mechanism.actuated:
        rms = float(np.std(problem.torque[:, j]))
        share = float(np.std(state.x.u[:, j] - problem.torque[:, j])) / max(rms, 1e-300)
        if rms > 0.0 and state.noise.torque[j] > 0.6 * rms and share > 0.5 and np.isfinite(state.noise.encoder).any():
            raise FitError(
                f"the fit puts the torque of joint {j + 1} down to noise; the angles carry more error than their "
                f"encoder shows ({np.min(state.noise.encoder):.2g} rad): declare it, play included, as encoder_rad "
                "under [noise], or lower rate_hz")


def _pseudo_inverse(information: FloatArray) -> FloatArray:
    """Inverse of a positive semidefinite matrix with unscaled columns; near-null directions get a huge variance."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-100))
    scaled = information / np.outer(scale, scale)
    if not np.isfinite(scaled).all():
        raise FitError("the fit ran away; the starting values are too far from the data")
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-13)
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def _shortest(angles: FloatArray, share: float) -> float:
    """`share`, less where an angle would move by more than 0.5 rad: a linearisation means little there."""
    biggest = share * float(np.max(np.abs(angles)))
    return share if biggest < 0.5 else share * 0.5 / biggest


def _update_noise(problem: LatentProblem, state: State, point: Linearised, p_diagonal: FloatArray,
                  residuals: Mapping[str, FloatArray], options: FitOptions, floors: Noise) -> float:
    """sigma^2 = sum r^2 / (samples - those taken by the latents); returns the largest relative change.

    `residuals` are those after a whole step: they belong to the same noise levels as the degrees of freedom do.
    Mixing them with the residuals before it, or after a part of it, makes the levels swing with period two.
    """
    taken = problem.effective_samples(point, p_diagonal, state.noise)
    weight = problem.torque_weight(state.noise)
    known, old = options.noise, state.noise
    actuated = problem.mechanism.actuated

    def level(r: FloatArray, gamma: float, floor: float, previous: float, haste: float = 1.0,
              count: float | None = None) -> float:
        size = r.size if count is None else count
        freedom = max(size - gamma, 0.002 * size)
        ratio = float(np.sqrt(np.sum(r * r) / freedom)) / previous
        value = previous * ratio ** (haste if ratio < STEEP else 1.0)
        return max(floor, float(np.clip(value, previous / 2.0, previous * 3.0)))

    torque, encoder = old.torque.copy(), old.encoder.copy()
    for j in range(problem.n):
        if ("torque_nm" if j in actuated else "passive_nm") not in known:
            r, count = weight[:, j] * residuals["torque"][:, j], float(weight[:, j].sum())
            haste = 1.0 if j in actuated or state.iterations <= PASSIVE_WAIT else PASSIVE_HASTE
            torque[j] = level(r, float(taken["torque"][j]), floors.torque[j], old.torque[j], haste, count)
            if j in actuated:
                torque[j] = min(torque[j], TORQUE_SHARE * float(np.std(problem.torque[:, j])) + floors.torque[j])
        if problem.has_encoder[j] and options.encoder_noise(int(j)) is None:
            r = residuals["encoder"][:, j]
            encoder[j] = level(r, float(taken["encoder"][j]), floors.encoder[j], old.encoder[j])
    driven = [torque[j] for j in actuated]
    most = max((TORQUE_SHARE * float(np.std(problem.torque[:, j])) for j in actuated), default=np.inf) or np.inf
    for j in range(problem.n):
        if j not in actuated and driven:
            torque[j] = min(max(torque[j], PASSIVE_SHARE * min(driven)), most)
    gyro, accel = old.gyro, old.accel
    if problem.has_imu and "gyro_radps" not in known:
        gyro = level(residuals["gyro"], float(taken["gyro"][0]), floors.gyro, old.gyro)
    if problem.has_imu and "accel_mps2" not in known:
        accel = level(residuals["accel"], float(taken["accel"][0]), floors.accel, old.accel)
    state.noise = Noise(torque, encoder, gyro, accel)
    pairs = [(torque, old.torque), (encoder, old.encoder), (np.array([gyro, accel]), np.array([old.gyro, old.accel]))]
    return max(float(np.max(np.abs(np.log(a[np.isfinite(a)] / b[np.isfinite(a)])), initial=0.0)) for a, b in pairs)


def result_of(problem: LatentProblem, signals: list[SignalSet], mechanism: Mechanism, options: FitOptions,
              state: State, free: NDArray[np.bool_], wall_s: float) -> FitResult:
    """The fit as others see it."""
    x, beta = state.x, state.beta
    qdd = np.concatenate([mechanism.forward_dynamics(x.q[s], x.v[s], x.u[s], beta)
                          for s in np.split(np.arange(problem.total), problem.ends[:-1])])
    tau = mechanism.inverse_dynamics(x.q, x.v, qdd, beta)
    residual = problem.torque - tau
    noise = {"torque_nm": float(np.max(state.noise.torque[list(mechanism.actuated)], initial=0.0))}
    passive = passive_joints(mechanism)
    if passive:
        noise["passive_joint_nm"] = float(np.max(state.noise.torque[passive]))
    if problem.has_encoder.any():
        noise["encoder_rad"] = float(np.max(state.noise.encoder[problem.has_encoder]))
    if problem.has_imu:
        noise |= {"gyro_radps": state.noise.gyro, "accel_mps2": state.noise.accel}
    trajectories = []
    for s, where in zip(signals, np.split(np.arange(problem.total), problem.ends[:-1])):
        measured, predicted = dict(s.imu), {}
        for j in np.flatnonzero(problem.has_encoder):
            column = angle_column(mechanism, int(j))
            measured[column], predicted[column] = s.angles[:, j], x.q[where, j]
        if s.imu:
            ax, ay = accelerometer(x.q[where, 0], x.v[where, 0], qdd[where, 0], mechanism.lever_arm,
                                   mechanism.gravity_mps2)
            predicted |= {"gyro_radps": x.v[where, 0], "accel_x_mps2": ax, "accel_y_mps2": ay}
        trajectories.append(Trajectory(s.run, s.time_s, x.q[where], x.v[where], qdd[where], tau[where], s.torque,
                                       measured, predicted))
    assumptions = (
        f"torque acts between samples by the '{options.hold}' hold",
        "all noise is white, Gaussian and independent between channels; levels "
        + ("as given" if set(options.noise) >= {"torque_nm"} else "estimated from the data"),
        "the model's form is right: what it leaves out is counted as torque noise")
    return FitResult(mechanism, "mle", options.sensors, beta, state.covariance, noise,
                     np.sqrt(np.mean(residual**2, axis=0)), state.converged, state.iterations, problem.total, wall_s,
                     undetermined(mechanism, beta, state.covariance, free), assumptions, (), tuple(trajectories),
                     dict(options.fixed))
