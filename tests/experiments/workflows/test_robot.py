"""`legid doctor --model leg.xml RUN...`: a robot file against runs of a leg that MuJoCo simulated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, InputError, load_rig
from experiments.models import MechanismSettings, Model, load_model
from experiments.simulators import export_model, model_of_robot, read_robot
from experiments.workflows import judge_robot
from tests.support.models import LEG, LEG_RIG, write_model
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell

TRUE = Leg(viscous=(0.02, 0.03), coulomb=(0.0, 0.0))


def robot(folder: Path, leg: Leg) -> Path:
    """The leg as an MJCF file, and its rig next to it."""
    (folder / "rig.toml").write_text(LEG_RIG.format(q1=1.0))
    path = folder / "leg.xml"
    model = load_model(write_model(folder / "m.json", leg.beta().tolist(), LEG))
    path.write_text(export_model(model, "mjcf", "m.json")[0])
    return path


def model_of(source: Path) -> Model:
    return model_of_robot(read_robot(source), MechanismSettings(**LEG), "zero", "leg.xml")  # type: ignore[arg-type]


def test_a_file_is_the_model_that_was_exported(tmp_path: Path) -> None:
    found = model_of(robot(tmp_path, Leg()))
    assert found.beta == pytest.approx(Leg().beta().tolist(), rel=1e-9)


@pytest.fixture(scope="module")
def runs() -> list[Dataset]:
    return [record(TRUE, seed, seconds=10.0, amplitude=0.6, name=f"r{seed}") for seed in (1, 2)]


def test_wrong_parameters_of_a_file_are_named(runs: list[Dataset], tmp_path: Path) -> None:
    right, wrong = (judge_robot(robot(tmp_path, leg), runs, load_rig(tmp_path / "rig.toml"))
                    for leg in (TRUE, replace(TRUE, viscous=(0.02, 0.06))))
    named = [row for row in wrong.rows if row.contradicted]
    assert "beta7" in [row.name for row in named] and max(named, key=lambda r: abs(r.half_widths)).name == "beta7"
    assert sum(row.contradicted for row in right.rows) <= 2  # of nine intervals of 95 %
    error = [found.validation.table.rms(0, "q2_rad", np.inf) for found in (right, wrong)]
    assert error[1] > 3.0 * error[0]
    assert "beta7" in wrong.text() and "half widths" in wrong.text()


def test_what_cannot_be_judged_is_one_line(tmp_path: Path, shell: Shell) -> None:
    source = robot(tmp_path, Leg())
    shell.fails("doctor --model", source)
    shell.fails("doctor run.csv")
    source.write_text(source.read_text().replace('pos="0 0 -0.3', 'pos="0.3 0 0'))
    with pytest.raises(InputError, match="does not hang along -z"):
        model_of(source)
