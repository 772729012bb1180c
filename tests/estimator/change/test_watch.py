"""The sequential test: on white noise as often as allowed, a change soon, a drift of the reference never."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from daq import Dataset
from estimator.change import Watch, start_watch, watch
from estimator.change.contrast import seen
from estimator.change.groups import Group
from estimator.change.structure import find_structure
from estimator.errors import FitError
from estimator.loops import LawSizes
from estimator.score import Score, total
from evidence import watch as study
from evidence.blind.stickslip import MAKERS

COLUMNS, BLOCKS = 8, 4


@dataclass(frozen=True)
class Fit:
    """Stands for the reference model: a run's score is in its column."""


@dataclass(frozen=True)
class Known:
    """What the test reads of a reference."""

    fit: Any
    known: Any
    structure: Any
    law: LawSizes = field(default_factory=LawSizes)


def run(rng: np.random.Generator, moved: dict[int, float]) -> Dataset:
    """20 s whose "columns" are rows of a regression with the given coefficients, and its residual."""
    n = 2000
    rows = rng.normal(size=(n, COLUMNS))
    theta = np.zeros(COLUMNS)
    for k, size in moved.items():
        theta[k] = size
    columns = {f"x{k}": rows[:, k] for k in range(COLUMNS)}
    return Dataset("run", 100.0, np.arange(n) / 100.0, {**columns, "y": rows @ theta + rng.normal(size=n)})


def score_run(fit: Any, data: Dataset) -> Score:
    if not np.isfinite(data["y"]).all():
        raise FitError("cannot follow")
    rows = np.stack([data[f"x{k}"] for k in range(COLUMNS)], axis=-1)
    return Score(rows.T @ data["y"], rows.T @ rows)


def started(monkeypatch: pytest.MonkeyPatch, drift: float, false_alarms: float, seed: int = 3,
            calibrated: bool = True, covered: bool = True) -> tuple[Watch, np.random.Generator]:
    """A test whose reference runs differ in column 5 by as much as `drift`; columns 0 and 1 are parameters. Not
    `covered`: the structure knows nothing of it."""
    rng = np.random.default_rng(seed)
    runs = [run(rng, {5: drift * np.cos(2 * np.pi * k / 8)}) for k in range(8)]
    scores = [score_run(None, one) for one in runs]
    structure = find_structure([scores], 2)
    if not covered:
        structure = replace(structure, own=1e-3, drift=np.zeros(COLUMNS))
    groups = tuple(Group(f"effect{k}", "sensors", None, "", np.eye(COLUMNS)[:, [k]], ("size",), ("1",))
                   for k in range(COLUMNS))
    monkeypatch.setattr(watch, "score_run", score_run)
    monkeypatch.setattr(watch, "groups_of", lambda fit, known: groups)
    reference: Any = Known(Fit(), total(seen(scores, structure)), structure)
    return start_watch(reference, false_alarms, runs if calibrated else ()), rng


def test_white_noise_alarms_less_often_than_allowed_but_not_never(monkeypatch: pytest.MonkeyPatch) -> None:
    test, rng = started(monkeypatch, 0.0, 20.0)
    runs = [test.test(run(rng, {})) for _ in range(540)]  # three hours
    alarms = sum(one.alarm is not None for one in runs)
    assert alarms <= 3 * 20
    assert min(block.per_hour for one in runs for block in one.blocks) < 200.0  # not conservative without bound


@pytest.mark.parametrize("size", [0.25, 0.6])
def test_a_change_is_found_within_a_run_and_dated(size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    test, rng = started(monkeypatch, 0.0, 0.1)
    assert all(test.test(run(rng, {})).alarm is None for _ in range(5))
    alarm = test.test(run(rng, {6: size})).alarm
    assert alarm is not None and alarm.effect == "effect6" and alarm.since_s <= alarm.end_s + 5.0
    assert test.recent == [] or len(test.recent) < BLOCKS


def test_a_drift_that_the_reference_holds_is_no_alarm_however_long(monkeypatch: pytest.MonkeyPatch) -> None:
    test, rng = started(monkeypatch, 0.2, 1.0)
    assert all(test.test(run(rng, {5: 0.2})).alarm is None for _ in range(90))  # half an hour at its edge
    assert test.test(run(rng, {5: 2.0})).alarm is not None
    assert test.test(run(rng, {6: 0.5})).alarm is not None


def test_a_far_drift_of_one_column_covers_no_small_change_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """One variance for all columns did: the change of column 6 is smaller than it."""
    test, rng = started(monkeypatch, 0.5, 0.01)
    assert all(test.test(run(rng, {5: 0.5 * np.sin(k)})).alarm is None for k in range(40))
    alarm = test.test(run(rng, {5: 0.5, 6: 0.3})).alarm
    assert alarm is not None and alarm.effect == "effect6"


def test_shapes_of_one_effect_share_its_false_alarms(monkeypatch: pytest.MonkeyPatch) -> None:
    test, _ = started(monkeypatch, 0.0, 1.0)
    assert set(test._tried) == {COLUMNS}
    shapes = tuple(replace(g, effect="one") if k < 4 else g for k, g in enumerate(test.groups))
    shared = replace(test, groups=shapes)
    assert shared._tried == pytest.approx([20.0] * 4 + [5.0] * 4) and np.sum(1.0 / shared._tried) == pytest.approx(1.0)


@pytest.mark.parametrize(("run", "fault", "size"), [(45, "none", 0.0), (135, "none", 0.0), (300, "torque_delay", 0.5),
                                                    (300, "torque_offset", 0.25)])
def test_a_leg_whose_friction_drifts_alarms_at_a_change_only(run: int, fault: str, size: float) -> None:
    """By another engine: at both ends of the drift, and with 5 ms of delay or 0.015 N m of offset."""
    test = replace(study.reference_of(9)[1], recent=[])
    alarm = test.test(study.spoilt(study.without_pivot(study.record(9, run)), MAKERS[fault][0](size))).alarm
    assert (alarm is None) == (fault == "none")


def test_left_out_reference_runs_widen_what_the_structure_does_not_cover(monkeypatch: pytest.MonkeyPatch) -> None:
    test, _ = started(monkeypatch, 0.2, 1.0)
    assert test.reference.structure.drift[5] > 0.0 and test.scale.max() < 1.5
    test, _ = started(monkeypatch, 0.2, 1.0, covered=False)
    assert (test.scale[:, 5] > 1.5).all() and np.delete(test.scale, 5, axis=1).max() < 1.5
    assert (started(monkeypatch, 0.2, 1.0, calibrated=False, covered=False)[0].scale == 1.0).all()


def test_a_run_that_cannot_be_followed_is_said_to_be_untested(monkeypatch: pytest.MonkeyPatch) -> None:
    test, rng = started(monkeypatch, 0.0, 1.0)
    good = run(rng, {})
    y = good["y"].copy()
    y[1200] = np.nan
    found = test.test(replace(good, columns={**good.columns, "y": y}))
    assert found.failed == "cannot follow" and found.alarm is None and len(found.blocks) == 2
    assert test.test(good).failed == ""
