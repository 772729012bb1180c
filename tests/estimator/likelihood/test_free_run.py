"""Torque laws of effects in a simulation: their derivatives, and motion that they change."""

import sys
from typing import Any

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray
from pytest import MonkeyPatch, approx, mark
from scipy.integrate import solve_ivp

from estimator import Effect, FitOptions
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.model import nominal_model, refit
from estimator.effects import Backlash, EncoderOffset, StribeckFriction
from estimator.effects.base_compliance import BaseCompliance
from estimator.effects.presliding_friction import PreslidingFriction
from estimator.effects.rotor_inertia import RotorInertia
from estimator.effects.torque_saturation import TorqueSaturation
from estimator.likelihood import (
    LatentProblem,
    Latents,
    Noise,
    Stage,
    State,
    effective_samples,
    find_stiction,
    free_run,
    pieces,
)
from estimator.likelihood.effect_columns import acting
from estimator.likelihood.free_run import _Plant
from estimator.model import Mechanism, joint1, leg2
from estimator.signals import SignalSet, torque_of
from tests.support.mujoco_leg import Leg, record

FloatArray = NDArray[np.float64]
REACH = np.array([[-1.0, 1.0], [-1.0, 1.0]])
BETA = np.array([0.14, 0.03, 0.05, 0.5, 0.15, 0.02, 0.03, 0.03, 0.06])
LEG = leg2(lever_arm=0.2)


def problem_of(mechanism: Mechanism, torque: np.ndarray, effects: list[Effect]) -> LatentProblem:
    count = len(torque)
    grid = np.arange(count) / 100.0
    imu = {c: np.zeros(count) for c in ("gyro_radps", "accel_x_mps2", "accel_y_mps2")} if mechanism.n > 1 else {}
    signals = SignalSet("r", 100.0, grid, np.zeros((count, mechanism.n)), torque, imu)
    return LatentProblem([signals], mechanism, "linear", Stage((0,), (0.0,), (0.0,), REACH, 7.0), effects)


def at(latents: Latents, beta: np.ndarray) -> State:
    return State(latents, beta, Noise(*np.ones((2, latents.q.shape[1]))), np.eye(beta.size))


def at_rest(beta: np.ndarray, torque: np.ndarray) -> State:
    return at(Latents(np.zeros_like(torque), np.zeros_like(torque), torque), beta)


def knee_sine(count: int, amplitude: float, step: float) -> np.ndarray:
    """Torques (count, 2) of a motor at the knee."""
    return np.column_stack([np.zeros(count), amplitude * np.sin(step * np.arange(count))])


def test_a_rotor_heavier_than_its_link_is_a_heavier_link() -> None:
    """(J + Jr) qdd = tau - ...: with Jr = 3 J the rotor's torque, found from the acceleration, would feel itself with
    a gain of three."""
    torque = 0.8 * np.sin(np.arange(300) * 0.05)[:, None]
    runs = [free_run(problem_of(joint1(), torque, list(effects)), at_rest(np.array(beta), torque), torque)
            for beta, effects in (([0.02, 0.1, 0.03, 0.05, 0.06], [RotorInertia(0)]), ([0.08, 0.1, 0.03, 0.05], []))]
    assert np.ptp(runs[0].q) > 1.0
    assert runs[0].q == approx(runs[1].q, abs=1e-7)


def test_an_accelerometer_feels_a_rotor_heavier_than_its_link() -> None:
    """(M + J e2 e2^T) qdd = M qdd without it; its own torque at its own acceleration grows where J is above what M
    leaves of joint 2."""
    torque = knee_sine(100, 0.8, 0.1)
    problem, rotor = problem_of(LEG, torque, [RotorInertia(1)]), np.array([0.05])
    x = Latents(0.8 * default_rng(1).normal(size=(100, 2)), default_rng(2).normal(size=(100, 2)), torque)
    free, inverse = problem._free(x, np.append(BETA, rotor))
    view, _, at_samples, _ = acting([(problem.effects[0], rotor)], free, inverse)
    inertia = LEG.inertia_matrix(x.q, BETA)
    expected = np.linalg.solve(inertia + np.diag([0.0, 0.05]), inertia @ free.samples.a.T[:, :, None])[:, :, 0]
    assert (0.05 * inverse[1, 1]).min() > 1.0
    assert approx(expected, rel=1e-9) == view.samples.a.T and at_samples[1] == approx(0.05 * expected[:, 1], rel=1e-9)


@mark.parametrize("displacement", [0.002, 0.03])
def test_a_state_solved_with_the_motion_is_that_found_by_iteration(displacement: float,
                                                                   monkeypatch: MonkeyPatch) -> None:
    """... and costs one simulation, where stiff bristles over two seconds cost hundreds."""
    torque = 0.4 * np.sin(0.08 * np.arange(200))[:, None]
    problem = problem_of(joint1(), torque, [PreslidingFriction(0)])
    state = at_rest(np.array([0.02, 0.1, 0.03, 0.05, 0.05, 0.01, displacement]), torque)
    module, calls = sys.modules[free_run.__module__], []
    simulate = module.simulate
    monkeypatch.setattr(module, "simulate", lambda *args: calls.append(1) or simulate(*args))
    found = free_run(problem, state, torque)
    assert np.ptp(found.q) > 0.5 and len(calls) == 1
    monkeypatch.setattr(module, "_remembers", lambda effect: True)
    again = free_run(problem, state, torque)
    assert len(calls) > 5
    assert found.q == approx(again.q, abs=2e-5)


@mark.parametrize("effects, sizes", [([], []), ([StribeckFriction(1)], [0.1, 0.2, 2.0]),
                                            ([PreslidingFriction(1)], [0.05, 0.01, 0.01])])
def test_pieces_simulated_together_are_those_simulated_one_by_one(
        effects: list[Effect], sizes: list[float], monkeypatch: MonkeyPatch) -> None:
    """Each piece begins at the state that it is given, whatever the one before it ended with; torque over ends of
    pieces is linear, so nothing else joins them."""
    rng = default_rng(3)
    beta, torque = np.append(BETA, sizes), knee_sine(200, 0.8, 0.1)
    problem = problem_of(LEG, np.zeros((200, 2)), effects)
    whole = free_run(problem, at_rest(beta, torque), torque)
    assert np.ptp(whole.q) > 0.5
    given = Latents(whole.q + rng.normal(scale=0.01, size=(200, 2)), whole.v + rng.normal(scale=0.1, size=(200, 2)),
                    torque)
    state = at(given, beta)
    with monkeypatch.context() as patched:
        patched.delattr(_Plant, "run")
        together = free_run(problem, state, torque, 0.1)
    plant = _Plant(problem, state, torque)
    nothing = np.zeros((2, 2, problem.left.size))
    for where in pieces(problem, 0.1):
        start = given.q[where.start], given.v[where.start]
        q, v = plant.run(where, given.q, given.v, start, nothing)
        assert together.q[where] == approx(q, abs=1e-7) and together.v[where] == approx(v, abs=1e-6)
        assert np.array_equal(together.q[where.start], given.q[where.start])


def test_a_piece_that_diverges_stays_still_and_leaves_the_others_alone(monkeypatch: MonkeyPatch) -> None:
    """A servo's friction of a negative level ran off in one piece of a tenth of a second, and all pieces of the run
    were taken for lost: 12.6 times the noise alone instead of 1.1."""
    module = sys.modules[free_run.__module__]
    plain = module.simulate

    def sometimes(mechanism: Mechanism, beta: FloatArray, q0: FloatArray, *rest: Any) -> tuple[FloatArray, ...]:
        found = plain(mechanism, beta, q0, *rest)
        lost = len(rest) == 8 or q0[1] == 0.5
        return tuple(np.full_like(x, np.nan) for x in found) if lost else found

    torque = knee_sine(200, 0.3, 0.1)
    state = at_rest(BETA, torque)
    state.x.q[100, 1] = 0.5
    problem = problem_of(LEG, np.zeros((200, 2)), [])
    whole = free_run(problem, state, torque, 0.1)
    monkeypatch.setattr(module, "simulate", sometimes)
    assert whole is not None and free_run(problem, state, torque, 0.1) is None
    found = free_run(problem, state, torque, 0.1, or_still=True)
    lost = slice(100, 110)
    assert np.all(found.q[lost, 1] == 0.5) and np.all(found.v[lost] == 0.0)
    kept, known = (np.delete(run.q, lost, axis=0) for run in (found, whole))
    assert kept == approx(known, abs=1e-6)


def swing(leg: Leg, stand: tuple[float, float, float], time: FloatArray, torque: FloatArray) -> FloatArray:
    """(N, 4) absolute angles and rates of both links of a leg on a stand of mass M = 1/stand[0] that swings sideways
    at stand[1] Hz with damping stand[2], by the Lagrangian

    L = A w1^2/2 + B w2^2/2 + C cos(th1 - th2) w1 w2 + x' (g1 cos th1 w1 + g2 cos th2 w2) + M x'^2/2
        + g (g1 cos th1 + g2 cos th2) - K x^2/2.
    """
    a, b, c, g1, g2 = leg.beta()[:5]
    mass, omega = 1.0 / stand[0], 2.0 * np.pi * stand[1]

    def slope(t: float, y: FloatArray) -> FloatArray:
        th1, th2, x, w1, w2, xd = y
        tau, knee = np.interp(t, time, torque), leg.viscous[1] * (w2 - w1)
        moments = [g1 * np.cos(th1), g2 * np.cos(th2)]
        coupled = c * np.cos(th1 - th2)
        inertia = np.array([[a, coupled, moments[0]], [coupled, b, moments[1]], [*moments, mass]])
        force = [-tau + knee - leg.viscous[0] * w1 - c * np.sin(th1 - th2) * w2**2 - 9.81 * g1 * np.sin(th1),
                 tau - knee + c * np.sin(th1 - th2) * w1**2 - 9.81 * g2 * np.sin(th2),
                 g1 * np.sin(th1) * w1**2 + g2 * np.sin(th2) * w2**2
                 - mass * (2.0 * stand[2] * omega * xd + omega**2 * x)]
        return np.concatenate([y[3:], np.linalg.solve(inertia, force)])

    found = solve_ivp(slope, (time[0], time[-1]), np.zeros(6), t_eval=time, rtol=1e-8, atol=1e-9, max_step=0.01)
    return np.asarray(found.y[[0, 1, 3, 4]].T)


def test_a_free_run_on_a_stand_near_its_resonance_converges() -> None:
    """As a torque by the motion before it had been iterated: what did not settle was 61 mrad off, what did 1 mrad."""
    leg, stand, time = Leg(), (0.19, 2.5, 0.08), np.arange(1000) / 100.0
    torque = np.sum([0.15 * np.sin(2 * np.pi * f * time + f) for f in (0.4, 1.1, 1.7, 2.6)], axis=0)
    th1, th2, w1, w2 = swing(leg, stand, time, torque).T
    q, v = np.stack([th1, th2 - th1], axis=-1), np.stack([w1, w2 - w1], axis=-1)
    tau = np.stack([np.zeros_like(torque), torque], axis=-1)
    beta = np.concatenate([leg.beta()[:7], [0.0, 0.0], stand])
    found = free_run(problem_of(LEG, tau, [BaseCompliance()]), at(Latents(q, v, tau), beta), tau)
    assert np.abs(q).max() > 0.8
    assert found.q == approx(q, abs=2e-5)


def test_a_stand_that_does_not_yield_is_none() -> None:
    tau, beta = knee_sine(200, 0.1, 0.05), Leg().beta()
    plain = free_run(problem_of(LEG, tau, []), at_rest(beta, tau), tau)
    found = free_run(problem_of(LEG, tau, [BaseCompliance()]), at_rest(np.append(beta, [0.0, 3.0, 0.1]), tau), tau)
    assert np.abs(plain.q).max() > 0.05
    assert found.q == approx(plain.q, abs=1e-9)


def test_readings_beyond_all_numbers_are_no_free_run() -> None:
    """They became a rehearsal without an encoder, and the diagnosis an internal error."""
    tau = np.zeros((100, 2))
    problem = problem_of(LEG, tau, [EncoderOffset(1)])
    for offset, runs in ((0.1, True), (np.inf, False)):
        assert (free_run(problem, at_rest(np.append(Leg().beta(), offset), tau), tau) is not None) == runs


@mark.parametrize("effect", [TorqueSaturation(), Backlash(1)], ids=lambda e: e.name)
def test_readings_that_follow_the_torque_are_linearised(effect: Effect) -> None:
    """At random latents, half the derivative of the objective by a torque is the gradient, and the torque channel's
    degrees of freedom are those of its whole derivative."""
    rng, count = default_rng(8), 60
    size = np.array([0.9] if effect.joint is None else [0.1, 0.02, 0.03, 1e-4, 0.2])
    problem = problem_of(LEG, rng.normal(size=(count, 2)), [effect])
    beta = np.append(BETA, size)
    noise = Noise(np.array([5.0, 2.0]), np.array([np.inf, 0.1]), np.ones(1), np.full((1, 2), 20.0))
    x = Latents(*(scale * rng.normal(size=(count, 2)) for scale in (0.5, 1.0, 0.4)))
    point = problem.linearise(x, beta, noise)
    gradient = point.chain.right[:, :, 0]
    for k in (0, 7, 31, count - 1):
        step = np.zeros((count, problem.block))
        step[k, 5] = 1e-4
        up, down = (problem.linearise(x.moved(a * step), beta, noise).objective for a in (1.0, -1.0))
        assert gradient[k, 5] == approx((up - down) / 4e-4, rel=1e-3)
    step = 1e-5 * rng.normal(size=(count, problem.block))
    after = problem.residuals_after(point, step, np.zeros(0), np.zeros(0, dtype=np.intp))
    moved = problem.linearise(x.moved(step), beta, noise).residuals
    for channel in ("torque", "encoder"):
        change = moved[channel] - point.residuals[channel]
        assert after[channel] - point.residuals[channel] == approx(change, rel=1e-2, abs=1e-8)
    variance = np.einsum("k,ij->kij", rng.uniform(1.0, 2.0, count), np.eye(problem.block))
    by_u = 1.0 + point.extra.by_torque.get(torque_of(1), 0.0)
    taken = effective_samples(problem, point, variance, noise)["torque"][0, 1]
    assert taken == approx(np.sum(by_u**2 * variance[:, 5, 5]) / 2.0**2)


def test_a_saturated_motor_needs_more_current_than_its_torque_says() -> None:
    """i of u = i / sqrt(1 + 2 c i^2), which has a limit; above it the reading goes on."""
    current, c = np.linspace(-1.0, 1.0, 41), 1.2
    torque = current / np.sqrt(1.0 + 2.0 * c * current**2)
    torque[-1] = 2.0  # more than the motor can give
    problem = problem_of(LEG, np.zeros((41, 2)), [])
    x = Latents(np.zeros((41, 2)), np.zeros((41, 2)), np.column_stack([np.zeros(41), torque]))
    added = TorqueSaturation().readings(problem.view(x, BETA), np.array([c]))[torque_of(1)]
    assert (torque + added)[:-1] == approx(current[:-1])
    assert np.isfinite(added[-1]) and added[-1] > 10.0


def test_a_shape_at_a_limit_is_held_and_has_no_interval() -> None:
    leg = Leg()
    runs = [record(leg, default_rng(40 + k), seconds=6.0, name=f"r{k}") for k in range(2)]
    session = split_runs(runs, LEG, FitOptions(sensors="imu"))
    nominal = nominal_model(session)
    effect = StribeckFriction(1)
    low = effect.clipped(np.array([0.01, 1e-9, 2.0]))[1]
    assert list(effect.at_limits(np.array([0.01, low, 2.0]))) == [True, False]
    assert list(effect.at_limits(np.array([0.01, 1.5 * low, 2.0]))) == [False, False]
    held = refit(nominal, [(effect, np.array([0.01, low, 2.0]))], 4)
    free = refit(nominal, [(effect, np.array([0.01, low, 2.0]))], 4, hold_limits=False)
    assert held.state.beta[-2] == low and held.state.covariance[-2, -2] == 0.0
    assert free.state.covariance[-2, -2] > 0.0
    assert free.state.beta[-1] == 2.0 and free.state.covariance[-1, -1] == 0.0  # discrete: never re-fitted


def test_an_effects_friction_near_rest_counts_with_the_coulomb_level() -> None:
    rest = np.zeros((41, 2))
    problem, beta = problem_of(LEG, rest, [StribeckFriction(1)]), np.append(BETA, [0.1, 0.2, 2.0])
    assert problem.dry_levels(beta) == approx({0: 0.03, 1: 0.16})
    more = find_stiction(problem, rest, beta, one_per_crossing=False)[:, 0]
    less = find_stiction(problem_of(LEG, rest, []), rest, BETA, one_per_crossing=False)[:, 0]
    assert more[:, 0] == approx(less[:, 0]) and more[:, 1] == approx((0.16 / 0.06) ** 2 * less[:, 1])
