"""The likelihood's normal equations: derivatives, pieces, and the minimum that an independent solver finds."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import MonkeyPatch, approx, fixture, importorskip, mark

from daq import Dataset
from estimator import FitOptions, fit
from estimator.fitting import free_mask, iterate, start_state, stopping
from estimator.likelihood import LatentProblem, Latents, Noise, latent_problem
from estimator.model import leg2
from estimator.signals import split_signals
from tests.support.equations import normal
from tests.support.mujoco_leg import Leg, random_leg, record

OPTIONS = FitOptions(sensors="imu")


@fixture
def squares_alone(monkeypatch: MonkeyPatch) -> None:
    """The sum of squares without the density's other term, which enters the gradient only."""
    monkeypatch.setattr(LatentProblem, "_inertia_gradient", lambda _, beta, *__: np.zeros(beta.size))


def in_pieces_of(samples: int, monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(latent_problem, "PIECE", samples)


def stricter(tolerance: float, monkeypatch: MonkeyPatch) -> None:
    """Fits end where a step changes less than this."""
    for name in ("TOLERANCE", "LOOSE"):
        monkeypatch.setattr(stopping, name, tolerance)


@fixture(scope="module")
def broken() -> tuple[LatentProblem, Latents, np.ndarray, Noise]:
    """A record with two gaps, at the filtered motion."""
    leg = Leg()
    run = record(leg, default_rng(21), seconds=5)
    columns = {k: v.copy() for k, v in run.columns.items()}
    for values in columns.values():
        values[70:75] = values[230:290] = np.nan
    mechanism = leg2(lever_arm=leg.lever, rotor_inertia=(1,), torque_offset=(0,))
    signals = split_signals([Dataset("broken", run.rate_hz, run.time_s, columns)], mechanism, OPTIONS)
    problem = LatentProblem(signals, mechanism, OPTIONS.hold)
    free, beta = free_mask(mechanism, OPTIONS)
    state = start_state(problem, signals, mechanism, OPTIONS, free, beta)
    return problem, state.x, state.beta, state.noise


@mark.usefixtures("squares_alone")
def test_gradient_is_the_derivative(broken: tuple[LatentProblem, Latents, np.ndarray, Noise]) -> None:
    problem, x, beta, noise = broken
    point = problem.linearise(x, beta, noise)
    rng = default_rng(1)
    gradient = point.chain.right[:, :, 0]
    for k in [0, 69, 70, problem.total - 1, *rng.choice(problem.total, 6)]:
        for j in range(problem.block):
            step = np.zeros((problem.total, problem.block))
            step[k, j] = 1e-6
            up, down = (problem.linearise(x.moved(a * step), beta, noise).objective for a in (1.0, -1.0))
            numeric = (up - down) / 4e-6  # half the gradient of the sum of squares
            assert gradient[k, j] == approx(numeric, rel=1e-3, abs=1e-6 * point.objective)
    for j in range(beta.size):
        shift = np.zeros(beta.size)
        shift[j] = 1e-6
        up, down = (problem.linearise(x, beta + a * shift, noise).objective for a in (1.0, -1.0))
        assert point.gradient_beta[j] == approx((up - down) / 4e-6, rel=1e-4)


@mark.parametrize("piece", [1, 37])
def test_pieces_change_nothing(broken: tuple[LatentProblem, Latents, np.ndarray, Noise], piece: int,
                               monkeypatch: MonkeyPatch) -> None:
    problem, x, beta, noise = broken
    whole = problem.linearise(x, beta, noise)
    in_pieces_of(piece, monkeypatch)
    parts = problem.linearise(x, beta, noise)
    assert parts.objective == approx(whole.objective, rel=1e-12)
    for name, a in normal(whole).items():
        b = normal(parts)[name]
        assert_allclose(b, a, rtol=1e-9, atol=1e-11 * np.abs(a).max(), err_msg=name)


@mark.usefixtures("squares_alone")
def test_minimum_agrees_with_ipopt(monkeypatch: MonkeyPatch) -> None:
    importorskip("casadi", reason="needs the extra `bench`")
    from evidence.bench import casadi_ipopt
    from evidence.bench.record import Recorded, pose

    leg = Leg(coulomb=(0.0, 0.0))  # dry friction that changes sign beside a sample makes many minima
    run = record(leg, default_rng(22), seconds=4)
    posed = pose(Recorded(run, leg2(lever_arm=leg.lever), leg.beta(), (leg.m1, leg.m2), leg.l1))
    stricter(1e-6, monkeypatch)
    state = iterate(posed.problem, posed.end, np.ones(9, dtype=bool), OPTIONS, None, 100)  # noise held
    assert state.converged
    point = posed.problem.linearise(state.x, state.beta, state.noise)
    found = casadi_ipopt.solve(posed, 1e-14)
    assert point.objective == approx(found.objective, rel=1e-5)  # of the two, IPOPT stops above
    assert_allclose(state.beta, found.beta, rtol=1e-5, atol=1e-6)


def test_a_fit_ends_where_a_stricter_one_does(monkeypatch: MonkeyPatch) -> None:
    """A coarse encoder and a passive pivot: the first steps' misfit once kept beta 2.9 standard deviations high."""
    rng = default_rng(903)
    leg = random_leg(rng)
    run, mechanism = record(leg, rng, seconds=60, counts=2048), leg2(lever_arm=leg.lever)
    found = fit([run], mechanism, OPTIONS)
    stricter(0.002, monkeypatch)
    strict = fit([run], mechanism, OPTIONS)
    assert found.converged and strict.converged
    assert np.max(np.abs(found.beta - strict.beta) / strict.std) < 0.2
