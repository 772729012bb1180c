"""Every run kept back in its turn, where those that chose nothing leave the answer open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimator.diagnosis import rotation
from estimator.diagnosis.data_split import RunSplit, held_out
from estimator.diagnosis.error_table import ErrorTable, choose_rows
from estimator.diagnosis.rotation import Turn, account, rotate
from estimator.errors import FitError

COLUMNS = (("q2_rad", 1.0), ("q2_rad", np.inf))


@dataclass(frozen=True)
class Split:
    """As much of a split as a rotation looks at."""

    names: tuple[str, ...]
    confirm: tuple[int, ...]
    workers: int = 1

    @property
    def runs(self) -> tuple[str, ...]:
        return self.names


def table_of(*errors: tuple[float, ...]) -> ErrorTable:
    """Models with an rms error for each run, of two blocks."""
    values = np.repeat(np.array(errors)[:, :, None] ** 2, 2, axis=1) * np.ones(len(COLUMNS))
    count = len(errors[0])
    return ErrorTable(COLUMNS, values, np.zeros((len(errors), count)), np.repeat(np.arange(count), 2),
                      cast(Any, tuple(range(len(errors)))),
                      cast(Any, SimpleNamespace(reference=len(errors) - 1, smoother=0, noise=None)))


@pytest.mark.parametrize("count", range(2, 14))
def test_each_run_is_held_out_once_and_never_all(count: int) -> None:
    groups = held_out(count)
    assert sorted(k for g in groups for k in g) == list(range(count))
    assert all(0 < len(g) < count for g in groups) and len(groups) > 1


def test_of_four_neighbours_in_excitation_one_is_in_each_group() -> None:
    assert held_out(8) == [(1, 6), (2, 7), (3, 4), (0, 5)]


def turned(split: Split, table: ErrorTable, monkeypatch: pytest.MonkeyPatch) -> tuple[ErrorTable, tuple[Turn, ...]]:
    def turn(_: object, confirm: tuple[int, ...], models: list[str], unit: int, smoother: int, *__: object) -> Turn:
        assert unit == 1  # what the errors on the runs kept back are counted in
        assert smoother == 0  # who reads the pivot's angle there
        found = table_of(*[tuple(10.0 * (m + 1) + k for k in confirm) for m in range(len(models))])
        return Turn(tuple(split.names[k] for k in confirm), found.values, found.agreement, found.runs,
                    (np.array([0.1 * confirm[0]]),))

    monkeypatch.setattr(rotation, "turn", turn)
    found = rotate(cast(RunSplit, split), choose_rows(table, [0, 2]), np.random.default_rng(0))
    assert found is not None
    return found


def test_errors_of_all_runs_join_those_of_the_held_out_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    split = Split(tuple(f"r{k}" for k in range(8)), (1, 6))
    found, turns = turned(split, table_of((3.0, 4.0), (9.0, 9.0), (1.0, 2.0)), monkeypatch)
    assert found.values.shape == (2, 16, 2) and np.array_equal(found.runs, np.repeat(np.arange(8), 2))
    assert np.sqrt(found.values[1, ::2, 0]).tolist() == [1.0, 2.0, 22.0, 27.0, 23.0, 24.0, 20.0, 25.0]
    assert [t.runs for t in turns] == [("r2", "r7"), ("r3", "r4"), ("r0", "r5")]


def test_sizes_and_falls_are_told_turn_by_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class Size:
        name: str

    class Drag:
        key, sizes = "quadratic_drag@2", (Size("drag"),)

    model = cast(Any, type("M", (), {"effects": (Drag(),), "sizes": lambda self: [np.array([0.03])]})())
    split = Split(tuple(f"r{k}" for k in range(8)), (1, 6))
    table, turns = turned(split, table_of((3.0, 4.0), (9.0, 9.0), (1.0, 2.0)), monkeypatch)
    table = replace(table, models=(table.models[0], model))
    told = account(cast(RunSplit, split), turns, table, 1, 0.1)
    assert [t.falls for t in told] == [True, False, False, False]  # 1 and 2 for 3 and 4; 20 and more for 10 and more
    assert told[0].runs == ("r1", "r6") and told[0].sizes == {"quadratic_drag@2.drag": 0.03}
    assert told[2].sizes == {"quadratic_drag@2.drag": pytest.approx(0.3)}
    assert account(cast(RunSplit, split), (), table, 1, 0.1) == ()


def test_a_turn_that_cannot_be_fitted_leaves_the_answer_to_the_held_out_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise FitError("the nominal fit leads nowhere")

    monkeypatch.setattr(rotation, "turn", fail)
    split = cast(RunSplit, Split(("a", "b", "c", "d"), (1,)))
    assert rotate(split, table_of((3.0,), (1.0,)), np.random.default_rng(0)) is None
