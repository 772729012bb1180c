"""A run that no fit can use is set aside by name, with the reason, and the rest goes on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.dataset import Dataset
from daq.runs import RawTable
from daq.timing.resample import align_table
from estimator.model.mechanism import leg2
from estimator.options import FitOptions
from experiments.session.usable import usable_runs
from tests.support.prescribed import ARM_RIG, BETA, arm_run, negated, written
from tests.support.shell import Shell, document

GOOD = [arm_run(k, seconds=6.0) for k in range(4)]


def with_column(run: Dataset, name: str, values: np.ndarray) -> Dataset:
    return replace(run, columns={**run.columns, name: values})


def locked(run: Dataset) -> Dataset:
    return with_column(run, "q2_rad", np.full(len(run), 0.3))


def torn(run: Dataset) -> Dataset:
    return with_column(run, "q1_rad", np.where(np.arange(len(run)) % 15 == 0, np.nan, run["q1_rad"]))


def stuck(run: Dataset) -> Dataset:
    return with_column(run, "tau1_nm", np.full(len(run), 0.7))


def stranger(run: Dataset) -> Dataset:
    return arm_run(99, seconds=6.0, beta=BETA * np.array([1, 8, 1, 0.1, 5, 1, 1, 1, 1]))


@pytest.mark.parametrize("spoil, why", [
    (locked, "joint 2 never moves"), (torn, "no segment of 20 samples"), (stuck, "tau1_nm never changes"),
    (stranger, "of another rig"), (lambda run: negated(run, "tau2_nm"), "of another rig"),
    (lambda run: with_column(run, "q1_rad", np.degrees(run["q1_rad"])), "of another rig")])
def test_the_run_is_named_with_the_reason(spoil: object, why: str) -> None:
    bad = replace(spoil(arm_run(7, seconds=6.0)), name="bad.csv")  # type: ignore[operator]
    kept, aside = usable_runs([*GOOD[:2], bad, *GOOD[2:]], leg2(actuated=(0, 1)), FitOptions(sensors="encoder"))
    assert [d.name for d in kept] == [d.name for d in GOOD]
    assert [a.run for a in aside] == ["bad.csv"] and why in aside[0].why


def test_good_runs_and_a_single_one_are_kept() -> None:
    assert usable_runs(GOOD, leg2(actuated=(0, 1)), FitOptions(sensors="encoder")) == (tuple(GOOD), ())
    assert usable_runs([locked(GOOD[0])], leg2(actuated=(0, 1)), FitOptions(sensors="encoder"))[1] == ()
    quiet = [with_column(run, "tau1_nm", np.zeros(len(run))) for run in GOOD]  # free swings are no faults
    assert not usable_runs([*GOOD, quiet[0]][:3], leg2(actuated=(0, 1)), FitOptions(sensors="encoder"))[1]


def test_fit_and_validate_go_on_without_it(tmp_path: Path, shell: Shell) -> None:
    runs = written([*GOOD, replace(locked(arm_run(8, seconds=6.0)), name="bad.csv")], tmp_path)
    rig, model = tmp_path / "rig.toml", tmp_path / "model.json"
    rig.write_text(ARM_RIG)
    found = document("fit", *runs, "--rig", rig, "--model-out", model)
    assert "Warning: bad.csv is set aside: joint 2 never moves" in shell.out
    assert [a["run"] for a in found["set_aside"]] == ["bad.csv"]
    assert np.allclose([p["value"] for p in found["parameters"][:5]], BETA[:5], rtol=0.03)
    found = document("validate", model, *runs[3:], "--rig", rig)
    assert "bad.csv is set aside" in shell.err
    assert {r["run"] for r in found["runs"]} == {"run3.csv"}


def test_a_pause_shorter_than_the_grids_step_is_no_hole() -> None:
    """616 Hz with pauses of 5.9 ms, put on 100 Hz: used to be a hole every few samples. Longer ones stay holes."""
    rng = np.random.default_rng(2)
    steps = np.where(rng.random(6000) < 0.05, 5.9e-3, 1.0 / 616.0)
    time = np.cumsum(steps)
    table = RawTable("uneven", time, {"q1_rad": np.sin(3.0 * time)})
    run = align_table(table, 100.0)
    assert np.isfinite(run["q1_rad"]).all()
    assert np.max(np.abs(run["q1_rad"] - np.sin(3.0 * run.time_s) * np.sinc(0.03 / (2.0 * np.pi)))) < 1e-4
    late = align_table(RawTable("pause", time + 0.012 * (time > 4.0), {"q1_rad": np.sin(3.0 * time)}), 100.0)
    assert np.isnan(late["q1_rad"]).any()
    assert np.isnan(align_table(table, 400.0)["q1_rad"]).any()
