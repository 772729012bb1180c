"""Several columns of one angle, and remedies that exist: copies are named, and --rate and MATLAB's objects are told."""

import io
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from experiments.cli import main
from experiments.exchange.column_map import load_map
from tests.support.driven_joint import record
from tests.support.imported_files import guess, table
from tests.support.shell import Shell


def joint(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, angle and torque of a driven joint."""
    time, angle, torque = np.loadtxt(record(folder / "j.csv"), delimiter=",", skiprows=1).T
    return time, angle, torque


def late(x: np.ndarray) -> np.ndarray:
    """As an observer has it: low-passed."""
    out = x.copy()
    for k in range(1, x.size):
        out[k] = out[k - 1] + 0.4 * (x[k] - out[k - 1])
    return out


Make = Callable[[np.ndarray], np.ndarray]
COPIES: dict[str, tuple[str, Make, str]] = {
    "an observer's": ("joint_angle_kf", late, "'joint_angle' again"),
    "the same in degrees": ("joint_angle_deg", np.degrees, "'joint_angle' again"),
    "the motor's": ("motor_joint_angle", lambda x: 30.0 * x + 1.7, "the motor's side of 'joint_angle', ratio 30")}


@pytest.mark.parametrize("kind", COPIES)
def test_an_angle_that_is_another_again_is_named_and_left_out(kind: str, tmp_path: Path,
                                                             shell: Shell) -> None:
    name, make, told = COPIES[kind]
    time, angle, torque = joint(tmp_path)
    found = guess(table(tmp_path / "x.csv", {"t": time, name: make(angle), "joint_angle": angle, "torque": torque}, 8))
    said = shell.err
    assert f"{name!r} is {told}" in said and "correlation" in said
    assert found["q1_rad"].name == "joint_angle" and not {"q2_rad", "q3_rad"} & set(found)


def test_two_joints_that_move_alike_are_two(tmp_path: Path) -> None:
    time = np.arange(1000) / 100.0
    first = 0.5 * np.sin(3.0 * time)
    second = 0.5 * np.sin(3.0 * time - 0.01) + 1e-3 * np.random.default_rng(1).normal(size=1000)
    columns = {"t": time, "q1_pos": first, "q2_pos": second, "q3_pos": 0.4 * np.cos(time)}
    file = table(tmp_path / "x.csv", columns)
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) in (0, 1)
    assert {"q1_rad", "q2_rad", "q3_rad"} <= set(load_map(tmp_path / "c.toml"))


@pytest.mark.parametrize("names", [("angle_rad", "torque_nm"), ("pos", "effort"), ("theta", "tau")])
def test_without_a_time_the_rate_is_asked_for(names: tuple[str, str], tmp_path: Path,
                                             shell: Shell) -> None:
    _, angle, torque = joint(tmp_path)
    path = table(tmp_path / "x.csv", dict(zip(names, (angle, torque))), 8)
    assert "give its rate by --rate HZ" in shell.fails("import", path, "--guess --map", tmp_path / "c.toml")


def test_a_counter_of_time_that_wraps_is_told(tmp_path: Path, shell: Shell) -> None:
    time, angle, torque = joint(tmp_path)
    ticks = np.round(1e6 * time + 2.0**32 - 1e6) % 2.0**32
    guess(table(tmp_path / "x.csv", {"time_us": ticks, "pos": angle, "effort": torque}, 8))
    assert "it wraps by 4294967296, first in row" in shell.out


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def mat_objects(path: Path, names: list[str], kind: str) -> Path:
    """A file of MATLAB objects alone, as Simulink leaves it: each a matrix of class opaque with its name inside."""
    plain = io.BytesIO()
    savemat(plain, {"x": np.array([[0xDD000000, 2, 1, 1, 4, 1]], np.uint32)})  # type: ignore[arg-type]
    head, inner = plain.getvalue()[:128], plain.getvalue()[128:]
    body = [element(14, element(6, struct.pack("<II", 17, 0)) + b"".join(
        element(1, text.encode()) for text in (name, "MCOS", kind)) + inner) for name in names]
    path.write_bytes(head + b"".join(body))
    return path


@pytest.mark.parametrize("names, kind, told", [
    (["alpha", "beta_dot"], "timeseries", "alpha, beta_dot are MATLAB timeseries objects"),
    (["run1"], "timetable", "run1 is a MATLAB timetable object"),
    (["q", "u", "tau"], "table", "q, u, tau are MATLAB table objects")])
def test_matlab_objects_alone_are_named_with_the_remedy(names: list[str], kind: str, told: str, tmp_path: Path,
                                                       shell: Shell) -> None:
    path = mat_objects(tmp_path / "o.mat", names, kind)
    said = shell.fails("import", path, "--guess --map", tmp_path / "c.toml")
    assert told in said and "which only MATLAB can read" in said and f"save {names[0]}.Time" in said
