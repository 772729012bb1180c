"""`log_marginal` against a dense covariance, quadrature, a change of units, and the marginal of a disturbance."""

from dataclasses import replace
from itertools import product

import numpy as np
from pytest import approx, mark

from daq import FloatArray
from estimator import FitOptions
from estimator.fitting import Disturbance, converge_motion, disturbance_likelihood
from estimator.likelihood import LatentProblem, Latents, Noise, State, log_marginal
from estimator.model import joint1, leg2
from estimator.signals import SignalSet, split_signals
from tests.support.dense_chain import dense
from tests.support.mujoco_leg import Leg, record

RATE_HZ = 100.0
DT = 1.0 / RATE_HZ


def joint(samples: int, gravity: float, seed: int = 1) -> tuple[LatentProblem, State]:
    """A joint with an encoder that follows a sum of two sines, without dry friction, at its likeliest motion."""
    time = np.asarray(np.arange(samples) * DT, dtype=np.float64)
    angle = 0.4 * np.sin(5.0 * time) + 0.2 * np.cos(11.0 * time)
    rate, accel = np.gradient(angle, DT), np.gradient(np.gradient(angle, DT), DT)
    rng = np.random.default_rng(seed)
    torque = 0.1 * accel + 0.02 * rate + 9.81 * gravity * np.sin(angle) + 0.01 * rng.normal(size=samples)
    segment = SignalSet("r", RATE_HZ, time, angles=(angle + 1e-3 * rng.normal(size=samples))[:, None],
                        torque=torque[:, None], imu={})
    problem = LatentProblem([segment], joint1(), "linear")
    x = Latents(angle[:, None], rate[:, None], torque[:, None])
    state = State(x, np.array([0.1, gravity, 0.02, 0.0]), Noise(np.array([0.01]), np.array([1e-3])), np.zeros((4, 4)))
    return problem, converge_motion(problem, state, 40)


def at(problem: LatentProblem, state: State, beta: FloatArray, torque: float, encoder: float) -> State:
    noise = Noise(np.array([torque]), np.array([encoder]))
    return converge_motion(problem, replace(state, beta=beta, noise=noise), 60)


def exact(problem: LatentProblem, state: State) -> float:
    """log density of the readings of a joint without gravity, by its dense covariance: a linear system driven by an
    unknown torque, from an unknown start."""
    inertia, _, viscous, _ = state.beta
    n, slack = problem.total, float(problem.motion_level(state.noise)[0, 0])
    wide_motion, wide_torque = 100.0, 100.0
    # states (q, v) at all samples as a linear map of: start (2), torques (n), two rows of the equation an interval
    unknown = 2 + n + 2 * (n - 1)
    maps = np.zeros((n, 2, unknown))
    now = np.zeros((2, unknown))
    now[0, 0] = now[1, 1] = 1.0
    maps[0] = now
    for k in range(n - 1):
        by_state, right = np.zeros((2, 4)), np.zeros((2, unknown))
        for g, s in enumerate((0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))):
            rate = [(6 * s**2 - 6 * s) / DT, 3 * s**2 - 4 * s + 1, (-6 * s**2 + 6 * s) / DT, 3 * s**2 - 2 * s]
            accel = [(12 * s - 6) / DT**2, (6 * s - 4) / DT, (-12 * s + 6) / DT**2, (6 * s - 2) / DT]
            by_state[g] = inertia * np.array(accel) + viscous * np.array(rate)
            right[g, 2 + k], right[g, 3 + k] = 1.0 - s, s
            right[g, 2 + n + 2 * k + g] = 1.0
        now = np.asarray(np.linalg.solve(by_state[:, 2:], right - by_state[:, :2] @ now), dtype=np.float64)
        maps[k + 1] = now
    variance = np.concatenate([np.full(2, wide_motion**2), np.full(n, wide_torque**2), np.full(2 * n - 2, slack**2)])
    readings = np.zeros((2 * n, unknown))
    readings[:n] = maps[:, 0]
    readings[n:, 2 : 2 + n] = np.eye(n)
    own = np.concatenate([np.full(n, state.noise.encoder[0] ** 2), np.full(n, state.noise.torque[0] ** 2)])
    covariance = readings * variance @ readings.T + np.diag(own)
    y = np.concatenate([problem.angles[:, 0], problem.torque[:, 0]])
    return float(-0.5 * (np.linalg.slogdet(covariance)[1] + y @ np.linalg.solve(covariance, y)))


def test_of_a_linear_joint_it_is_that_of_a_dense_covariance() -> None:
    problem, state = joint(30, 0.0)
    others = [at(problem, state, np.array([inertia, 0.0, viscous, 0.0]), torque, encoder)
              for inertia, viscous, torque, encoder in
              ((0.1, 0.02, 0.01, 1e-3), (0.13, 0.02, 0.01, 1e-3), (0.1, 0.1, 0.02, 1e-3), (0.07, 0.0, 0.01, 3e-3))]
    told, wanted = (np.array([f(problem, one) for one in others]) for f in (log_marginal, exact))
    assert np.ptp(wanted) > 10.0
    assert told - told[0] == approx(wanted - wanted[0], abs=0.01)


def test_of_a_pendulum_it_is_the_integral_over_its_motion() -> None:
    """By Gauss-Hermite quadrature over all nine latents of three samples."""
    problem, state = joint(3, 0.3)
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    states = [at(problem, state, state.beta * factor, level, 1e-3)
              for factor, level in ((1.0, 0.01), (1.3, 0.01), (1.0, 0.03))]

    def integral(one: State) -> float:
        """log of the integral of density of motion times density of readings."""
        point = problem.motion_equations(one.x, one.beta, one.noise)
        root = np.linalg.inv(np.linalg.cholesky(dense(point.chain))).T
        ratio, width = 0.0, problem.block * problem.total
        for which in product(range(3), repeat=width):
            z = nodes[list(which)]
            moved = one.x.moved((root @ z).reshape(problem.total, problem.block))
            fall = problem.motion_equations(moved, one.beta, one.noise).objective - point.objective
            ratio += np.prod(weights[list(which)]) * np.exp(-0.5 * fall + 0.5 * z @ z)
        return float(np.log(ratio / (2.0 * np.pi) ** (0.5 * width)))

    assert [integral(one) for one in states] == approx([0.0] * 3, abs=1e-3)


def leg(unit: float = 1.0) -> tuple[LatentProblem, State]:
    """A leg of MuJoCo with its torques in another unit, at its likeliest motion."""
    made = Leg(coulomb=(0.0, 0.0))
    data = record(made, np.random.default_rng(9), rate_hz=RATE_HZ, seconds=2.0)
    mechanism = leg2(lever_arm=made.lever)
    (segment,) = split_signals([data], mechanism, FitOptions())
    problem = LatentProblem([replace(segment, torque=segment.torque * unit)], mechanism, "zero")
    noise = Noise(np.array([0.001, 0.01]) * unit, np.array([np.inf, 3e-4]), np.array([0.005]), np.full((1, 2), 0.1))
    beta = made.beta() * unit
    beta[7:] = 0.0
    q = np.stack([data["q1_rad"], data["q2_rad"]], axis=-1)
    state = State(Latents(q, np.gradient(q, 0.01, axis=0), problem.torque.copy()), beta, noise, np.zeros((9, 9)))
    return problem, converge_motion(problem, state, 40)


@mark.parametrize("free_nm", [0.0, 0.05])
def test_differences_do_not_depend_on_the_unit_of_torque(free_nm: float) -> None:
    """Nor where friction is free at rest: there a share of log |det J|, which has units, must not hang on a level, nor
    on how much of a record one of the models has at rest."""
    found = []
    for unit in (1.0, 1000.0):
        problem, state = leg(unit)
        rest = np.zeros((2, problem.total, 2, 2))
        rest[:, 100:180, 1] = (free_nm * unit) ** 2
        rest[1, 20:80, 1, 0] = (free_nm * unit) ** 2
        rest[:, 110, 0] = (5.0 * free_nm * unit) ** 2  # one value a crossing, as large as its samples
        one, other = (replace(state, noise=replace(state.noise, stiction=own)) for own in rest)
        other = replace(other, beta=state.beta * 1.05, noise=replace(other.noise, torque=state.noise.torque * 1.5))
        one, other = (converge_motion(problem, s, 40) for s in (one, other))
        assert one.noise.stiction is not None and other.noise.stiction is not None
        found.append(log_marginal(problem, other) - log_marginal(problem, one))
    assert abs(found[0]) > 1.0 and found[1] == approx(found[0], rel=1e-6)


def test_a_level_of_the_passive_joint_that_shrinks_is_not_likelier_for_ever() -> None:
    """The sum of squares with the volume of the sensors' noise, which integrates nothing, rises with each step down."""
    problem, state = leg()
    likelihoods = [log_marginal(problem, converge_motion(problem, replace(state, noise=replace(
        state.noise, torque=np.array([level, 0.01]))), 40)) for level in (1e-4, 1e-5, 1e-6)]
    assert np.ptp(np.diff(likelihoods)) < 1.0 and abs(likelihoods[2] - likelihoods[1]) < 1.0


def test_a_disturbance_s_level_has_the_likelihood_that_its_search_has() -> None:
    problem, state = leg()
    marginal = disturbance_likelihood([*problem.signals], problem, state)
    wide = problem.with_disturbance()
    x = replace(state.x, e=np.zeros_like(state.x.u))
    told, wanted = [], []
    for level in (0.004, 0.01, 0.02):
        one = Disturbance(np.array([0.0, level]), np.array([1.0, 0.1]), state.noise.torque)
        told.append(log_marginal(wide, converge_motion(wide, replace(state, x=x, noise=one.put(state.noise)), 40)))
        wanted.append(marginal(one))
    assert np.diff(told) == approx(np.diff(wanted), abs=0.5)
