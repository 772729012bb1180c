"""Structure that repeats between runs: learnt, within its bands, and of use on runs that did not teach it.

The truth is a law written out here: added to residuals by hand, or acting in MuJoCo.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx, mark, raises
from scipy.interpolate import RegularGridInterpolator

from daq import FloatArray
from estimator import FitError
from estimator.effects import Points, StateTorque, Table, Variable
from estimator.model import leg2, smooth_sign
from estimator.prediction import find_structure, outside_range, predict_run, smooth_segments, where_of, with_torques
from estimator.prediction.torque_regression import Samples, correlation_time, learn_torque
from tests.support.learnt import FRICTION_VELOCITY, OPTIONS, hidden_magnet, magnet, runs_of, true_model
from tests.support.ornstein_uhlenbeck import draw

RUNS, SAMPLES = 6, 1000
LEG = leg2(actuated=(1,))


def points(rng: Generator) -> Points:
    """Multisines of both joints and of the motor's torque."""
    t = np.arange(SAMPLES) * 0.01
    f = np.array([0.23, 0.61, 1.13])[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, RUNS, 3, 1))
    waves = np.sin(2.0 * np.pi * f * t + phase).sum(axis=2).reshape(3, -1)
    rates = (2.0 * np.pi * f * np.cos(2.0 * np.pi * f * t + phase)).sum(axis=2).reshape(3, -1)
    q, v, u = 0.5 * waves[:2], 0.5 * rates[:2], np.stack([0.0 * waves[2], waves[2]])
    return Points(q, v, np.zeros_like(q), u, smooth_sign(v, FRICTION_VELOCITY), *np.zeros((3, RUNS * SAMPLES)))


def samples(law: Callable[[Points], FloatArray], noise: FloatArray, seed: int = 1) -> Samples:
    """Residuals of the knee: `law` and noise (N,)."""
    at = points(default_rng(seed))
    residual = np.stack([np.zeros_like(noise), law(at) + noise], axis=-1)
    return Samples(at, residual, np.ones_like(residual), np.zeros(2), np.repeat(np.arange(RUNS), SAMPLES))


def white(seed: int) -> FloatArray:
    return 0.02 * default_rng(seed).normal(size=RUNS * SAMPLES)


def test_tables_interpolate_and_keep_their_edges() -> None:
    rng = default_rng(1)
    knots = tuple(np.cumsum(rng.uniform(0.1, 0.4, 6)) - 1.0 for _ in range(2))
    values = rng.normal(size=(6, 6))
    at = points(rng)
    pair = Table((Variable("angle", 1), Variable("rate", 0)), knots, values, values)
    clipped = [np.clip(x, k[0], k[-1]) for x, k in zip((at.q[1], at.v[0]), knots)]
    expected = RegularGridInterpolator(knots, values)(np.stack(clipped, axis=-1))
    assert pair.torque(at, 1) == approx(expected, abs=1e-12)
    assert pair.columns(at, 1) @ values.ravel() == approx(expected, abs=1e-12)
    directed = replace(pair, directed=True)
    assert directed.torque(at, 1) == approx(expected * at.sign[1], abs=1e-12)
    assert directed.columns(at, 1) @ values.ravel() == approx(expected * at.sign[1], abs=1e-12)
    law = StateTorque(1, [pair, directed], 0.3)
    assert law.torque(at) == approx(0.3 + expected * (1.0 + at.sign[1]), abs=1e-12)
    assert list(law.felt(2)) == [0, 1] and law.count == 0
    slack = 0.02 * np.ptp(knots[0])
    share = np.mean((at.q[1] < knots[0][0] - slack) | (at.q[1] > knots[0][-1] + slack))
    assert outside_range([law], at)["angle of joint 2"] == approx(share) and share > 0.0


LAWS = {
    "angle": lambda at: 0.1 * np.exp(-(((at.q[1] - 0.2) / 0.15) ** 2)),
    "rate": lambda at: 0.1 * at.v[1] / (1.0 + at.v[1] ** 2),
    "angle and direction": lambda at: 0.06 * at.sign[1] * (1.0 + np.sin(4.0 * at.q[1])),
    "motor torque": lambda at: 0.1 * np.tanh(at.u[1] / 0.3),
    "angle and rate": lambda at: 0.05 * at.q[1] * at.v[1],
}


@mark.parametrize("name", LAWS)
def test_a_hidden_law_is_within_its_bands(name: str) -> None:
    found = learn_torque(samples(LAWS[name], white(2)), 1, LEG)
    assert found.noise_nm == approx(0.02, rel=0.05)
    at = points(default_rng(3))
    truth, learnt, std = LAWS[name](at), found.law.torque(at), found.std(at)
    assert np.mean(np.abs(learnt - truth) < 1.96 * std) > 0.9
    assert np.std(learnt - truth) < 0.1 * np.std(truth) and np.median(std) < 0.1 * np.std(truth)
    strongest = max(found.law.tables, key=lambda table: np.std(table.torque(at, 1)))
    assert " and ".join([*(v.kind for v in strongest.variables), *["direction"] * strongest.directed]) == name


@mark.parametrize("seed", range(2))
def test_noise_and_disturbances_teach_nothing(seed: int) -> None:
    assert learn_torque(samples(lambda at: 0.0 * at.q[1], white(seed), seed), 1, LEG) is None
    rng = default_rng(seed)
    wandering = np.concatenate([draw(rng, SAMPLES, 0.05, 0.1, 0.01) for _ in range(RUNS)])
    assert learn_torque(samples(lambda at: 0.0 * at.q[1], wandering, seed), 1, LEG) is None
    assert learn_torque(samples(lambda at: 0.0 * at.q[1], np.zeros(RUNS * SAMPLES)), 1, LEG) is None


def test_bands_widen_with_the_scatter_between_runs() -> None:
    own = np.repeat(np.array([-1.0, 1.0, 0.5, -0.5, 0.8, -0.8]), SAMPLES)
    alike = samples(LAWS["angle"], white(5))
    apart = replace(alike, residual=alike.residual * (1.0 + 0.5 * own[:, None]))
    stds = [found.std(alike.at) for one in (alike, apart) if (found := learn_torque(one, 1, LEG)) is not None]
    assert len(stds) == 2 and np.median(stds[1]) > 3.0 * np.median(stds[0])


def test_correlation_time_is_that_of_the_process() -> None:
    rng, phi = default_rng(1), 0.8
    x = np.zeros(40_000)
    for k, e in enumerate(rng.normal(size=x.size - 1)):
        x[k + 1] = phi * x[k] + e
    run = np.repeat(np.arange(4), 10_000)
    assert correlation_time(x, run) == approx((1 + phi) / (1 - phi), rel=0.1)
    assert correlation_time(rng.normal(size=x.size), run) == approx(1.0, abs=0.1)


def test_what_acts_in_another_engine_is_found() -> None:
    found = hidden_magnet()
    assert next(iter(where_of(found))) == (2, "angle")
    (one,) = found.torques
    at = found.samples.at
    truth = -np.array([magnet(*q, *v)[1] for q, v in zip(at.q.T, at.v.T)])
    learnt, std = one.law.torque(at), one.std(at)
    assert np.sqrt(np.mean((learnt - truth) ** 2)) < 0.1 * np.std(truth)
    assert np.mean(np.abs(learnt - truth) < 1.96 * std) > 0.9 and np.median(std) < 0.05 * np.std(truth)


def test_it_reduces_the_error_of_runs_that_did_not_teach_it() -> None:
    found = hidden_magnet()
    assert found.holds(0.5) and len(found.table.runs) == 5
    fresh = runs_of(magnet, 2, 1)[0]
    smoothed = [smooth_segments(one, fresh.name, fresh.signals, OPTIONS, 0.0)
                for one in (true_model(), with_torques(true_model(), found.laws))]
    errors = predict_run(smoothed, [0.5])
    before, after = np.sqrt(np.mean((errors.simulated[:, 0, :2] - errors.measured[:2]) ** 2, axis=(1, 2)))
    assert after < 0.5 * before


def test_it_is_not_offered_where_runs_err_more_at_one_horizon() -> None:
    found = hidden_magnet()
    squares = found.table.squares.copy()
    squares[1, :, :, 0] = 1.3 * squares[0, :, :, 0]
    assert found.holds(0.1) and not replace(found, table=replace(found.table, squares=squares)).holds(0.1)


@mark.parametrize("seed", range(3))
def test_a_healthy_leg_has_none(seed: int) -> None:
    found = find_structure(true_model(), runs_of(None, 10 + seed, 4, 3.0), OPTIONS)
    assert found is None or not found.holds(0.1)


def test_one_run_shows_nothing_that_repeats() -> None:
    with raises(FitError, match="one run"):
        find_structure(true_model(), runs_of(None, 1, 1, 2.0), OPTIONS)
