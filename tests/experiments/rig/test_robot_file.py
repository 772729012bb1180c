"""`legid init --from`: files that legid itself exports come back as they were; others are refused with a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq import load_rig
from estimator.model import leg2, rigid_parameters
from experiments.cli.main import main
from experiments.models import load_model
from experiments.simulators import export_model
from tests.support.models import LEG, write_model
from tests.support.mujoco_leg import Leg

BETA = Leg().beta().tolist()


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_the_bodies_of_an_exported_leg_make_its_parameters(kind: str, tmp_path: Path) -> None:
    model = load_model(write_model(tmp_path / "m.json", BETA, LEG))
    source = tmp_path / f"leg.{kind}"
    source.write_text(export_model(model, kind, "m.json")[0])
    assert main(["init", str(tmp_path / "rig.toml"), "--from", str(source)]) == 0
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.mechanism.model == "leg2" and rig.mechanism.actuated == (2,)
    bodies = {name: entry[0] for name, entry in rig.prior.items()}
    assert list(bodies) == ["m1", "lc1", "I1", "l1", "m2", "lc2", "I2"]
    assert rigid_parameters(leg2(), bodies)[0] == pytest.approx(BETA[:5], rel=1e-4)
    assert all(std == pytest.approx(0.05 * abs(value), rel=0.05) for value, std in rig.prior.values())


@pytest.mark.parametrize(("text", "told"), [
    ("<robot", "is not XML"), ("<sdf/>", "begins with <sdf>"), ("<robot/>", "has no hinge"),
    ("<!DOCTYPE x><robot/>", "declares entities"),
    ('<mujoco><worldbody><body name="a" quat="1 0 0 0"><joint/></body></worldbody></mujoco>', "body a is none that"),
    ('<mujoco><worldbody><body name="a" pos="0 0 x"><joint/><inertial mass="1"/></body></worldbody></mujoco>',
     "no number"),
    ('<robot name="r"><link name="b"/><link name="c"/><joint name="j" type="prismatic"><parent link="b"/>'
     '<child link="c"/></joint></robot>', "joint j or its link c")])
def test_what_cannot_be_read_is_one_line(text: str, told: str, tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "robot.xml"
    source.write_text(text)
    assert main(["init", str(tmp_path / "rig.toml"), "--from", str(source)]) == 2
    said = capsys.readouterr().err
    assert told in said and said.count("\n") == 1 and not (tmp_path / "rig.toml").exists()
