"""The short-record search: its derivatives, its minimum against general solvers, and its refusals."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from estimator import fit
from estimator.fitting import fit_each, known_noise
from estimator.fitting.profile_likelihood import expected_misfit, search, suits
from estimator.likelihood import BatchProblem, Records, slack_of
from estimator.model import Collocation
from estimator.signals import split_signals
from studies.biped3 import CASES
from studies.biped3.study import case_options, noisy_record, truth
from studies.walker import motor_mechanism, one_step

MECHANISM = motor_mechanism()


def one(case: int, run: int = 0):
    return noisy_record(one_step().in_motor_angles(), CASES[case - 1], 21, run)


def test_only_short_encoder_records_of_known_noise_are_searched() -> None:
    options = case_options(CASES[0])
    signals = split_signals([one(1)], MECHANISM, options)
    assert suits(signals, MECHANISM, options)
    assert not suits(signals * 2, MECHANISM, options)
    unknown = type(options)(sensors="encoder", hold="zero", noise={"torque_nm": 0.3})
    assert not suits(signals, MECHANISM, unknown)


@pytest.mark.parametrize("case", [2, 3])
def test_minimum_agrees_with_a_general_solver(case: int) -> None:
    """scipy's trust-region solver on the same sum of squares, written out plainly, latents and beta together."""
    options = case_options(CASES[case - 1])
    data = one(case)
    options = type(options)(sensors="encoder", hold="zero", noise={**options.noise, "encoder2_rad": 1e-5,
                                                                   "encoder3_rad": 1e-5})
    noise = known_noise(MECHANISM, options)
    signals = split_signals([data], MECHANISM, options)[0]
    found = search(BatchProblem(MECHANISM, 100.0, "zero", noise),
                   Records(signals.angles[None], signals.torque[None]))
    assert np.isfinite(found.objective[0])
    samples, n = signals.angles.shape
    collocation = Collocation(MECHANISM, 0.01, "zero")
    left = np.arange(samples - 1)
    unit = np.abs(truth())

    def residual(w: np.ndarray) -> np.ndarray:
        q, v, u = w[:-8].reshape(3, samples, n)
        beta = w[-8:] * unit
        z = collocation.to_joint(collocation.terms(collocation.motion(q, v, left))[0])
        defect = np.einsum("p,pigk->igk", beta, z) - collocation.torque(u, left)
        return np.concatenate([(defect / (slack_of(MECHANISM) * noise.torque)[:, None, None]).ravel(),
                               ((q - signals.angles) / noise.encoder).ravel(),
                               ((u - signals.torque) / noise.torque).ravel()])

    x = found.x[0]
    start = np.concatenate([x[:, :n].ravel(), x[:, n : 2 * n].ravel(), x[:, 2 * n :].ravel(), found.beta[0] / unit])
    assert residual(start) @ residual(start) == pytest.approx(found.objective[0], rel=1e-9)
    check = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=8)
    assert 2.0 * check.cost <= found.objective[0] + 1e-9
    assert found.objective[0] == pytest.approx(2.0 * check.cost, rel=1e-6)


def test_sum_of_squares_at_the_minimum_is_what_noise_explains() -> None:
    options = case_options(CASES[3])
    noise = known_noise(MECHANISM, options)
    problem = BatchProblem(MECHANISM, 100.0, "zero", noise)
    signals = [split_signals([one(4, run)], MECHANISM, options)[0] for run in range(30)]
    found = search(problem, Records(np.stack([s.angles for s in signals]), np.stack([s.torque for s in signals])))
    mean, spread = expected_misfit(problem, 69)
    assert found.converged.mean() >= 0.95
    assert abs(np.median(found.objective) - mean) < 0.7 * spread
    off = np.abs(found.beta - truth()) / np.sqrt(np.einsum("rii->ri", found.covariance))
    assert 0.85 < np.mean(off < 1.96) < 0.99


def test_together_is_alone() -> None:
    options = case_options(CASES[2])
    records = [one(3, run) for run in range(4)]
    for data, outcome in zip(records, fit_each(records, MECHANISM, options, "mle")):
        np.testing.assert_allclose(outcome.beta, fit([data], MECHANISM, options, "mle").beta, rtol=1e-6)


def test_result_does_not_hinge_on_the_passive_joints_level() -> None:
    options = case_options(CASES[2])
    beta = [fit([one(3)], MECHANISM, type(options)(sensors="encoder", hold="zero",
                                                   noise={**options.noise, "passive_nm": level}), "mle")
            for level in (0.01, 0.03, 0.09)]
    for other in (beta[0], beta[2]):
        assert np.all(np.abs(other.beta - beta[1].beta) < 0.2 * beta[1].std)
