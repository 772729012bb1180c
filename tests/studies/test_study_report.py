"""What the study says about itself: demands, reasons, likelihood ratios, and its pages."""

from dataclasses import replace

import numpy as np
import pytest

from estimator.fitting import fit_each, known_noise
from estimator.fitting.profile_likelihood import search
from estimator.likelihood import BatchProblem, Records
from estimator.signals import split_signals
from studies.biped3 import CASES, FLOOR, make_table
from studies.biped3.claims import claims, in_words
from studies.biped3.likelihood import likelihood_ratio, smallest_misfit
from studies.biped3.reasons import reasons
from studies.biped3.study import (
    PAPERS_MLE,
    Block,
    case_options,
    error_of_differences,
    noise_free_record,
    noisy_record,
    run_block,
    simulation_errors,
    truth,
)
from studies.biped3.table import Table
from studies.walker import CONSTRAINT_TANGENT, after_impact, motor_mechanism, one_step, periodic_rate, walk

STEP = one_step().in_motor_angles()
MECHANISM = motor_mechanism()


@pytest.fixture(scope="module")
def table() -> Table:
    work = [Block(CASES[k], method, 0, 6, 3) for k in (0, 2) for method in ("mle", "wls", "hekf", FLOOR)]
    return make_table({block: run_block(block) for block in work}, 3)


def test_likelihood_ratio_is_that_of_the_search() -> None:
    """Both profile the same likelihood, one from the truth's motion, one from wherever its start led."""
    options = case_options(CASES[3])
    records = [noisy_record(STEP, CASES[3], 9, run) for run in range(8)]
    signals = [split_signals([record], MECHANISM, options)[0] for record in records]
    problem = BatchProblem(MECHANISM, 100.0, "zero", known_noise(MECHANISM, options))
    data = Records(np.stack([s.angles for s in signals]), np.stack([s.torque for s in signals]))
    found = search(problem, data)
    np.testing.assert_allclose(smallest_misfit(problem, data, found.beta, STEP), found.objective, rtol=1e-6)
    ratio = likelihood_ratio(records, options, found.beta, truth(), STEP)
    assert np.all(ratio > 0.0)
    assert 3.0 < ratio.mean() < 16.0
    missing = found.beta.copy()
    missing[2] = np.nan
    np.testing.assert_array_equal(np.isnan(likelihood_ratio(records, options, missing, truth(), STEP)),
                                  np.arange(8) == 2)


def test_the_papers_mle_is_another_method() -> None:
    records = [noisy_record(STEP, CASES[2], 9, run) for run in range(2)]
    options = [case_options(CASES[2], method) for method in ("mle", PAPERS_MLE)]
    beta = [fit_each(records, MECHANISM, option, "mle")[0].beta for option in options]
    error = simulation_errors(STEP, np.array(beta))
    assert error[0] < 0.1 < 0.5 < error[1] < 2.0  # Table III prints 1.195


def test_differences_without_noise_leave_what_the_reasons_say() -> None:
    assert error_of_differences(CASES[0]) == pytest.approx(1.23, abs=0.02)
    smooth = walk(after_impact(periodic_rate())[0], 1.2 * CONSTRAINT_TANGENT, len(STEP.time_s)).in_motor_angles()
    for case in CASES[:4]:
        beta = fit_each([noise_free_record(smooth)], MECHANISM, case_options(case), "wls")[0].beta
        assert simulation_errors(smooth, beta[None])[0] < 0.1


@pytest.mark.parametrize("case", [CASES[1], CASES[2]])
def test_no_regularisation_of_rls_comes_near_mle(case) -> None:
    records = [noisy_record(STEP, case, 9, run) for run in range(10)]
    options = case_options(case)
    mle = simulation_errors(STEP, np.array([f.beta for f in fit_each(records, MECHANISM, options, "mle")]))
    for level in (1e-3, 0.03, 0.3, 1.0, 10.0):
        other = replace(options, noise={**options.noise, "passive_nm": level})
        rls = simulation_errors(STEP, np.array([f.beta for f in fit_each(records, MECHANISM, other, "rls")]))
        assert np.nanmedian(rls) > 20.0 * mle.mean()


def test_claims_are_met_or_not_by_the_numbers(table: Table) -> None:
    demands = " ".join(claim.demand for claim in claims(table))
    assert all(words in demands for words in ("lowest mean error", "no failed simulation", "floor", "bound", "95 %"))
    failing = [replace(cell, failed=1) if cell.method == "mle" and cell.case == 3 else cell for cell in table.cells]
    worse = claims(replace(table, cells=tuple(failing)))
    assert [c.measured for c in worse if "no failed" in c.demand] == ["1 of 12"]
    assert not any(c.met for c in worse if "no failed" in c.demand)
    high = [replace(cell, mean=1.0) if cell.method == "mle" else cell for cell in table.cells]
    after = claims(replace(table, cells=tuple(high)))
    assert not any(c.met for c in after if "lowest" in c.demand or "floor" in c.demand)


def test_reasons_follow_the_study(table: Table) -> None:
    text = " ".join(reasons(table))
    assert "1.23, 207 rad² in cases 1 and 3" in text
    assert "Case 5" not in text
    assert [in_words(cases) for cases in ([1, 2, 3], [1, 3], [5])] == ["cases 1 to 3", "cases 1 and 3", "case 5"]
