"""A fit does not hang on what means nothing: the last digits of readings, the order of
files, when a clock began, the noise levels with which its search begins."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from daq import Dataset, FloatArray, Rig, load_rig
from daq.runs import read_run
from daq.timing import recorded_rig
from estimator.fitting import motion_search, start_state
from estimator.likelihood import State
from experiments.judge import fit_trust
from experiments.session import load_runs
from experiments.workflows import Fitted, fit_runs
from tests.support.paths import FIXTURES, REAL, needs_records

LEAST_MOVE = 0.1
"""Share of a 95 % interval by which no value may move."""
RECORDINGS = ("healthy", "noisy", "gap", "saturated-gyro", "pulled-cable", "clock-reset")
RECORDS = {"dfki_c0": ("00", "01", "02"), "dfki_a0": ("00", "01", "02"), "emps": ("estimation",),
           "multiarm": ("free_swing",)}
Runs = Sequence[Dataset]
Change = Callable[[Runs, np.random.Generator], Runs]


def resolution(values: FloatArray) -> float:
    """Smallest step between the values of a column."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(np.min(steps[steps > 1e-9 * np.ptp(values)], initial=np.inf)) if steps.size else 0.0


def in_the_last_digit(runs: Runs, rng: np.random.Generator) -> Runs:
    def moved(values: FloatArray) -> FloatArray:
        step = resolution(values)
        return values + rng.uniform(-0.01, 0.01, len(values)) * (step if np.isfinite(step) else 0.0)

    return [replace(run, columns={name: moved(values) for name, values in run.columns.items()}) for run in runs]


def in_another_order(runs: Runs, rng: np.random.Generator) -> Runs:
    return [runs[k] for k in rng.permutation(len(runs))]


def at_another_time(runs: Runs, rng: np.random.Generator) -> Runs:
    return [replace(run, time_s=run.time_s + rng.uniform(0.0, 1e4)) for run in runs]


def hardly_moves(runs: Runs, rig: Rig, change: Change, fixed: dict[str, float] | None = None,
                 base: Fitted | None = None) -> None:
    """By two changes; `base` is the fit of `runs` as they are, made here if not given."""
    rng, base = np.random.default_rng(1), base or fit_runs(runs, rig, fixed=fixed)
    for _ in range(2):
        found = fit_runs(change(runs, rng), rig, fixed=fixed)
        assert found.result.method == base.result.method
        assert found.result.mechanism.names == base.result.mechanism.names
        assert moved(found, base) < LEAST_MOVE


def moved(found: Fitted, base: Fitted) -> float:
    """Largest change of a value as a share of its interval, the wider of both fits; open ones left out.

    That of a value at its bound begins there. A value that is given has none, and must not move at all.
    """
    width = np.maximum(*(np.diff(fit.result.ci95())[:, 0] for fit in (found, base)))
    change = np.abs(found.result.beta - base.result.beta)
    shares = np.divide(change, width, out=np.where(change > 0.0, np.inf, 0.0), where=width > 0.0)
    return float(np.max(np.where(np.isfinite(width), shares, 0.0)))


@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.parametrize("change", [in_the_last_digit, at_another_time])
def test_a_recording_of_the_emulated_leg_is_fitted_alike(name: str, change: Change) -> None:
    runs, rig, base = recording(name)
    hardly_moves(runs, rig, change, base=base)


@cache
def recording(name: str) -> tuple[Runs, Rig, Fitted]:
    """A recording with its rig and its fit."""
    path = FIXTURES / f"{name}.mcap"
    rig = recorded_rig(read_run(path))
    runs = load_runs([path], rig, True)
    return runs, rig, fit_runs(runs, rig)


def test_recordings_of_the_emulated_leg_are_fitted_alike_in_any_order() -> None:
    rig = load_rig(FIXTURES / "rig.toml")
    hardly_moves(load_runs([FIXTURES / f"{name}.mcap" for name in ("healthy", "noisy", "gap")], rig, True), rig,
                 in_another_order)


@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_noise_levels_at_the_start_of_a_fit_hardly_move_it(name: str, factor: float,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    (runs, rig, base), starts = recording(name), list[State]()

    def started(*arguments: Any) -> State:
        state = start_state(*arguments)
        n = state.noise
        state.noise = replace(n, torque=factor * n.torque, encoder=factor * n.encoder, gyro=factor * n.gyro,
                              accel=factor * n.accel)
        starts.append(state)
        return state

    monkeypatch.setattr(motion_search, "start_state", started)
    found = fit_runs(runs, rig)
    assert starts
    assert moved(found, base) < LEAST_MOVE
    said, before = (re.sub(r"[\d.]+ %", "%", fit_trust(one.result).sentence) for one in (found, base))
    assert said == before  # but for the budget's last digit


@needs_records
@pytest.mark.parametrize("name, change", [
    *(pytest.param(name, change, marks=pytest.mark.slow if name in ("emps", "multiarm") else pytest.mark.study)
      for name in RECORDS for change in (in_the_last_digit, at_another_time)),
    pytest.param("dfki_c0", in_another_order, marks=pytest.mark.slow),
    pytest.param("dfki_a0", in_another_order, marks=pytest.mark.study)])
def test_a_real_record_is_fitted_alike(name: str, change: Change) -> None:
    rig = load_rig(REAL / name / "rig.toml")
    runs = load_runs([REAL / name / f"{run}.csv.gz" for run in RECORDS[name]], rig)
    hardly_moves(runs, rig, change, {"beta5": 1.0} if name == "multiarm" else None)  # which nothing drives
