"""`legid fit --each`: every run alone, in order, on local processes."""

from pathlib import Path

import numpy as np
import pytest

from daq.runs import write_csv
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell, document

RIG = """
[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
"""


@pytest.fixture(scope="module")
def runs(module_path: Path) -> tuple[Path, list[Path]]:
    rig = module_path / "rig.toml"
    rig.write_text(RIG)
    paths = []
    for k in range(3):
        paths.append(module_path / f"r{k}.csv")
        write_csv(record(Leg(), np.random.default_rng(k), seconds=6.0), paths[-1])
    return rig, paths


def test_each_run_gets_its_own_fit_in_order(runs: tuple[Path, list[Path]], shell: Shell) -> None:
    rig, paths = runs
    fits = document("fit --each", *paths, "--rig", rig, "--workers 2")["fits"]
    assert [Path(fit["run"]).name for fit in fits] == ["r0.csv", "r1.csv", "r2.csv"]
    alone = document("fit", paths[1], "--rig", rig)["parameters"]
    np.testing.assert_allclose([p["value"] for p in fits[1]["parameters"]], [p["value"] for p in alone], rtol=1e-9)
    assert "r2.csv" in shell.out


def test_one_bad_file_does_not_stop_the_others(runs: tuple[Path, list[Path]], tmp_path: Path, shell: Shell) -> None:
    rig, paths = runs
    bad = tmp_path / "bad.csv"
    bad.write_text("time_s,q2_rad\n0,x\n")
    shell("fit --each", bad, paths[0], "--rig", rig, "--workers 1", status=2)
    out = shell.out
    assert "not fitted" in out and "r0.csv" in out


def test_each_makes_no_model(runs: tuple[Path, list[Path]], tmp_path: Path, shell: Shell) -> None:
    rig, paths = runs
    assert "--each" in shell.fails("fit --each", paths[0], "--rig", rig, "--model-out", tmp_path / "m.json")
