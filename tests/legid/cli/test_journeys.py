"""Three journeys of a new user, each command typed in an empty folder: own CSV, a leg with a moteus, a ROS bag."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from daq import load_rig
from experiments.emulation import ServedRig
from legid.cli import main
from tests.support.imported_files import ros2_bag
from tests.support.mujoco_leg import Leg, record
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Answers

Type = Callable[..., str]
PER_AMPERE = 0.9


@pytest.fixture
def typed(here: Path, capfd: pytest.CaptureFixture[str]) -> Type:
    """Types a command in the empty folder, which ends with this status; everything that it printed."""

    def run(line: str, *statuses: int) -> str:
        program, *words = shlex.split(line)
        assert program == "legid"
        status = main(words)
        said = "".join(capfd.readouterr())
        assert status in (statuses or (0,)), said
        return said

    return run


def told(said: str, begin: str) -> str:
    """The command that a message names after `begin`."""
    found = re.search(rf"(?m){re.escape(begin)}(legid .*)$", said)
    assert found is not None, said
    return found[1]


def values(said: str) -> list[float]:
    return [float(line.split()[1]) for line in said.splitlines() if re.match(r"beta[1-5] +[-0-9]", line)]


def test_own_csv_with_current_in_amperes(typed: Type, tmp_path: Path, answers: Answers) -> None:
    for k in (1, 2, 3):
        run = record(Leg(), k, seconds=12.0)
        table = [run.time_s * 1000.0, np.degrees(run["q1_rad"]), np.degrees(run["q2_rad"]), run["tau2_nm"] / PER_AMPERE]
        np.savetxt(tmp_path / f"log{k}.csv", np.column_stack(table), delimiter=";", comments="", fmt="%.5f",
                   header="time [ms];hip [deg];knee [deg];current [A]")
    assert "or write it: legid init rig.toml" in typed("legid fit log1.csv", 2)
    answers("leg2", "2", "9.81", "", "none", "1", "none")
    assert "Next: legid import FILE..., then legid fit" in typed("legid init rig.toml")
    guess = "legid import log1.csv --map columns.toml --guess"
    assert f"it is another program's file; run: {guess}" in typed("legid fit log1.csv", 2)
    said = typed(guess.replace("log1.csv", "log1.csv log2.csv log3.csv"))
    assert "first write scale = N m per A, gear included, under [columns.tau2_nm] in columns.toml" in said
    after = told(said, "then: ")
    assert "is in A and has no scale" in typed(after, 2)
    text = (tmp_path / "columns.toml").read_text()
    (tmp_path / "columns.toml").write_text(text.replace('unit = "A"', f'unit = "A"\nscale = {PER_AMPERE}'))
    assert "runs/log3.csv: 1200 samples at 100 Hz" in typed(after)
    said = typed("legid runs .")
    assert "3 runs" in said and "3 CSV files of other programs" in said
    said = typed("legid fit runs/log1.csv runs/log2.csv --model-out model.json")
    assert said.startswith("TRUST the parameters")
    assert values(said) == pytest.approx(Leg().beta()[:5], rel=0.05)
    said = typed("legid validate model.json runs/log3.csv")
    assert "TRUST for simulation over 12 s" in said and "Initial states" in said
    typed("legid simulate model.json --plan runs/log3.csv --out simulated.csv")
    typed("legid export model.json --out leg.urdf")
    assert (tmp_path / "leg.urdf").read_text().startswith("<?xml")


def test_a_ros_bag(typed: Type, tmp_path: Path, answers: Answers) -> None:
    run = record(Leg(), 9, seconds=12.0)
    ros2_bag(run, tmp_path / "bag", StoragePlugin.MCAP)
    answers("leg2", "2", "9.81", "0.2", "none", "1", "none")
    typed("legid init rig.toml")
    said = typed("legid import bag --map columns.toml --guess")
    assert "/joint_states/knee/effort" in said
    said = typed(told(said, "then: "))
    assert "gyro_radps" in said
    said = typed("legid fit bag.csv --model-out model.json")
    assert "TRUST the parameters" in said
    assert values(said) == pytest.approx(Leg().beta()[:5], rel=0.05)
    said = typed("legid diagnose bag.csv --json diagnosis.json --workers 1")
    assert not re.search(r"(?<!NEW_)RUN|RIG", said.split("Next step: ")[1].splitlines()[0])


@REAL_CLOCK
def test_a_leg_with_a_moteus(typed: Type, tmp_path: Path, answers: Answers, monkeypatch: pytest.MonkeyPatch) -> None:
    with ServedRig(tmp_path / "served", drive="moteus") as served:
        devices = load_rig(served.rig_path).devices
        assert devices.imu is not None and devices.controller.port is not None
        answers("leg2", "2", "9.81", "0.2", devices.imu.bus, "50", "moteus", devices.controller.port, "1",
                "0.85", "200", "1.0", "20", "1.5", "3")
        said = typed("legid init rig.toml")
        assert "values are assumed and marked so. Next: legid doctor --rig rig.toml" in said
        said = typed(told(said, "Next: "), 1)  # what nobody has measured yet
        assert "correct [calibration] imu_mount" in said
        offset = re.search(r"set \[calibration\] shunt_offset_a = (\S+)", said)
        assert offset is not None and float(offset[1]) == pytest.approx(0.031, abs=0.005)
        rig = (tmp_path / "rig.toml").read_text()
        for key, value in (("shunt_offset_a", offset[1]), ("knee_zero_rad", "0.215"), ("watchdog_ms", "500"),
                           ("staleness_s", "1.0"), ("clock_bound_s", "0.02"),  # this machine serves the leg, too
                           ("imu_mount", "[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]")):
            rig = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", rig)
        (tmp_path / "rig.toml").write_text(rig)
        said = typed("legid excite --rig rig.toml --out plan.csv --seconds 6 --peak 0.7")
        after = told(said, "Next: ").replace("RUN.mcap", "run.mcap")
        monkeypatch.setattr("sys.stdin.isatty", lambda: False)  # as in a script
        said = typed(after, 2)
        assert "give --estop-at-hand" in said
        typed(f"{after} --estop-at-hand")
    typed("legid info run.mcap")
    assert "rig: the one that run.mcap holds" in typed("legid fit run.mcap", 0, 1)
