"""A bag with JointState and raw topics: the one that agrees with the motion is taken, whatever its name."""

import re
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tests.support.mujoco_leg import Leg, record
from tests.support.shell import typed


def bag(folder: Path, coarse: str, empty_efforts: bool) -> Path:
    """Positions and efforts in /joint_states, and once more in topics of their own; `coarse` ("joint_states" or "raw")
    has the torque with errors of half its size."""
    run = record(Leg(), np.random.default_rng(21), seconds=10.0)
    store = get_typestore(Stores.ROS2_HUMBLE)
    t = store.types
    joint, number = t["sensor_msgs/msg/JointState"], t["std_msgs/msg/Float64"]
    header, stamp = t["std_msgs/msg/Header"], t["builtin_interfaces/msg/Time"]
    rough = run["tau2_nm"] + 0.5 * np.std(run["tau2_nm"]) * np.random.default_rng(3).standard_normal(len(run))
    efforts = {"joint_states": (rough, run["tau2_nm"]), "raw": (run["tau2_nm"], rough)}[coarse]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        states = writer.add_connection("/joint_states", joint.__msgtype__, typestore=store)
        raw = writer.add_connection("/knee_motor/torque", number.__msgtype__, typestore=store)
        for k, time_s in enumerate(run.time_s):
            at = 1_700_000_000_000_000_000 + round(time_s * 1e9)
            message = joint(header(stamp(*divmod(at, 1_000_000_000)), ""), ["hip", "knee"],
                            np.array([run["q1_rad"][k], run["q2_rad"][k]]), np.zeros(0),
                            np.array([0.0, 0.0 if empty_efforts else efforts[0][k]]))
            writer.write(states, at, store.serialize_cdr(message, joint.__msgtype__))
            writer.write(raw, at, store.serialize_cdr(number(float(efforts[1][k])), number.__msgtype__))
    return folder


@pytest.mark.parametrize("coarse, empty, torque", [
    ("raw", False, "/joint_states/knee/effort"), ("joint_states", False, "/knee_motor/torque/data"),
    ("joint_states", True, "/knee_motor/torque/data")])
def test_the_better_torque_of_a_bag_is_taken(coarse: str, empty: bool, torque: str, tmp_path: Path) -> None:
    target = tmp_path / "c.toml"
    typed("import", bag(tmp_path / "bag", coarse, empty), "--guess --map", target)
    names = dict(re.findall(r'\[columns\.(\w+)\]\nname = "([^"]+)"', target.read_text()))
    assert names["tau2_nm"] == torque and names["q2_rad"] == "/joint_states/knee/position"
    assert (", which may be" in target.read_text() or "may be its torque" in target.read_text()) == (not empty)
