"""Samples that one device has lost against the others: named at their place, and moved back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, FloatArray
from daq.rig import parse_rig
from daq.runs.csv_run import RawTable
from daq.timing.resample import align_table
from experiments.session.lost_samples import with_lost_samples
from experiments.session.setup import setup_of
from experiments.workflows import fit_runs
from tests.support.driven_pendulum import pendulum_run
from tests.support.imported_files import table_of
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell

IMU = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'
ENCODERS = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'
GYRO = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")


def lose(x: FloatArray, row: int, count: int) -> FloatArray:
    """x (n,) without `count` samples from `row` on, or with the last ones twice where negative."""
    out = np.concatenate([x[:row], x[row + count:]])
    return np.concatenate([out, np.full(max(x.size - out.size, 0), out[-1])])[:x.size]


def leg(seed: int, rig: str, columns: tuple[str, ...] = (), row: int = 0, count: int = 0) -> tuple[Dataset, Dataset]:
    """A run before and after `columns` lose samples."""
    run = record(Leg(), np.random.default_rng(seed))
    names = ("q2_rad", "tau2_nm", *(GYRO if rig is IMU else ("q1_rad",)))
    right = replace(run, columns={name: run[name] for name in names})
    return right, replace(right, columns={name: lose(x, row, count) if name in columns else x
                                          for name, x in right.columns.items()})


def corrected(data: Dataset, rig: str) -> Dataset:
    setup = setup_of([data], parse_rig(rig))
    (found,) = with_lost_samples(setup.datasets, setup.mechanism, setup.options)
    return found


@pytest.mark.parametrize("rig, columns", [(IMU, ("q2_rad",)), (ENCODERS, ("q2_rad",)), (ENCODERS, ("tau2_nm",))])
@pytest.mark.parametrize("row, count", [(900, 4), (1300, -3)])
def test_lost_samples_are_named_and_moved_back(rig: str, columns: tuple[str, ...], row: int, count: int) -> None:
    right, wrong = leg(3, rig, columns, row, count)
    found = corrected(wrong, rig)
    faults = found.readings
    assert {fault.what for fault in faults} == {"lost"} and len({fault.rows for fault in faults}) == 1
    assert abs(faults[0].rows[0][0] - row) < 50 and abs(faults[0].size) == abs(count)
    assert ("lost 4 samples" in str(faults[0])) == (faults[0].size == 4)
    far = np.abs(np.arange(len(right)) - row) > 60  # slow motion places a row no better
    if faults[0].column in columns:
        difference = found[columns[0]][far] - right[columns[0]][far]
    else:  # the others, by as much the other way: then all columns agree on that other time
        moved = lose(right[faults[0].column], row, count)
        difference = (found[faults[0].column] - moved)[far]
    assert np.nanmax(np.abs(difference[:-abs(count) - 20])) < 1e-9


@pytest.mark.parametrize("rig", [IMU, ENCODERS])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_healthy_runs_lose_nothing(rig: str, seed: int) -> None:
    right, _ = leg(seed, rig)
    assert corrected(right, rig).readings == ()


@pytest.mark.parametrize("count", [3, -5])
def test_a_constant_delay_is_no_loss(count: int) -> None:
    right, _ = leg(3, ENCODERS)
    late = replace(right, columns={**right.columns, "tau2_nm": np.roll(right["tau2_nm"], count)})
    assert corrected(late, ENCODERS).readings == ()


def test_a_fit_of_a_run_with_lost_samples_is_right(tmp_path: Path, shell: Shell) -> None:
    run = pendulum_run("r", 4)
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n')
    shell("fit", table_of(run, tmp_path / "r.csv", tau1_nm=lose(run["tau1_nm"], len(run) // 2, 4)), "--rig",
          tmp_path / "rig.toml")
    said = shell.out
    assert "against the other columns at about" in said
    beta1 = float(next(line for line in said.splitlines() if line.startswith("beta1  ")).split()[1])
    assert beta1 == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("columns, count", [(("q2_rad",), 17), (("q2_rad",), 29), (("tau2_nm",), -14)])
def test_many_lost_samples_are_named_and_not_the_motion(columns: tuple[str, ...], count: int) -> None:
    right, wrong = leg(4, ENCODERS, columns, 1000, count)
    faults = corrected(wrong, ENCODERS).readings
    assert {fault.what for fault in faults} == {"lost"} and abs(faults[0].size) == abs(count)
    assert abs(faults[0].rows[0][0] - 1000) < 50 and corrected(right, ENCODERS).readings == ()


@pytest.mark.parametrize("times, seed", [(2, 3), (4, 4), (6, 5)])
def test_an_imu_that_repeats_its_readings_is_named(times: int, seed: int) -> None:
    """Noise levels that the rig file declares made it a lack of excitation."""
    right, _ = leg(seed, IMU)
    slow = {name: x[::times].repeat(times)[:len(right)] for name, x in right.columns.items() if name in GYRO}
    run = align_table(RawTable("r", right.time_s, {**right.columns, **slow}), right.rate_hz)
    assert {(fault.column, fault.what, fault.size) for fault in run.readings} == {
        (name, "repeated", times) for name in GYRO}
    declared = IMU + "[noise]\ngyro_radps = 0.005\naccel_mps2 = 0.05\ntorque_nm = 0.02\nencoder_rad = 4e-4\n"
    found, wanted = (fit_runs([one], parse_rig(declared), method="wls").result.beta[:5] for one in (run, right))
    np.testing.assert_allclose(found, wanted, rtol=0.1)
