"""Who reads the angle of a pivot that no encoder measures."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from daq import FloatArray
from estimator.diagnosis import error_table
from estimator.diagnosis.conclusion import with_blind_sensors
from estimator.diagnosis.decision_rule import WHOLE_RUNS
from estimator.diagnosis.result import Diagnosis
from estimator.model import leg2

PIVOT = "q1_rad"
SWING = np.sin(np.linspace(0.0, 9.0, 200))
TILTED = {"nominal": 0.0, "bias": 0.0, "offset": 0.01}
"""By which each model takes the pivot's angle for another than it is [rad]; its own simulation goes there. It is ..."""
MISFIT = {"nominal": 500.0, "bias": 300.0, "offset": 350.0}
SHAPE = np.sqrt(2.0) * np.cos(2.0 * np.pi * np.arange(SWING.size) / SWING.size)
"""... times this, of mean 0 and rms 1; and ..."""
ZERO = 3e-3
"""... by this all the time, which is the zero of an IMU and no error."""


def test_the_model_under_which_the_runs_are_likeliest_reads_the_pivots_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    """The vertical was 1.4 mrad off in the accelerometer, among ten small faults. A torque at the pivot, whose noise
    came out lowest, was the unit of all errors, and what it read as well: every other model seemed to err by what the
    two differ in, and the torque was named."""
    def pivot(model: Any) -> FloatArray:
        return SWING + TILTED[model.name] * SHAPE

    def smooth(model: Any, run: int) -> Any:
        return SimpleNamespace(model=model, problem=None, misfit=lambda noise: MISFIT[model.name],
                               state=SimpleNamespace(x=SimpleNamespace(q=pivot(model)[:, None])))

    def predict_run(fitted: Any, *_: object, misfits: bool) -> Any:
        return SimpleNamespace(channels=(PIVOT,), rate_hz=100.0, measured=np.full((1, 200), np.nan),
                               simulated=np.stack([[[pivot(f.model) + 1e-4 * SHAPE + ZERO]] for f in fitted]))

    split = SimpleNamespace(confirm=(0,), workers=1, stiction={}, has_imu=True)
    problem = SimpleNamespace(mechanism=leg2(), n=2, imu_count=1, has_encoder=np.array([False, True]))
    monkeypatch.setattr(error_table, "DECIDING_S", (np.inf,))
    monkeypatch.setattr(error_table, "smooth", smooth)
    monkeypatch.setattr(error_table, "predict_run", predict_run)
    monkeypatch.setattr(error_table, "sensors_of", lambda model: (PIVOT,))
    monkeypatch.setattr(error_table, "floor_of", lambda *_: np.full((1, 1, 200), 1e-8))
    monkeypatch.setattr(error_table, "white_noise", lambda _: None)
    models = cast(Any, [SimpleNamespace(name=name, split=split, state=SimpleNamespace(noise=None), problem=problem)
                        for name in TILTED])
    seeds = np.zeros(1, dtype=np.int64)

    table = error_table.measure_errors(models, models[2], seeds)
    assert table.unit.smoother is models[1]
    assert [table.error(k) for k in range(3)] == pytest.approx([1.0, 1.0, 101.0], rel=1e-3)
    told = error_table.measure_errors(models, models[2], seeds, [2])  # who may not read does not
    assert [told.error(k) for k in range(3)] == pytest.approx([99.0, 99.0, 1.0], rel=1e-3)


def test_noise_leaves_no_more_than_a_model_of_the_same_runs_errs() -> None:
    """On the demo's leg the floor of the pivot's angle was four times the extended model's error."""
    squares = np.array([[[9.0, 4.0], [9.0, 4.0]], [[1.0, 4.0], [3.0, 4.0]], [[np.nan, 8.0], [1.0, 8.0]]])
    assert error_table._least(np.array([5.0, 1.0]), squares).tolist() == [2.0, 1.0]


def test_the_floor_of_whole_runs_is_a_mean_of_replicates(monkeypatch: pytest.MonkeyPatch) -> None:
    """A leg that sticks left 1.0 to 8.5 floors by the one replicate that was drawn."""
    drawn: list[list[float]] = []

    def floor_errors(one: Any, rng: Any, horizons_s: list[float], *rest: Any) -> FloatArray:
        drawn.append(list(horizons_s))
        return np.full((len(horizons_s), 1, 4), float(len(drawn)))

    monkeypatch.setattr(error_table, "floor_errors", floor_errors)
    monkeypatch.setattr(error_table, "sensors_of", lambda model: ("q2_rad",))
    monkeypatch.setattr(error_table, "channel_names", lambda problem: ["q2_rad"])
    problem = SimpleNamespace(n=2, has_encoder=np.array([False, True]), stage=SimpleNamespace(angle_range=None))
    model: Any = SimpleNamespace(split=SimpleNamespace(has_imu=False), problem=problem, effects=())
    squares = error_table.floor_of(model, 0, cast(Any, SimpleNamespace(problem=problem)), 0, (0.1, np.inf),
                                   cast(Any, None))
    every = np.arange(1.0, WHOLE_RUNS + 1.0)
    assert squares[:, 0, 0] == pytest.approx([1.0, np.mean(every**2)]) and drawn[1:] == [[np.inf]] * (WHOLE_RUNS - 1)


def test_none_is_no_promise_where_noise_moves_free_runs_as_far_as_the_motion() -> None:
    """A cart without a spring drifts by its torque's noise alone: nothing was found where free runs erred -553 %."""
    columns = (("q1_m", 0.1), ("q1_m", 1.0), ("q1_m", np.inf), ("gyro_radps", np.inf))
    unit = SimpleNamespace(floor=np.array([0.1, 0.6, 4.0, 0.4]), bound=np.ones(4))
    table = cast(Any, SimpleNamespace(columns=columns, unit=unit))
    warned = with_blind_sensors(Diagnosis("none", "", warnings=("first",)), table).warnings
    assert warned[0] == "first" and len(warned) == 2
    assert "60 % of the variance of q1_m in free runs over 1 s" in warned[1]
    unit.floor[:] = [0.1, 0.2, 0.9, 0.4]
    assert "90 % of the variance of q1_m in free runs over whole runs" in with_blind_sensors(
        Diagnosis("none", ""), table).warnings[0]
    assert with_blind_sensors(Diagnosis("none", ""), None).warnings == ()
