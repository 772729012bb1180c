"""One MuJoCo run as other programs would have written it: other names, units, signs, clocks and formats."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin
from scipy.io import savemat

from daq import Column, Dataset
from experiments.exchange import load_map
from tests.support.mujoco_leg import Leg, record
from tests.support.ros_bag import Bag, header, made
from tests.support.shell import typed

DEGREE = np.pi / 180.0
G = 9.80665
NEVER = np.nan


def spreadsheet(run: Dataset, path: Path) -> Path:
    """Semicolons, decimal commas, lines before the header, a line of units, milliseconds, degrees, g, other axes."""
    noise = 0.01 * np.random.default_rng(1).standard_normal(len(run))
    table = [run.time_s * 1000.0 + 1e6, -run["q2_rad"] / DEGREE, -1000.0 * run["tau2_nm"], -run["gyro_radps"] / DEGREE,
             -run["accel_y_mps2"] / G, run["accel_x_mps2"] / G, noise]
    head = ["Logger v2", "recorded;2026-01-01", "", "Zeit;knee pos;torque;gyro_z;acc x;acc y;acc z",
            "[ms];[deg];[mNm];[deg/s];[g];[g];[g]"]
    rows = [";".join(f"{value:.9f}".replace(".", ",") for value in row) for row in zip(*table)]
    path.write_bytes("\r\n".join([*head, *rows, ""]).encode("utf-16"))
    return path


def plotjuggler(run: Dataset, path: Path) -> Path:
    """As its CSV export writes: names sorted, time with 6 decimals, values with 9, blank where a signal has no sample.

    The IMU is stamped 2 ms late, so every row has blanks. Degrees; the knee's axis flipped.
    """
    joints = {"/joint_states/knee/effort": -run["tau2_nm"], "/joint_states/knee/position": -run["q2_rad"] / DEGREE}
    imu = {"/imu/accel/x": run["accel_x_mps2"], "/imu/accel/y": run["accel_y_mps2"], "/imu/gyro/z": run["gyro_radps"]}
    names = sorted([*joints, *imu])
    lines = ["__time," + ",".join(names)]
    for k, t in enumerate(run.time_s):
        for late, group in ((0.0, joints), (0.002, imu)):
            cells = [f"{group[name][k]:.9f}" if name in group else "" for name in names]
            lines.append(f"{1.7e9 + t + late:.6f}," + ",".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path


def matlab(run: Dataset, path: Path) -> Path:
    """A struct with matrices; degrees; the IMU's x and the motor the other way round."""
    rng = np.random.default_rng(2)
    blind = np.zeros((len(run), 2)) + 0.01 * rng.standard_normal((len(run), 2))
    gyro = np.column_stack([blind, run["gyro_radps"]])
    accel = np.column_stack([-run["accel_x_mps2"], run["accel_y_mps2"], blind[:, 0]])
    savemat(path, {"log": {"t": run.time_s, "knee_angle": run["q2_rad"] / DEGREE, "motor_torque": -run["tau2_nm"],
                           "gyro": gyro, "accel": accel, "note": "by hand"}})
    return path


def ros2_bag(run: Dataset, folder: Path, plugin: StoragePlugin) -> Path:
    """A bag by the library `rosbags`: sensor_msgs/Imu with z out of the plane the other way, and JointState."""
    none = np.zeros(9)
    with Bag(folder, plugin) as bag:
        for k, time_s in enumerate(run.time_s):
            head = header(time_s, "imu")
            turn, rate, force = (made(f"geometry_msgs/{kind}", *values) for kind, values in (
                ("Quaternion", (0.0, 0.0, 0.0, 1.0)), ("Vector3", (0.0, 0.0, -run["gyro_radps"][k])),
                ("Vector3", (run["accel_x_mps2"][k], run["accel_y_mps2"][k], 0.0))))
            bag.put("/thigh/imu", time_s + 4e-4,
                    made("sensor_msgs/Imu", head, turn, none, rate, none, force, none))
            bag.put("/joint_states", time_s + 7e-4,
                    made("sensor_msgs/JointState", head, ["hip", "knee"], np.array([NEVER, run["q2_rad"][k]]),
                             np.zeros(0), np.array([0.0, run["tau2_nm"][k]])))
    return folder


def pendulum(rows: int = 1200, rate_hz: float = 100.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], angle [rad] and torque [N m] of a driven pendulum."""
    t = np.arange(rows) / rate_hz
    q = 0.8 * np.sin(2.1 * t) + 0.5 * np.sin(5.3 * t + 1.0)
    qd, qdd = np.gradient(q, t), np.gradient(np.gradient(q, t), t)
    return t, q, 0.05 * qdd + 0.02 * qd + 1.2 * np.sin(q)


def table(path: Path, columns: Mapping[str, np.ndarray], digits: int = 12) -> Path:
    """A CSV file of these columns."""
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", comments="", fmt=f"%.{digits}g",
               header=",".join(columns))
    return path


def table_of(run: Dataset, path: Path, **others: np.ndarray) -> Path:
    """A CSV file of a run's time and columns; `others` replace them."""
    return table(path, {"time_s": run.time_s, **run.columns, **others})


def guess(file: Path, *words: str, status: int = 0) -> dict[str, Column]:
    """The map that `legid import --guess` writes next to a file."""
    target = file.with_suffix(".toml")
    typed("import", file, "--guess --map", target, *words, status=status)
    return load_map(target)


def imported(file: Path, *words: str) -> Path:
    """The run that an import by the guess writes."""
    guess(file, *words)
    out = file.parent / "out"
    typed("import", file, "--map", file.with_suffix(".toml"), "--out", out, *words)
    return out / f"{file.stem}.csv"


def rows_of(path: Path) -> np.ndarray:
    """(n, columns) of a CSV file."""
    return np.loadtxt(path, delimiter=",", skiprows=1)


def degrees_log(path: Path, seed: int, time: str = "Time") -> Path:
    """Ten seconds of a leg as another program logs them: degrees, semicolons, names of its own."""
    run = record(Leg(), seed, seconds=10.0)
    np.savetxt(path, np.column_stack([run.time_s, np.degrees(run["q1_rad"]), np.degrees(run["q2_rad"]),
                                      run["tau2_nm"]]),
               delimiter=";", header=f"{time} [s];Hip [deg];Knee [deg];Torque [Nm]", comments="")
    return path
