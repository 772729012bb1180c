"""The table of errors: what is read off it by hand, and intervals that hold as often as they say."""

import numpy as np
from pytest import approx, mark

from estimator.free_runs import BLOCK_S, paired_ratio, tabulate
from estimator.free_runs.table import LEAST_ERROR
from estimator.prediction import validations_of
from tests.support.predictions import predicted_run

RATE = 50.0
T = np.arange(601) / RATE
WAVE = {"q1_rad": np.sin(T), "q1d": np.cos(T)}


def test_errors_are_those_of_the_samples() -> None:
    rng = np.random.default_rng(1)
    errors = [{1.0: rng.normal(size=T.size), np.inf: 2.0 * rng.normal(size=T.size)} for _ in range(3)]
    table = tabulate([predicted_run(f"r{k}", RATE, WAVE, e) for k, e in enumerate(errors)])
    assert table.run.tolist() == [k for k in range(3) for _ in range(int(T[-1] // BLOCK_S))]
    for horizon in (1.0, np.inf):
        each = [np.sqrt(np.mean(e[horizon] ** 2)) for e in errors]
        assert [table.rms(0, "q1_rad", horizon, k) for k in range(3)] == approx(each, rel=1e-12)
        assert table.rms(0, "q1_rad", horizon) == approx(np.sqrt(np.mean(np.square(each))), rel=1e-12)
    fit = 100.0 * (1.0 - np.linalg.norm(errors[1][np.inf]) / np.linalg.norm(WAVE["q1_rad"] - WAVE["q1_rad"].mean()))
    assert table.fit_percent(0, "q1_rad", np.inf, 1) == approx(fit, rel=1e-12)
    first = validations_of(table)[0]
    assert first.rmse["q1_rad"] == approx(table.rms(0, "q1_rad", np.inf, 0), rel=1e-12)
    assert first.sums["q1_rad"] == approx(float(np.sum(errors[0][np.inf] ** 2)), rel=1e-12)


def test_what_was_not_read_is_not_compared() -> None:
    part = WAVE["q1_rad"].copy()
    part[: T.size // 2] = np.nan
    error = np.where(np.isnan(part), 100.0, 0.1)
    run = predicted_run("r", RATE, WAVE | {"q1_rad": part}, {np.inf: error})
    run.simulated[0, 0] = np.stack([np.nan_to_num(part), WAVE["q1d"]]) + error
    table = tabulate([run])
    assert table.rms(0, "q1_rad", np.inf) == approx(0.1) and table.samples[:, 0].sum() == T.size - T.size // 2


def test_a_segment_that_diverges_has_no_error() -> None:
    lost = np.where(T < 7.0, 0.1, np.nan)
    table = tabulate([predicted_run("a", RATE, WAVE, {1.0: 0.1, np.inf: lost}),
                      predicted_run("b", RATE, WAVE, {1.0: 0.1, np.inf: 0.1})])
    assert table.rms(0, "q1_rad", np.inf, 0) == np.inf and table.rms(0, "q1_rad", np.inf, 1) == approx(0.1)
    assert table.fit_percent(0, "q1_rad", np.inf, 0) == -np.inf
    assert table.compared(0, 0, "q1_rad", np.inf).ci95 is None and table.lost.tolist() == [[0, 1]]
    seen = validations_of(table)[0]
    assert seen.diverged and seen.horizon_s == approx(7.0) and seen.rmse["q1_rad"] == approx(0.1)
    assert seen.sums["q1_rad"] == np.inf


def test_each_piece_errs_at_most_by_a_sensor_s_variance() -> None:
    piece = np.minimum(np.arange(T.size) // 50, 11)
    error = np.array([0.0, 0.1, 5.0])[np.minimum(piece, 2)]
    table = tabulate([predicted_run(name, RATE, WAVE, {1.0: error}) for name in ("a", "b")], 0, every_horizon=True,
                     each_piece=True)
    assert table.run.tolist() == [0] * 13 + [1] * 13 and table.samples[:12, 0].tolist() == [50.0] * 12
    angle, rate = np.var(WAVE["q1_rad"]), np.var(WAVE["q1d"])
    expected = [LEAST_ERROR, 0.5 * (0.01 / angle + 0.01 / rate), 1.0]
    assert table.by_block(1.0)[0, :3] == approx(expected, rel=1e-9)
    assert table.capped[0, 2, :, 0] == approx([angle, rate], rel=1e-9)


def test_models_of_two_tables_are_joined() -> None:
    a, b = (tabulate([predicted_run("r", RATE, WAVE, {np.inf: error})]) for error in (0.1, 0.3))
    both = a.joined_with(b)
    assert [both.rms(m, "q1_rad", np.inf) for m in (0, 1)] == approx([0.1, 0.3])
    assert both.compared(1, 0, "q1_rad", np.inf).value == approx(3.0)
    assert both.runs[0].trace("q1_rad", 1) == approx(WAVE["q1_rad"] + 0.3)


@mark.parametrize("runs, blocks, common", [(1, 30, 0.0), (8, 10, 0.0), (8, 10, 1.0)])
def test_intervals_of_a_ratio_hold_it_as_often_as_they_say(runs: int, blocks: int, common: float) -> None:
    """Blocks of one run share an error of their own (`common`); the true ratio is 1.3."""
    rng = np.random.default_rng(2)
    run = np.repeat(np.arange(runs), blocks)
    held, trials = 0, 400
    for _ in range(trials):
        size = np.exp(common * rng.normal(size=(2, runs)))[:, run] * rng.gamma(4.0, 0.25, (2, run.size))
        found = paired_ratio(1.3**2 * size[0], size[1], run)
        assert found.ci95 is not None
        held += found.ci95[0] < 1.3 < found.ci95[1]
    assert 0.9 * trials <= held <= 0.985 * trials


def test_few_blocks_have_no_interval() -> None:
    assert paired_ratio(np.ones(4), np.ones(4), np.zeros(4, dtype=np.intp)).ci95 is None
