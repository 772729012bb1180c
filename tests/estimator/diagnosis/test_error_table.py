"""Free-run errors of several models as one error each: the unit, the bound, and who reads an angle without encoder."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from pytest import approx, mark

from daq import FloatArray
from estimator.diagnosis.error_table import ErrorTable, joined, judged, spread_out
from estimator.model import leg2
from estimator.prediction import PredictedRun
from tests.support.stated_tables import RUNS, table_of

PIVOT = "q1_rad"
COUNT = 200
SWING = np.sin(np.linspace(0.0, 9.0, COUNT))
SHAPE = np.sqrt(2.0) * np.cos(2.0 * np.pi * np.arange(COUNT) / COUNT)
"""Of mean 0 and rms 1."""


def predicted(measured: FloatArray, smoothed: list[FloatArray], simulated: list[FloatArray],
              misfits: list[float]) -> PredictedRun:
    """One run of a leg's pivot, whose other channels nobody reads, over its whole length."""
    def only(pivot: list[FloatArray], others: float = 0.0) -> FloatArray:
        return np.stack([np.vstack([y, np.full((6, COUNT), others)]) for y in pivot])

    count = len(smoothed)
    return PredictedRun("r", 100.0, np.arange(COUNT) / 100.0, np.array([COUNT]),
                        (PIVOT, "q2_rad", "q1d", "q2d", "gyro_radps", "accel_x_mps2", "accel_y_mps2"),
                        only([measured], np.nan)[0], only(smoothed), (np.inf,), only(simulated)[:, None],
                        np.zeros((1, COUNT), dtype=np.intp), np.zeros((count, 1), dtype=np.intp), np.array(misfits),
                        np.zeros((COUNT, 2)), np.zeros((count, COUNT, 2)))


def of_pivot(run: PredictedRun, floor: float = 1e-8, smoothers: tuple[int, ...] = (0, 1, 2)) -> ErrorTable:
    unit: Any = SimpleNamespace(split=SimpleNamespace(has_imu=False), problem=SimpleNamespace(
        mechanism=leg2(), n=2, imu_count=0, has_encoder=np.array([True, False])))
    return judged(unit, [run], [np.array([[floor]])], smoothers, np.random.default_rng(0))


@mark.parametrize(("smoothers", "errors"), [((0, 1, 2), (1.0, 1.0, 101.0)), ((2,), (99.0, 99.0, 1.0))])
def test_the_model_under_which_the_runs_are_likeliest_reads_the_pivots_angle(
        smoothers: tuple[int, ...], errors: tuple[float, ...]) -> None:
    """The vertical was 1.4 mrad off in the accelerometer, among ten small faults. A torque at the pivot, whose noise
    came out lowest, was the unit of all errors, and what it read as well: every other model seemed to err by what the
    two differ in, and the torque was named. Each simulation ends 3 mrad off: the zero of an IMU, and no error."""
    tilted = [SWING, SWING, SWING + 0.01 * SHAPE]
    run = predicted(np.full(COUNT, np.nan), tilted, [y + 1e-4 * SHAPE + 3e-3 for y in tilted], [500.0, 300.0, 350.0])
    table = of_pivot(run, smoothers=smoothers)
    assert [table.error(k) for k in range(3)] == approx(errors, rel=1e-3)
    assert table.agreement.tolist() == [[0.0], [200.0], [150.0]]


def test_noise_leaves_no_more_than_a_model_of_the_same_runs_errs() -> None:
    """On the demo's leg the floor of the pivot's angle was four times the extended model's error."""
    run = predicted(SWING, [SWING] * 3, [SWING + 0.3 * SHAPE, SWING + 0.1 * SHAPE, np.full(COUNT, np.nan)], [0.0] * 3)
    for floor, errors in ((0.2, (3.0, 1.0)), (0.01 / 4.0, (6.0, 2.0))):
        table = of_pivot(run, floor)
        assert [table.error(k) for k in (0, 1)] == approx(errors, rel=1e-6)
        assert table.floor == approx([min(floor, 0.01)], rel=1e-6)


def test_no_error_counts_for_more_than_that_of_who_knows_nothing() -> None:
    """A piece that ran 1,439 rad away in a tenth of a second made all of an error."""
    away = [SWING + 0.1 * SHAPE, SWING + np.where(np.arange(COUNT) < 20, 1439.0, 0.0), np.full(COUNT, np.nan)]
    table = of_pivot(predicted(SWING, [SWING] * 3, away, [0.0] * 3), 0.01)
    assert table.bound == approx([np.var(SWING)])
    assert table.error(2) == approx(np.sqrt(np.var(SWING) / 0.01)) and table.error(0) == approx(1.0)
    assert (table.values * table.floor <= table.bound * (1.0 + 1e-12)).all() and table.error(1) <= table.error(2)


def test_errors_of_all_runs_join_those_of_the_first_and_unknown_rows_have_none() -> None:
    first, second = table_of(9.0, 3.0, 2.0), spread_out(table_of(5.0, 1.0), (0, 2), 3)
    assert np.isnan(second.values[1]).all() and second.error(1) == np.inf and second.error(2) == approx(1.0)
    both = joined([first, second], np.random.default_rng(0))
    assert both.values.shape[:2] == (3, 40) and both.agreement.shape == (3, 2 * RUNS)
    assert both.runs.tolist() == [k for k in range(4) for _ in range(10)] and both.draws.max() == 39
    assert both.error(0) == approx(np.sqrt((81.0 + 25.0) / 2.0))
    assert both.error(1) == np.inf and both.error(2) == approx(np.sqrt((4.0 + 1.0) / 2.0))
    assert both.lowers(2, 0, 0.1, 0) == 1.0 and not both.falls(1, 0, 0.1)


def test_a_resampled_table_has_its_blocks_and_their_runs() -> None:
    table = table_of(9.0, 3.0)
    again = table.resampled(7)
    assert np.array_equal(again.runs, table.runs[table.draws[7]])
    assert again.error(0) == approx(table.error(0, table.draws[7]))
    assert again.lowers(1, 0, 0.1, 0) == 1.0 and replace(again, draws=table.draws).error(0) == again.error(0)
