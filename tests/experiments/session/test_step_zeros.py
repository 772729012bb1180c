"""An encoder whose zero changes within a run: the motion says which part has the right one."""

from pathlib import Path

import numpy as np
import pytest

from daq import parse_rig
from experiments.session import prepare
from tests.support.driven_pendulum import pendulum_run
from tests.support.imported_files import table_of
from tests.support.shell import Shell, document

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[sampling]\nrate_hz = 50.0\n'


@pytest.mark.parametrize("first, zero", [(40, 0.0), (260, 0.0), (40, 0.5), (260, 0.5)])
def test_the_part_whose_zero_explains_the_torque_is_kept(first: int, zero: float, tmp_path: Path) -> None:
    run = pendulum_run("r", 5)
    behind = np.arange(len(run)) >= first
    read = run["q1_rad"] + np.where(behind, 0.5, 0.0) - zero  # zero 0.5: the part behind the step is right
    (found,) = prepare([table_of(run, tmp_path / "r.csv", q1_rad=read)], parse_rig(RIG)).setup.datasets
    np.testing.assert_allclose(found["q1_rad"], run["q1_rad"], atol=0.02)
    assert any("its zero has changed" in str(flag) for flag in found.told)


def test_a_clipped_torque_is_told_in_every_form(tmp_path: Path, shell: Shell) -> None:
    run = pendulum_run("r", 6)
    torque = np.clip(run["tau1_nm"], -0.6, 0.6)
    file, rig = table_of(run, tmp_path / "r.csv", tau1_nm=torque), tmp_path / "rig.toml"
    rig.write_text(RIG)
    told = "tau1_nm stands at exactly +-0.6 N m"
    shell("info", file)
    assert told in shell.out
    (fault,) = document("fit", file, "--rig", rig)["readings"]
    assert told in shell.out
    assert (fault["run"], fault["column"], fault["what"], fault["done"]) == ("r.csv", "tau1_nm", "clipped", "left_out")
    assert sum(b - a + 1 for a, b in fault["rows"]) == np.sum(np.abs(torque) == 0.6)
