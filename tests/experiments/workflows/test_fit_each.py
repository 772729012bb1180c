"""`legid fit --each`: every run alone, in order, on local processes."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.imported_files import table_of
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell, document, values

RIG = """
[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
"""


@pytest.fixture(scope="module")
def rig(module_path: Path) -> Path:
    path = module_path / "rig.toml"
    path.write_text(RIG)
    return path


@pytest.fixture(scope="module")
def runs(module_path: Path) -> list[Path]:
    return [table_of(record(Leg(), k, seconds=6.0), module_path / f"r{k}.csv")
            for k in range(3)]


def test_each_run_gets_its_own_fit_in_order(runs: list[Path], rig: Path, shell: Shell) -> None:
    fits = document("fit --each", *runs, "--rig", rig, "--workers 2")["fits"]
    assert [Path(fit["run"]).name for fit in fits] == ["r0.csv", "r1.csv", "r2.csv"]
    np.testing.assert_allclose(values(fits[1]), values(document("fit", runs[1], "--rig", rig)), rtol=1e-9)
    assert "r2.csv" in shell.out


def test_one_bad_file_does_not_stop_the_others(runs: list[Path], rig: Path, here: Path, shell: Shell) -> None:
    bad = here / "bad.csv"
    bad.write_text("time_s,q2_rad\n0,x\n")
    shell("fit --each bad.csv", runs[0], "--rig", rig, "--workers 1", status=2)
    out = shell.out
    assert "not fitted" in out and "r0.csv" in out


def test_each_makes_no_model(runs: list[Path], rig: Path, here: Path, shell: Shell) -> None:
    assert "--each" in shell.fails("fit --each", runs[0], "--rig", rig, "--model-out m.json")
