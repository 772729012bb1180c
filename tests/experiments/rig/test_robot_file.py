"""`legid init --from`: files that legid itself exports come back as they were; others are refused with a remedy."""

from pathlib import Path

import numpy as np
import pytest

from daq import load_rig
from estimator.model import leg2, rigid_parameters
from experiments.models import load_model
from experiments.simulators import export_model, read_robot
from tests.support.models import LEG, write_model
from tests.support.mujoco_leg import Leg
from tests.support.shell import Shell, typed

BETA = Leg().beta().tolist()


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_the_bodies_of_an_exported_leg_make_its_parameters(kind: str, here: Path) -> None:
    model = load_model(write_model(here / "m.json", BETA, LEG))
    source = here / f"leg.{kind}"
    source.write_text(export_model(model, kind, "m.json")[0])
    typed("init rig.toml --from", source)
    rig = load_rig(here / "rig.toml")
    assert rig.mechanism.model == "leg2" and rig.mechanism.actuated == (2,)
    bodies = {name: value for name, (value, _) in rig.prior.items()}
    assert list(bodies) == ["m1", "lc1", "I1", "l1", "m2", "lc2", "I2"]
    assert rigid_parameters(leg2(), bodies)[0] == pytest.approx(BETA[:5], rel=1e-4)
    assert all(std == pytest.approx(0.05 * abs(value), rel=0.05) for value, std in rig.prior.values())


@pytest.mark.parametrize("text, told", [
    ("<robot", "is not XML"), ("<sdf/>", "begins with <sdf>"), ("<robot/>", "has no hinge"),
    ("<!DOCTYPE x><robot/>", "declares entities"),
    ('<mujoco><worldbody><body name="a"><joint/></body></worldbody></mujoco>', "MuJoCo cannot read it"),
    ('<mujoco><worldbody><body name="a" pos="0 0 x"><joint/><inertial mass="1"/></body></worldbody></mujoco>',
     "MuJoCo cannot read it"),
    ('<mujoco><worldbody><body name="a"><joint type="slide"/><geom size="1"/></body></worldbody></mujoco>',
     "is no hinge"),
    ('<mujoco><worldbody><body name="a"><joint/><geom size="1"/><body name="b"><joint/><geom size="1"/></body>'
     '<body name="c"><joint/><geom size="1"/></body></body></worldbody></mujoco>', "body c branches off"),
    ('<mujoco><worldbody><body name="a"><joint/><geom size="1"/><body name="b"><joint axis="1 0 0"/><geom size="1"/>'
     '</body></body></worldbody></mujoco>', "turns b about another axis than a")])
def test_what_cannot_be_read_is_one_line(text: str, told: str, here: Path,
                                         shell: Shell) -> None:
    source = here / "robot.xml"
    source.write_text(text)
    said = shell.fails("init rig.toml --from robot.xml")
    assert told in said and not (here / "rig.toml").exists()


def test_rotations_defaults_and_shapes_are_compiled(here: Path) -> None:
    """A leg whose frames are turned, whose inertias come of shapes, and a foot without a joint of its own."""
    source = here / "leg.xml"
    source.write_text('''<mujoco><compiler angle="degree"/>
      <default><joint axis="0 0 1" damping="0.02" armature="0.003"/>
        <geom type="capsule" size="0.01" mass="0.5"/></default>
      <worldbody><body name="thigh" euler="90 0 0"><joint name="hip"/><geom fromto="0 0 0 0 -0.3 0"/>
        <body name="shank" pos="0 -0.3 0" euler="0 0 0"><joint name="knee"/><geom fromto="0 0 0 0 -0.25 0"/>
          <body name="foot" pos="0 -0.25 0" quat="0 1 0 0"><geom type="sphere" size="0.02" mass="0.1"/></body></body>
      </body></worldbody><actuator><motor joint="knee"/></actuator></mujoco>''')
    thigh, shank = read_robot(source)
    assert (thigh.driven, shank.driven, shank.viscous, shank.armature) == (False, True, 0.02, 0.003)
    assert shank.mass == pytest.approx(0.6) and np.abs(shank.at) == pytest.approx([0, 0, 0.3], abs=1e-12)
    assert shank.centre == pytest.approx([0, 0, -(0.5 * 0.125 + 0.1 * 0.25) / 0.6])
    typed("init rig.toml --from leg.xml")
    assert load_rig(here / "rig.toml").prior["l1"][0] == pytest.approx(0.3)
