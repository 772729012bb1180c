"""`legid calibrate shunt --weight`: a wrong torque constant is found on closed-form runs, written, and said of."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from daq import Calibration, InputError, load_rig, parse_rig
from estimator.calibration import Weight
from experiments.calibrate import calibrate_torque_constant
from experiments.calibrate.torque_constant import find_holds
from experiments.workflows.diagnose import with_known_gain
from tests.support.hold_runs import Truth, hold_run
from tests.support.imported_files import rows_of, table_of
from tests.support.runs import with_columns, without
from tests.support.shell import Shell

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[calibration]\ntorque_constant_nm_per_a = 0.85  # by the sheet\n'
WEIGHT = Weight(0.5, 0.25, 0.0005, 0.0005)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def found(truth: Truth, seed: int = 1, columns: str = "imu") -> tuple[float, float]:
    """(gain, half) against the rig file's constant."""
    rng, rig = np.random.default_rng(seed), parse_rig(RIG)
    bare, weighted = (hold_run(truth, rng, mass, columns=columns) for mass in (0.0, 0.5))
    values = calibrate_torque_constant([bare], [weighted], rig, WEIGHT).values["calibration"]
    return (float(values["torque_constant_nm_per_a"]) / 0.85,  # type: ignore[arg-type]
            float(values["torque_constant_half_nm_per_a"]) / 0.85)  # type: ignore[arg-type]


@pytest.mark.parametrize("truth", [
    Truth(), Truth(gain=0.93), Truth(coulomb=0.1), Truth(knee_zero_rad=0.03), Truth(offset_nm=0.05),
    Truth(load_friction=0.05)], ids=str)
@pytest.mark.parametrize("columns", ["imu", "pivot"])
def test_a_gain_that_is_off_is_found_within_its_interval(truth: Truth, columns: str) -> None:
    gain, half = found(truth, columns=columns)
    assert abs(gain - truth.gain) < 1.5 * half and half < 0.015


def test_the_interval_holds_on_many() -> None:
    rng = np.random.default_rng(9)
    inside = []
    for seed in range(60):
        truth = Truth(rng.uniform(0.9, 1.1), rng.uniform(0.3, 0.6), rng.uniform(0.09, 0.13), rng.uniform(0.01, 0.08))
        gain, half = found(truth, seed)
        inside.append(abs(gain - truth.gain) < half)
    assert np.mean(inside) >= 0.9


def test_holds_that_move_or_come_back_are_left_out() -> None:
    run = hold_run(Truth(), np.random.default_rng(1))
    whole = find_holds(run, parse_rig(RIG))
    assert whole.left_out == 2 and whole.current.size == 14 and set(whole.side) == {1.0, -1.0}
    knee = run["q2_rad"].copy()
    knee[650:700] += np.linspace(0.0, 0.05, 50)  # the first hold behind the first ramp: it creeps
    knee[1050:1100] += 0.03  # the second: it swings beyond where it comes to rest
    left = find_holds(with_columns(run, q2_rad=knee), parse_rig(RIG))
    assert left.left_out == 4 and left.current.size == 12


@pytest.mark.parametrize("column, line", [("tau2_cmd_nm", "has no column tau2_cmd_nm"),
                                              ("accel_y_mps2", "has no column accel_y")])
def test_a_run_without_a_column_is_refused(column: str, line: str) -> None:
    run = hold_run(Truth(), np.random.default_rng(1))
    with pytest.raises(InputError, match=line):
        find_holds(without(run, column), parse_rig(RIG))


def test_the_command_writes_constant_and_interval_and_keeps_comments(rig: Path, tmp_path: Path, shell: Shell) -> None:
    rng = np.random.default_rng(2)
    bare, weighted = (table_of(hold_run(Truth(), rng, m), tmp_path / f"{m}.csv") for m in (0.0, 0.5))
    order = "calibrate shunt", bare, "--weighted", weighted, "--weight 0.5 --arm 0.25 --rig", rig
    shell(*order, "--dry-run")
    assert rig.read_text() == RIG
    shell(*order, "--weight-error 0.001 --arm-error 0.001")
    said, c = shell.read(), load_rig(rig).calibration
    assert c.torque_constant_nm_per_a == pytest.approx(0.85 * 1.07, rel=0.015) and "# by the sheet" in rig.read_text()
    assert c.torque_constant_half_nm_per_a == pytest.approx(0.006, abs=0.006)
    assert "the torque gain is 1.0" in said.out and "the interval assumes:" in said.out
    assert "were taken as exact" in said.err  # by the first order
    known = with_known_gain({"torque_gain": "no motion", "payload": "..."}, load_rig(rig))
    assert known["torque_gain"].startswith("measured by a known weight, 0.9") and known["payload"] == "..."
    assert with_known_gain({"torque_gain": "no motion"}, parse_rig(RIG)) == {"torque_gain": "no motion"}


@pytest.mark.parametrize("more, line", [
    ("--weight 0.5", "--arm: is None"), ("--weight -1 --arm 0.2", "--weight: is -1"),
    ("--weight 1 --arm 0.2", "holds with the weight and without it are needed"),
    ("--weight 1 --arm 0.2 --arm-error -1", "--arm-error: is -1")])
def test_what_is_missing_is_asked_for(rig: Path, shell: Shell, more: str, line: str) -> None:
    assert line in shell.fails("calibrate shunt --rig", rig, more)


def test_the_data_sheet_s_constant_counts_until_one_is_measured() -> None:
    motor = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[motor]\ngear_ratio = 50.0\ntorque_constant_nm_per_a = 0.02\n'
    assert parse_rig(motor).calibration.torque_constant_nm_per_a == pytest.approx(1.0)
    assert parse_rig(motor + "[calibration]\ntorque_constant_nm_per_a = 0.9\n").calibration == Calibration(
        torque_constant_nm_per_a=0.9)


def test_the_staircase_reaches_every_level_from_both_sides(rig: Path, here: Path, shell: Shell) -> None:
    plan = here / "plan.csv"
    shell("excite --rig", rig, "--holds 3 --peak 0.9 --out plan.csv")
    torque = rows_of(plan)[:, 1]
    held = torque[1:][np.diff(torque) == 0.0].tolist()
    levels = [held[0], *(b for a, b in pairwise(held) if a != b)]
    assert levels == pytest.approx([0.0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.0, -0.3, -0.6, -0.9, -0.6, -0.3, 0.0])
