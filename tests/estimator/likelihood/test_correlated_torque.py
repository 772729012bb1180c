"""Torque samples with a full covariance: objective and its derivatives against sums written out."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark

from estimator import Effect
from estimator.effects import classes
from estimator.likelihood import LatentProblem, Latents, Noise, Stage
from estimator.likelihood.correlated_torque import whole_samples
from estimator.model import leg2
from estimator.signals import SignalSet

COUNT = 30
BETA = np.array([0.14, 0.03, 0.05, 0.5, 0.15, 0.02, 0.03, 0.03, 0.06])
CORRELATION = np.array([[1.0, -0.7], [-0.7, 1.0]])
NAMED = {kind.name: kind for kind in classes()}


def posed(*effects: Effect) -> tuple[LatentProblem, Latents, np.ndarray, Noise]:
    rng = np.random.default_rng(6)
    q, torque = rng.normal(size=(2, COUNT, 2))
    signals = SignalSet("run", 100.0, np.arange(COUNT) / 100.0, q, torque, {})
    problem = LatentProblem([signals], leg2(actuated=(0, 1)), "linear",
                              Stage((0,), (0.0,), (0.0,), np.tile([-2.0, 2.0], (2, 1)), 7.0), effects)
    problem.known_stiction = rng.uniform(0.0, 0.01, (COUNT, 2, 2))
    x = Latents(q + 0.01 * rng.normal(size=q.shape), rng.normal(size=q.shape), torque + 0.1 * rng.normal(size=q.shape))
    sizes = [v for e in effects for v in [s.scale for s in e.sizes] + [s.grid[-1] for s in e.shapes]]
    noise = Noise(np.array([0.05, 0.02]), np.full(2, 1e-3), torque_correlation=CORRELATION)
    return problem, x, np.append(BETA, sizes), noise


def test_the_objective_has_the_inverse_of_the_whole_covariance() -> None:
    problem, x, beta, noise = posed()
    assert problem.known_stiction is not None
    expected = 0.0
    for k, r in enumerate(x.u - problem.torque):
        sigma = np.array([[0.05**2, -0.7 * 0.05 * 0.02], [-0.7 * 0.05 * 0.02, 0.02**2]])
        alone = sigma * np.eye(2) + np.diag(problem.known_stiction[k, 0])
        sigma += np.diag(problem.known_stiction[k, 0])
        expected += r @ np.linalg.solve(sigma, r) - r @ np.linalg.solve(alone, r)
    independent = replace(noise, torque_correlation=None)
    found, before = (problem.linearise(x, beta, n).objective for n in (noise, independent))
    assert found - before == approx(expected, rel=1e-4)  # of a sum of 1e10, the motion being random


def test_no_correlation_declared_as_such_changes_nothing() -> None:
    problem, x, beta, noise = posed(NAMED["torque_offset"](None), NAMED["joint_elasticity"](1))
    one, other = (problem.linearise(x, beta, replace(noise, torque_correlation=c)) for c in (np.eye(2), None))
    assert one.objective == approx(other.objective, rel=1e-12)
    for name in ("corner", "gradient_beta"):
        assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-9)
    assert_allclose(one.chain.rows, other.chain.rows, rtol=1e-9, atol=1e-6)


@mark.parametrize("name, joint, h", [("torque_offset", None, 0.1), ("torque_saturation", None, 1e-3)])
def test_derivatives_by_torque_and_sizes_are_those_of_the_objective(name: str, joint: int | None, h: float) -> None:
    problem, x, beta, noise = posed(NAMED[name](joint))
    point, n = problem.linearise(x, beta, noise), 2

    def objective(u: np.ndarray, sizes: np.ndarray) -> float:
        return problem.linearise(replace(x, u=u), sizes, noise).objective

    for k, j in ((0, 0), (7, 1), (COUNT - 1, 0)):
        up, down = x.u.copy(), x.u.copy()
        up[k, j] += h
        down[k, j] -= h
        slope = (objective(up, beta) - objective(down, beta)) / (4.0 * h)
        assert point.chain.right[k, 2 * n + j, 0] == approx(slope, rel=1e-3)
    step = np.zeros_like(beta)
    step[-1] = h
    slope = (objective(x.u, beta + step) - objective(x.u, beta - step)) / (4.0 * h)
    assert point.gradient_beta[-1] == approx(slope, rel=1e-3)


def test_samples_count_where_no_driven_joint_rests() -> None:
    share = np.array([[0.99, 1.0, 0.3], [0.5, 1.0, 0.3], [1.0, 1.0, 0.3]])
    assert whole_samples(share, (0, 1)) == approx(np.array([[1, 1, 0.3], [0, 0, 0.3], [1, 1, 0.3]]))
    assert whole_samples(0.5 * share, (0, 1)) == approx(0.5 * share)
