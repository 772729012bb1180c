"""Scores alone are those that come with their information, whatever reads the motion and whatever is fitted."""

from dataclasses import replace

import numpy as np
from pytest import FixtureRequest, approx, fixture, mark

from estimator import FitOptions
from estimator.diagnosis.data_split import RunSplit, split_runs
from estimator.diagnosis.model import Model, nominal_model, refit, run_states
from estimator.effects import battery, classes, library
from estimator.likelihood import Candidate
from estimator.model import leg2
from estimator.score import NO_TESTS, least_sigmas, score_alone, score_at
from tests.support.mujoco_leg import Leg, record

NAMED = {kind.name: kind for kind in classes()}


def fitted(sensors: str) -> tuple[RunSplit, Model]:
    """Three runs of a leg, and what fits them."""
    leg = Leg()
    runs = [record(leg, np.random.default_rng(640 + k), seconds=5.0, name=f"r{k}") for k in range(3)]
    split = split_runs(runs, leg2(lever_arm=leg.lever), FitOptions(sensors=sensors))
    return split, nominal_model(split)


@fixture(scope="module", params=["imu", "encoder"])
def nominal(request: FixtureRequest) -> tuple[RunSplit, Model]:
    return fitted(request.param)


@mark.parametrize("name", ["", "joint_stiffness", "joint_elasticity", "torque_saturation",
                                  "presliding_friction"])
@mark.parametrize("shared", [False, True])
def test_scores_alone_equal_those_with_the_information(nominal: tuple[RunSplit, Model], name: str,
                                                       shared: bool) -> None:
    split, model = nominal
    if name:
        effect = NAMED[name](1 if NAMED[name].per_joint else None)
        size = np.array([s.scale for s in effect.sizes] + [s.grid[0] for s in effect.shapes])
        model = refit(model, [(effect, size)], limit=2)
    state = run_states(model)[0]
    if shared:
        correlation = np.array([[1.0, 0.3], [0.3, 1.0]])
        state = replace(state, noise=replace(state.noise, torque_correlation=correlation, accel_correlation=0.4))
    effects, _ = library(split.mechanism, split.has_imu)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    candidates += [Candidate(e) for e in battery(split.mechanism, split.has_imu)]
    problem = split.problem([split.train[0]], model.problem.stage.angle_range, model.effects, candidates)
    found = score_at(problem, state)
    spread = np.sqrt(np.maximum(np.diag(found.information), 1e-12))
    assert np.max(np.abs(found.score) / spread) > 1.0  # there is something to compare
    np.testing.assert_allclose(score_alone(problem, state) / spread, found.score / spread, atol=1e-7)


@mark.parametrize("tests, sigmas", [(0, 2.58), (1, 2.58), (10, 3.29), (160, 4.0)])
def test_more_tests_ask_for_more_standard_deviations(tests: int, sigmas: float) -> None:
    """Quantiles of the normal distribution at 1 % and at 0.1 % are 2.58 and 3.29."""
    assert least_sigmas(tests) == approx(sigmas, abs=0.01)


def test_what_columns_explain_together_is_a_squared_multiple_correlation() -> None:
    """Three columns of a Gaussian sample, the information of a linear model: closed form by least squares."""
    rng = np.random.default_rng(8)
    x = rng.normal(size=(400, 3))
    y = x[:, 0] - 0.5 * x[:, 1] + rng.normal(size=400)
    columns = np.column_stack([y, x])
    tests = replace(NO_TESTS, information=columns.T @ columns, before=np.sum(columns**2, axis=0))
    left = y - x @ np.linalg.lstsq(x, y)[0]
    assert tests.explained(0, np.array([1, 2, 3])) == approx(1.0 - float(left @ left) / float(y @ y))
    one = float(x[:, 0] @ y) ** 2 / float(x[:, 0] @ x[:, 0]) / float(y @ y)
    assert tests.explained(0, np.array([1])) == approx(one) and one < 0.7
    hidden = replace(tests, information=np.zeros((4, 4)))
    assert hidden.explained(0, np.array([1, 2])) == 0.0
