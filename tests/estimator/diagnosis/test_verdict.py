"""The rule of a verdict: what matters is what changes the simulation's error on runs that chose nothing."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimator.diagnosis import procedure
from estimator.diagnosis.context import DiagnosisContext, Explanation
from estimator.diagnosis.decision_rule import MATERIAL
from estimator.diagnosis.error_budget import ErrorTable, budget
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.score_statistics import Tests
from estimator.diagnosis.verdict import choose, matters, shortfall
from estimator.errors import FitError

BLOCKS, RUNS = 20, 2
NOTHING_LEFT = Tests(np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0), np.zeros((0, 0)), np.ones(1), 1.0, np.zeros(0))


def table_of(*errors: float, agreement: list[list[float]] | None = None, seed: int = 0) -> ErrorTable:
    """Models whose rms errors are `errors` in units of noise alone, scattered from block to block as real ones are."""
    common = np.random.default_rng(seed).gamma(4.0, 0.25, (1, BLOCKS, 3))
    common /= common.mean()
    values = np.array(errors)[:, None, None] ** 2 * common
    told = np.array(agreement if agreement is not None else [[10.0 * k] * RUNS for k in range(len(errors))])
    return ErrorTable((("q1_rad", 1.0), ("q2_rad", 1.0), ("q2_rad", np.inf)), values, told, cast(Any, None),
                      np.zeros(RUNS, dtype=np.int64))


@dataclass(frozen=True)
class Fitted:
    """As much of a model as the choice looks at."""

    effects: tuple[str, ...]


def explained(gain: float, *effects: str) -> Explanation:
    return Explanation(cast(Any, Fitted(tuple(cast(Any, Named(e)) for e in effects))), gain, NOTHING_LEFT, -1, -1,
                       True, no_residual_effect=True, by_run=np.full(6, gain / 6))


@dataclass(frozen=True)
class Named:
    key: str
    equivalence_class: str = ""
    distinguishing_size: int | None = None


@pytest.mark.parametrize("errors, agreement, is_material", [
    ((3.0, 1.2), [[0, 0], [900, 800]], True),
    ((3.0, 2.9), [[0, 0], [900, 800]], False),  # beyond doubt by the likelihood, and of no consequence
    ((3.0, 1.2), [[0, 0], [900, -20]], False),  # it does not replicate on the second run
    ((3.0, 3.4), [[0, 0], [900, 800]], False),  # it makes the free run worse
    ((1.02, 1.0), [[0, 0], [40, 50]], False)])
def test_a_cause_matters_where_the_error_falls_and_every_run_agrees(
        errors: tuple[float, ...], agreement: list[list[float]], is_material: bool) -> None:
    table = table_of(*errors, agreement=agreement)
    draws = table.draws(np.random.default_rng(1))
    assert matters(table, 1, 0, MATERIAL * table.error(0), draws) is is_material


def test_an_error_that_falls_on_one_run_alone_is_not_said_to_stay() -> None:
    """A wrong gyro scale took the error from 23.5 to 0.8, and was said to leave it as it was."""
    for after, words in ((0.8, "errs less, but not surely"), (23.0, "errs as much as before")):
        table = table_of(23.5, after, agreement=[[0, 0], [900, -20]])
        assert words in shortfall(table, 1, MATERIAL * table.error(0))


def test_a_second_law_that_takes_up_a_difference_of_form_is_not_named() -> None:
    single, pair = explained(10_000.0, "load"), explained(10_400.0, "load", "play")
    table = table_of(7.1, 1.62, 1.45)
    best, row = choose([(single, 1), (pair, 2)], table, MATERIAL * table.error(0))
    assert best == [single] and row == 1


def test_a_second_cause_that_makes_its_share_of_the_error_is_kept() -> None:
    single, pair = explained(10_000.0, "load"), explained(13_000.0, "load", "skew")
    table = table_of(5.0, 3.0, 1.1)
    best, row = choose([(single, 1), (pair, 2)], table, MATERIAL * table.error(0))
    assert best == [pair] and row == 2


def test_shares_of_the_budget_add_up() -> None:
    table = table_of(5.0, 1.5, 3.0, 4.0)  # nominal, both causes, less the first, less the second

    @dataclass(frozen=True)
    class Cause:
        name: str
        joint: int | None

    model = cast(Any, type("M", (), {"named": (Cause("torque_delay", None), Cause("backlash", 1))}))
    rows = budget(table, 1, (2, 3), model, table.draws(np.random.default_rng(2)))
    assert [(r.what, r.effect, r.joint) for r in rows] == [
        ("nominal", None, None), ("cause", "torque_delay", None), ("cause", "backlash", 2), ("remainder", None, None),
        ("noise", None, None)]
    share = {r.what + (r.effect or ""): r.share for r in rows}
    assert share["nominal"] == 1.0
    assert share["causetorque_delay"] + share["causebacklash"] + share["remainder"] == pytest.approx(1.0)
    assert share["remainder"] == pytest.approx((1.5**2 - 1.0) / (5.0**2 - 1.0))
    # without the first 9 - 2.25 of error come back, without the second 16 - 2.25
    assert share["causebacklash"] / share["causetorque_delay"] == pytest.approx((16 - 2.25) / (9 - 2.25))
    assert share["noise"] == pytest.approx(1.0 / 24.0)
    assert all(r.ci95[0] <= r.share + 1e-9 and r.share <= r.ci95[1] + 1e-9 for r in rows)


def test_no_budget_is_made_of_noise() -> None:
    table = table_of(0.98, 0.97)
    assert budget(table, 1, (), None, table.draws(np.random.default_rng(0))) == ()


def test_a_leg_that_no_model_simulates_is_unexplained_and_not_undiagnosed(monkeypatch: pytest.MonkeyPatch) -> None:
    def diverge(*_: object) -> None:
        raise FitError("the free run diverges")

    monkeypatch.setattr(procedure, "decide", diverge)
    context = cast(DiagnosisContext, SimpleNamespace(split=None, nominal=None))
    found = procedure.conclude(context, Diagnosis("none", ""), cast(Tests, None), [], np.random.default_rng(0))
    assert found.verdict == "unexplained" and "the free run diverges" in found.sentence and not found.causes
