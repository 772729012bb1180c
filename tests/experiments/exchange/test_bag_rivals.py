"""A bag with JointState and raw topics: the one that agrees with the motion is taken, whatever its name."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.support.mujoco_leg import Leg, record
from tests.support.ros_bag import Bag, header, made
from tests.support.shell import typed


def bag(folder: Path, coarse: str, empty_efforts: bool) -> Path:
    """Positions and efforts in /joint_states, and once more in topics of their own; `coarse` ("joint_states" or "raw")
    has the torque with errors of half its size."""
    run = record(Leg(), 21, seconds=10.0)
    rough = run["tau2_nm"] + 0.5 * np.std(run["tau2_nm"]) * np.random.default_rng(3).standard_normal(len(run))
    efforts = {"joint_states": (rough, run["tau2_nm"]), "raw": (run["tau2_nm"], rough)}[coarse]
    with Bag(folder) as bag:
        for k, time_s in enumerate(run.time_s):
            bag.put("/joint_states", time_s, made(
                "sensor_msgs/JointState", header(time_s), ["hip", "knee"],
                np.array([run["q1_rad"][k], run["q2_rad"][k]]), np.zeros(0),
                np.array([0.0, 0.0 if empty_efforts else efforts[0][k]])))
            bag.put("/knee_motor/torque", time_s, made("std_msgs/Float64", float(efforts[1][k])))
    return folder


@pytest.mark.parametrize("coarse, empty, torque", [
    ("raw", False, "/joint_states/knee/effort"), ("joint_states", False, "/knee_motor/torque/data"),
    ("joint_states", True, "/knee_motor/torque/data")])
def test_the_better_torque_of_a_bag_is_taken(coarse: str, empty: bool, torque: str, here: Path) -> None:
    target = here / "c.toml"
    typed("import", bag(here / "bag", coarse, empty), "--guess --map c.toml")
    names = dict(re.findall(r'\[columns\.(\w+)\]\nname = "([^"]+)"', target.read_text()))
    assert names["tau2_nm"] == torque and names["q2_rad"] == "/joint_states/knee/position"
    assert (", which may be" in target.read_text() or "may be its torque" in target.read_text()) == (not empty)
