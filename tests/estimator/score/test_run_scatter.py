"""What runs disagree about: statistics held against the textbook's own formulas, and fits of legs that change."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx, fixture
from scipy.special import stdtrit
from scipy.stats import chi2

from daq import Dataset, FloatArray
from estimator import FitOptions, FitResult, fit
from estimator.fitting.mle import fit_mle
from estimator.model import leg2
from estimator.numerics import student_quantile
from estimator.score import ALPHA, RunScores, Score, agreement_of, robust_covariance
from estimator.score.run_scatter import arrays, homogeneity, random_effects
from tests.support.mujoco_leg import Leg, record

SIGMA = 0.5


def regression(rng: Generator, sizes: list[int], scatter: FloatArray, beta: FloatArray
               ) -> tuple[list[FloatArray], list[FloatArray]]:
    """Designs and readings of linear runs of these sizes, each by a beta of its own."""
    designs = [rng.normal(size=(n, beta.size)) for n in sizes]
    return designs, [x @ (beta + scatter * rng.normal(size=beta.size)) + SIGMA * rng.normal(size=len(x))
                     for x in designs]


def scored(designs: list[FloatArray], readings: list[FloatArray]) -> tuple[RunScores, FloatArray, FloatArray]:
    """Scores at least squares, the estimate, its covariance by the noise alone."""
    information = np.array([x.T @ x for x in designs]) / SIGMA**2
    covariance = np.linalg.inv(information.sum(axis=0))
    beta = covariance @ sum(x.T @ y for x, y in zip(designs, readings)) / SIGMA**2
    score = np.array([x.T @ (y - x @ beta) for x, y in zip(designs, readings)]) / SIGMA**2
    return (RunScores(tuple(f"run{k}" for k in range(len(designs))), tuple(map(Score, score, information))), beta,
            covariance)


def test_intervals_are_those_of_cr2_by_residuals() -> None:
    """Bell and McCaffrey's own formulas take the N by N hat matrix; with a scatter as large they decide alone."""
    rng = default_rng(1)
    designs, readings = regression(rng, [8, 12, 20, 9], np.array([3.0, 2.0]), np.array([1.0, -1.0]))
    scores, beta, covariance = scored(designs, readings)
    wide, found = agreement_of(scores, beta, covariance, np.ones(2, dtype=bool))
    inverse = covariance / SIGMA**2
    filled, inner, at = np.zeros((2, 2)), [], np.concatenate([[0], np.cumsum([len(x) for x in designs])])
    everything = np.vstack(designs)
    hat = np.eye(len(everything)) - everything @ inverse @ everything.T
    for k, (x, y) in enumerate(zip(designs, readings)):
        values, vectors = np.linalg.eigh(np.eye(len(x)) - x @ inverse @ x.T)
        a = inverse @ x.T @ (vectors / np.sqrt(values)) @ vectors.T
        filled += np.outer(a @ (y - x @ beta), a @ (y - x @ beta))
        inner.append(a @ hat[at[k]:at[k + 1]])
    freedom = []
    for k in range(2):
        g = np.array([a[k] for a in inner])
        freedom.append(np.trace(g @ g.T) ** 2 / np.sum((g @ g.T) ** 2))
    from scipy.stats import t
    expected = t.ppf(0.975, freedom) * np.sqrt(np.diag(filled))
    assert found.disagree
    assert found.quantile * np.sqrt(np.diag(wide)) == approx(expected, rel=1e-6)


def test_runs_that_agree_cost_nothing_beyond_chance_and_others_are_covered() -> None:
    rng = default_rng(2)
    beta, free = np.array([1.0, 0.3, -0.5]), np.ones(3, dtype=bool)
    told, inside, inside_alone = 0, [], []
    for _ in range(400):
        scores, found, covariance = scored(*regression(rng, [30, 20, 60, 15], np.zeros(3), beta))
        wide, agreement = agreement_of(scores, found, covariance, free)
        told += agreement.disagree
        assert agreement.disagree or wide is covariance
        scores, found, covariance = scored(*regression(rng, [30, 20, 60, 15], np.array([0.0, 0.3, 0.6]), beta))
        wide, agreement = agreement_of(scores, found, covariance, free)
        assert np.linalg.eigvalsh(wide - covariance).min() > -1e-12 * np.trace(wide)
        half = np.sqrt(np.diag(wide)) * (agreement.quantile if agreement.disagree else 1.96)
        inside.append(np.abs(found - beta) < half)
        inside_alone.append(np.abs(found - beta) < 1.96 * np.sqrt(np.diag(covariance)))
    assert told / 400 < 3.0 * ALPHA
    assert np.mean(inside_alone, axis=0)[1:].max() < 0.6
    assert np.mean(inside, axis=0).min() > 0.9


def test_q_has_its_probability() -> None:
    """Of one parameter and equal runs Q is the sum of squares about the mean, and the cube root is close enough."""
    for squares in (1.0, 5.0, 12.0, 40.0):
        step = np.sqrt(squares / 2.0)
        white = np.array([[step], [-step], [0.0], [0.0]]) / 2.0  # each run knows a quarter
        assert homogeneity(white, np.full((4, 1, 1), 0.25)) == approx(chi2.sf(squares, 3), rel=0.2, abs=1e-5)


def test_one_parameter_that_differs_is_not_lost_among_many() -> None:
    """Of twenty parameters the first scatters by two of a run's deviations in five runs: Q alone misses more."""
    rng = default_rng(6)
    beta, scatter = np.zeros(20), np.zeros(20)
    scatter[0] = 0.2
    q, both = 0, 0
    for _ in range(100):
        scores, found, covariance = scored(*regression(rng, [60] * 5, scatter, beta))
        root = np.linalg.cholesky(covariance)
        score, information = arrays(scores.scores)
        q += homogeneity(score @ root, root.T @ information @ root) < ALPHA
        both += agreement_of(scores, found, covariance, np.ones(20, dtype=bool))[1].disagree
    assert both >= 1.2 * q


def test_random_effects_of_balanced_runs_are_the_analysis_of_variance() -> None:
    rng = default_rng(3)
    own = 2.0 + 0.7 * rng.normal(size=9)
    information = np.full((9, 1, 1), 25.0)
    beta = own.mean()
    effects = random_effects(25.0 * (own - beta)[:, None], information)
    between = np.sqrt(own.var(ddof=1) - 1.0 / 25.0)
    assert effects.mean[0] == approx(0.0, abs=1e-9)
    assert effects.scatter[0] == approx(between, rel=0.02)
    shrunk = between**2 / (between**2 + 1.0 / 25.0)
    assert effects.by_run[:, 0] == approx(shrunk * (own - beta), rel=0.02, abs=1e-9)


def test_what_one_run_alone_knows_has_no_second_witness() -> None:
    """Its interval stays that of the noise, whatever runs disagree about besides."""
    rng = default_rng(4)
    designs, readings = regression(rng, [40, 40, 40], np.array([2.0, 0.0]), np.array([1.0, 1.0]))
    for k in (1, 2):
        readings[k] -= designs[k][:, 1]
        designs[k][:, 1] = 0.0
    scores, beta, covariance = scored(designs, readings)
    wide, found = agreement_of(scores, beta, covariance, np.ones(2, dtype=bool))
    assert found.disagree
    ratio = found.quantile * np.sqrt(np.diag(wide)) / (1.96 * found.own_std)
    assert ratio[0] > 5.0
    assert np.isfinite(wide).all()
    assert found.seen.tolist() == [True, False]


def test_one_run_cannot_tell_and_parameters_that_are_given_stay_out() -> None:
    rng = default_rng(5)
    designs, readings = regression(rng, [40, 30, 20], np.array([2.0, 2.0]), np.array([1.0, 1.0]))
    scores, beta, covariance = scored(designs, readings)
    one = RunScores(scores.runs[:1], scores.scores[:1])
    assert agreement_of(one, beta, covariance, np.ones(2, dtype=bool))[1].p_value is None
    covariance[:, 1] = covariance[1] = 0.0
    wide, found = agreement_of(scores, beta, covariance, np.array([True, False]))
    assert found.disagree and wide[1, 1] == 0.0 and not found.seen[1]


@fixture(scope="module")
def changing() -> tuple[Leg, list[Dataset]]:
    """A leg whose knee is stiffer with grease in one run of three; the middle run has a gap."""
    rng = default_rng(610)
    runs = [record(replace(Leg(), coulomb=(0.03, level)), rng, seconds=8.0, name=f"run{k}.csv")
            for k, level in enumerate((0.05, 0.05, 0.08))]
    torn = runs[1]["tau2_nm"].copy()
    torn[400:410] = np.nan
    runs[1] = replace(runs[1], columns={**runs[1].columns, "tau2_nm": torn})
    return Leg(), runs


def fitted(runs: list[Dataset], **more: object) -> FitResult:
    return fit(runs, leg2(lever_arm=0.2), FitOptions(hold="smooth", **more))  # type: ignore[arg-type]


def test_a_leg_whose_friction_changes_is_found_out_and_another_is_not(changing: tuple[Leg, list[Dataset]]) -> None:
    leg, runs = changing
    found = fitted(runs).agreement
    assert found.disagree and found.runs == ("run0.csv", "run1.csv", "run2.csv")
    assert found.seen[8] and found.by_run[:, 8] == approx([0.05, 0.05, 0.08], abs=0.004)
    assert not found.seen[:5].any()
    rng = default_rng(611)
    same = fitted([record(leg, rng, seconds=8.0, name=f"run{k}.csv") for k in range(3)])
    assert not same.agreement.disagree
    assert same.agreement.p_value is not None and same.agreement.p_value > ALPHA
    assert same.ci95() == approx(same.beta[:, None] + 1.959964 * np.outer(same.std, [-1.0, 1.0]))


def test_intervals_of_a_fit_widen_and_hold_the_mean(changing: tuple[Leg, list[Dataset]]) -> None:
    leg, runs = changing
    found = fitted(runs)
    low, high = found.ci95().T
    assert low[8] < 0.06 < high[8] and found.widening[8] > 3.0 and (found.widening >= 1.0).all()
    assert found.std[8] > found.own_std[8]
    low, high = found.beta - 1.96 * found.own_std, found.beta + 1.96 * found.own_std
    assert not low[8] < leg.beta()[8] < high[8]  # by the noise alone it is sure, and wrong of two runs of three


def test_a_skew_between_clocks_is_no_disagreement() -> None:
    """The IMU is late alike in all runs, within what the clocks may be off: the runs agree about that, too."""
    rng = default_rng(612)
    runs = []
    for k in range(3):
        run = record(Leg(), rng, seconds=8.0, name=f"run{k}.csv")
        late = {c: np.interp(run.time_s - 2e-3, run.time_s, run[c]) for c in ("gyro_radps", "accel_x_mps2",
                                                                             "accel_y_mps2")}
        runs.append(replace(run, columns={**run.columns, **late}, clock_bound_s=5e-3))
    found = fit_mle(runs, leg2(lever_arm=0.2), FitOptions(hold="smooth"))
    assert any("late against the controller" in text for text in found.assumptions)
    assert not found.agreement.disagree


def test_clusters_of_scores_give_the_variance_of_their_sum_and_none_to_what_they_do_not_show() -> None:
    """Least squares with 40 clusters of equal errors within each: the variance is that of 40 errors, not of 400."""
    rng, known = default_rng(4), []
    for _ in range(300):
        x = np.repeat(rng.normal(size=(40, 1)), 10, axis=1)
        error = np.repeat(rng.normal(size=(40, 1)), 10, axis=1)
        slope = np.sum(x * error) / np.sum(x * x)
        score = np.stack([np.sum(x * (error - slope * x), axis=1), np.zeros(40)], axis=1)
        information = np.zeros((40, 2, 2))
        information[:, 0, 0] = np.sum(x * x, axis=1)
        covariance, quantile = robust_covariance(score, information)
        assert covariance[1, 1] > 1e50
        known.append(abs(slope) < quantile[0] * np.sqrt(covariance[0, 0]))
    assert 0.91 < np.mean(known) < 0.98


def test_students_quantile_is_that_of_scipy() -> None:
    freedom = np.array([1.0, 1.4, 2.0, 2.7, 3.0, 4.2, 7.0, 12.5, 30.0, 1000.0])
    np.testing.assert_allclose([student_quantile(nu) for nu in freedom], stdtrit(freedom, 0.975), rtol=1e-4)
