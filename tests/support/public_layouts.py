"""Recordings as other projects' programs write them: PACE, LeRobot, BAM, ROS trajectories, registers."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from daq import Dataset, FloatArray
from tests.support.imported_files import table
from tests.support.ros_bag import Bag, header, made

DEGREE = np.pi / 180.0
SO101 = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]


def lerobot(folder: Path, episodes: list[list[Dataset]], fps: float = 30.0, v2: bool = False,
            robot: str = "so101_follower", load: str = "") -> list[Path]:
    """A data set of an SO-101 whose joints are runs, in degrees; version 3 in one file, 2.1 in one an episode.

    `load` is a feature whose reading is 3 times the error of the command.

    As `LeRobotDataset` writes them: float32 lists of fixed size, timestamps that begin anew in every episode.
    """
    names = [f"{name}.pos" for name in SO101]
    feature = {"dtype": "float32", "shape": [6], "names": {"motors": names} if v2 else names}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps({
        "codebase_version": "v2.1" if v2 else "v3.0", "robot_type": robot, "fps": fps,
        "features": {"action": feature, "observation.state": feature} | ({load: {
            **feature, "names": [f"{name}.effort" for name in SO101]}} if load else {})}))
    tables = []
    for k, joints in enumerate(episodes):
        state, action = (np.stack([run[name] for run in joints], axis=1) / DEGREE
                         for name in ("q1_rad", "q1_cmd_rad"))
        n = len(state)
        lists = {"action": action, "observation.state": state} | ({load: 3.0 * (action - state)} if load else {})
        columns = {name: pa.FixedSizeListArray.from_arrays(pa.array(values.astype(np.float32).ravel()), 6)
                   for name, values in lists.items()}
        tables.append(pa.table(columns | {
            "timestamp": (np.arange(n) / fps).astype(np.float32), "frame_index": np.arange(n),
            "episode_index": np.full(n, k), "index": np.arange(n), "task_index": np.zeros(n, dtype=int)}))
    data = folder / "data/chunk-000"
    data.mkdir(parents=True)
    if v2:
        paths = [data / f"episode_{k:06d}.parquet" for k in range(len(tables))]
        for one, path in zip(tables, paths):
            parquet.write_table(one, path)
        return paths
    parquet.write_table(pa.concat_tables(tables), data / "file-000.parquet")
    return [data / "file-000.parquet"]


def bam(path: Path, run: Dataset, motor: str, released_s: float = np.inf) -> Path:
    """A recording of bam/dynamixel/record.py with the load as a register without its sign; the goal goes on where the
    servo is released."""
    duty = np.round(0.25 * 885 * np.sin(3.0 * run.time_s)).astype(int)
    entries = [{"position": q, "speed": 0.0, "load": int(d) % 65536, "input_volts": 7.3, "temp": 28, "timestamp": t,
                "goal_position": c, "torque_enable": bool(t < released_s)}
               for t, q, c, d in zip(run.time_s, run["q1_rad"], run["q1_cmd_rad"], duty)]
    path.write_text(json.dumps({"mass": 0.49, "arm-mass": 0.02, "length": 0.1, "kp": 100, "vin": 7.4, "motor": motor,
                                "trajectory": "sin_sin", "entries": entries}))
    return path


def trajectory_bag(folder: Path, run: Dataset, points_s: FloatArray) -> Path:
    """A bag of /joint_states at the run's times and one /joint_trajectory that commands `run`'s at `points_s`."""
    none, wanted = np.zeros(0), np.interp(points_s, run.time_s, run["q1_cmd_rad"])
    with Bag(folder) as bag:
        points = [made("trajectory_msgs/JointTrajectoryPoint", np.array([q]), none, none, none,
                           made("builtin_interfaces/Duration", *divmod(round(s * 1e9), 10**9)))
                  for s, q in zip(points_s, wanted)]
        start = made("std_msgs/Header", made("builtin_interfaces/Time", 0, 0), "")
        bag.put("/arm/joint_trajectory", 0.0, made("trajectory_msgs/JointTrajectory", start, ["elbow"], points))
        for time_s, q in zip(run.time_s, run["q1_rad"]):
            bag.put("/joint_states", time_s, made("sensor_msgs/JointState", header(time_s), ["elbow"],
                                                      np.array([q]), none, none))
    return folder


def feetech(path: Path, run: Dataset, multi_turn: bool = False) -> Path:
    """Registers of an STS3215 as they are read: magnitudes with a sign bit, 15 of angles and 10 of the load."""
    def magnitude(values: FloatArray, bit: int) -> FloatArray:
        whole = np.round(values)
        return np.where(whole < 0, -whole + 2**bit, whole)

    shift = 0.0 if multi_turn else 2048.0
    counts = {name: magnitude(run[name] * 4096 / (2.0 * np.pi) + shift, 15) for name in ("q1_rad", "q1_cmd_rad")}
    load = magnitude(1000.0 * np.clip(2.0 * (run["q1_cmd_rad"] - run["q1_rad"]), -1.0, 1.0), 10)
    return table(path, {"time": run.time_s, "Goal_Position": counts["q1_cmd_rad"], "Present_Position": counts["q1_rad"],
                        "Present_Load": load, "Present_Voltage": np.full(len(run), 121.0),
                        "Present_Current": np.full(len(run), 7.0)}, 9)


def dynamixel(path: Path, run: Dataset) -> Path:
    """Registers of an XL330 as they are read: 32 and 16 bits, negative numbers as large ones."""
    position, goal = (np.mod(np.round(run[name] * 4096 / (2.0 * np.pi)), 2.0**32) for name in ("q1_rad", "q1_cmd_rad"))
    pwm = np.mod(np.round(885 * np.clip(run["q1_cmd_rad"] - run["q1_rad"], -1.0, 1.0)), 2.0**16)
    return table(path, {"time": run.time_s, "present_position": position, "goal_position": goal, "present_pwm": pwm,
                        "present_input_voltage": np.full(len(run), 50.0)})
