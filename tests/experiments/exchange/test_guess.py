"""The guess of a map: units, signs and joints of a chain and of one joint, and columns that are one angle again."""

import io
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from daq.runs import read_csv
from experiments.exchange import apply_map, load_map, read_imported
from experiments.exchange.guess_names import of_joints
from experiments.exchange.guess_physics import find_imu
from experiments.models import load_model
from legid.cli import main
from tests.support.driven_joint import record
from tests.support.imported_files import guess, imported, rows_of, table
from tests.support.motions import pendulum
from tests.support.mujoco_leg import random_leg
from tests.support.mujoco_leg import record as mujoco_record
from tests.support.mujoco_tree import disturbed, move, random_tree, torques
from tests.support.shell import Shell, typed


def chain_log(path: Path, names: list[str], *, links: int = 3, unit: float = 1.0, signs: tuple[int, ...] = (1, 1, 1),
           works: tuple[int, ...] = (1, 1, 1), absolute: bool = False, tilt: float = 0.0, seed: int = 3) -> Path:
    """A chain that MuJoCo moves for 12 s at 100 Hz, all joints driven, as another program logs it."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, tuple(range(-1, links - 1)))
    run = disturbed(move(tree, torques(tree, rng, 12.0, 100.0, 0.5, range(links)), 100.0), range(links), 100.0, rng)
    q = np.stack([run[f"q{k + 1}_rad"] for k in range(links)], axis=1) * np.array(signs[:links])
    q = (np.cumsum(q, axis=1) if absolute else q) + np.eye(links)[0] * tilt
    tau = np.stack([run[f"tau{k + 1}_nm"] for k in range(links)], axis=1) * np.array(works[:links])
    return table(path, dict(zip(["time", *names], [np.arange(len(run)) / 100.0, *(q / unit).T, *tau.T])), 9)


NAMED = ["hip_pos", "knee_pos", "ankle_pos", "hip_effort", "knee_effort", "ankle_effort"]
NUMBERED = ["q1", "q2", "q3", "tau1", "tau2", "tau3"]


@pytest.mark.parametrize("names, unit, written, signs, works", [
    (NAMED, 1.0, "", (1, 1, 1), (1, 1, 1)),
    (NUMBERED, np.pi / 180, "deg", (1, -1, 1), (1, 1, -1)),
    (NUMBERED, 2 * np.pi, "turn", (1, -1, -1), (-1, -1, -1)),
])
def test_units_and_signs_of_a_chain(names: list[str], unit: float, written: str, signs: tuple[int, ...],
                                    works: tuple[int, ...], tmp_path: Path) -> None:
    found = guess(chain_log(tmp_path / "x.csv", names, unit=unit, signs=signs, works=works))
    for k in range(3):
        angle, torque = found[f"q{k + 1}_rad"], found[f"tau{k + 1}_nm"]
        assert (angle.name, angle.unit, angle.sign) == (names[k], written, signs[k])
        assert (torque.name, torque.sign) == (names[3 + k], works[k])


def test_a_chain_s_record_that_is_too_short_is_not_known(tmp_path: Path, shell: Shell) -> None:
    rows = rows_of(chain_log(tmp_path / "x.csv", NUMBERED))[:60]
    rows[25:55, -1] = np.nan
    found = guess(table(tmp_path / "y.csv", dict(zip(["time", *NUMBERED], rows.T))), status=1)
    assert set(found) == {"time_s", *(f"{name}_rad" for name in ("q1", "q2", "q3")), "tau1_nm", "tau2_nm", "tau3_nm"}
    assert "the record is too short to show unit and sign of 'q1', 'q2', 'q3'" in shell.err


def test_a_hand_that_holds_for_a_second_hides_no_unit(tmp_path: Path) -> None:
    """It pushes with ten times the torque, which no column has."""
    time, angle, torque = rows_of(record(tmp_path / "x.csv")).T
    torque[300:400] += 10.0 * np.std(torque)
    found = guess(table(tmp_path / "y.csv", {"time": time, "pos": np.rad2deg(angle), "effort": -torque}))
    assert (found["q1_rad"].unit, found["tau1_nm"].sign) == ("deg", -1)


@pytest.mark.parametrize("seed", range(4))
def test_an_imu_that_swings_far_is_read_as_it_stands(seed: int) -> None:
    leg = random_leg(np.random.default_rng(seed))
    run = mujoco_record(leg, seed, seconds=10.0, amplitude=2.0, high=2.0)
    accel = {name: run[f"accel_{name}_mps2"] for name in ("x", "y")}
    found = find_imu(run.rate_hz, {"g": run["gyro_radps"]}, accel, 9.81)
    assert not found.unexplained and not found.warnings
    assert [(column.name, column.unit, column.sign) for column in found.columns.values()] == [
        ("g", "", 1), ("x", "", 1), ("y", "", 1)]
    lever = float(found.notes["accel_x_mps2"].split()[-2])
    assert lever == pytest.approx(leg.lever, abs=0.005)


def test_absolute_angles_become_relative_ones(tmp_path: Path) -> None:
    file = chain_log(tmp_path / "x.csv", NUMBERED, absolute=True)
    found = guess(file)
    assert [(found[f"q{k}_rad"].name, found[f"q{k}_rad"].minus) for k in (1, 2, 3)] == [
        ("q1", ""), ("q2", "q1"), ("q3", "q2")]
    relative = rows_of(chain_log(tmp_path / "y.csv", NUMBERED))
    run = apply_map(read_imported(file), found)
    for k in (1, 2, 3):
        kept = np.isfinite(run[f"q{k}_rad"])
        assert kept.mean() > 0.95
        np.testing.assert_allclose(run[f"q{k}_rad"][kept], relative[kept, k], atol=1e-6)


def test_commands_and_sums_of_angles_are_no_joints(tmp_path: Path) -> None:
    """What brachiating robots log: a second arm's absolute angle, an IMU's mean angle, torques before their limit."""
    names = ["arm1_pos", "tail_pos", "phi_pos", "tail_tau", "phi_tau"]
    file = chain_log(tmp_path / "x.csv", [*names[:3], "arm1_tau", *names[3:]])
    t, q1, q2, q3, _, tau2, tau3 = rows_of(file).T
    sums = {"arm2_pos": q2 + q3, "raw_imu_pos": 0.99 * q1 + 0.01 * np.cos(t), "tail_clipped_tau": 0.9 * tau2}
    table(file, dict(zip(["time", *names], [t, q1, q2, q3, tau2, tau3])) | sums, 15)
    main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")])
    found = load_map(tmp_path / "c.toml")
    assert sorted(found) == ["q1_rad", "q2_rad", "q3_rad", "tau2_nm", "tau3_nm", "time_s"]
    assert [found[name].name for name in ("tau2_nm", "tau3_nm")] == ["tail_tau", "phi_tau"]
    assert not {"arm2_pos", "raw_imu_pos"} & {column.name for column in found.values()}


def test_two_driven_joints_go_to_a_fit(here: Path) -> None:
    file = chain_log(here / "x.csv", ["q1", "q2", "tau1", "tau2"], links=2, unit=np.pi / 180)
    (here / "rig.toml").write_text('[mechanism]\nmodel = "leg2"\nactuated = [1, 2]\n')
    typed("fit", imported(file), "--rig rig.toml")


def test_a_zero_that_does_not_hang_is_reported(tmp_path: Path, shell: Shell) -> None:
    guess(chain_log(tmp_path / "x.csv", NUMBERED, tilt=1.5708))
    assert "joint 1 hangs at 1.57 rad, not at 0: set offset = -1.57" in shell.err


def test_torques_of_another_machine_are_not_explained(tmp_path: Path, shell: Shell) -> None:
    file = chain_log(tmp_path / "x.csv", NUMBERED)
    rows = rows_of(file)
    rows[:, 4:] = np.random.default_rng(2).normal(size=(len(rows), 3)).cumsum(axis=0)
    found = guess(table(file, dict(zip(["time", *NUMBERED], rows.T))), status=1)
    assert "explain the torques" in shell.err
    assert all(found[f"q{k}_rad"].name == f"q{k}" and not found[f"q{k}_rad"].unit for k in (1, 2, 3))


@pytest.mark.parametrize("angles, torques_, joints", [
    (["shoulder_meas_pos", "elbow_meas_pos"], ["elbow_meas_effort", "shoulder_meas_effort"], [1, 0]),
    (["q1", "q2", "q3"], ["tau2", "tau3"], [1, 2]),
    (["position[0]", "position[1]"], ["effort[0]", "effort[1]"], [0, 1]),
])
def test_a_torque_s_joint_shows_in_its_name(angles: list[str], torques_: list[str], joints: list[int]) -> None:
    assert of_joints(angles, torques_) == dict(zip(joints, torques_))


JOINT = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


@pytest.mark.parametrize("names", [("pos", "effort"), ("joint_angle", "torque"), ("hip", "tau")])
@pytest.mark.parametrize("unit, written", [(1.0, ""), (np.pi / 180, "deg"), (2 * np.pi, "turn")])
@pytest.mark.parametrize("sign", [1, -1])
def test_gravity_shows_the_unit_and_inertia_the_sign(names: tuple[str, str], unit: float, written: str, sign: int,
                                                     tmp_path: Path) -> None:
    found = guess(record(tmp_path / "x.csv", names, unit, sign, 1.0))
    angle, torque = found["q1_rad"], found["tau1_nm"]
    assert (angle.name, angle.unit, torque.name, torque.sign) == (names[0], written, names[1], sign)


def test_a_joint_s_file_goes_to_a_fit(here: Path) -> None:
    file = record(here / "x.csv", unit=np.pi / 180, sign=-1)
    (here / "rig.toml").write_text(JOINT)
    typed("fit", imported(file), "--rig rig.toml")


def test_without_gravity_the_unit_is_said_not_to_show(tmp_path: Path, shell: Shell) -> None:
    assert guess(record(tmp_path / "x.csv", gravity=0.0))["q1_rad"].unit == ""
    assert "unit and signs are a close call: (rad," in shell.err


def test_a_torque_of_another_machine_is_not_explained(tmp_path: Path, shell: Shell) -> None:
    file = record(tmp_path / "x.csv")
    time, angle, _ = rows_of(file).T
    torque = np.random.default_rng(2).normal(size=len(time)).cumsum()
    guess(table(file, {"time": time, "pos": angle, "effort": torque}), status=1)
    assert "explain the torque 'effort'" in shell.err


@pytest.mark.parametrize("unit, written", [(1.0, ""), (np.pi / 180, "deg")])
def test_a_pendulum_that_swings_freely_goes_to_a_fit(unit: float, written: str, here: Path,
                                                        shell: Shell) -> None:
    """No torque in the file: gravity still shows the unit, and one known number gives the scale."""
    t, noise = np.arange(2000) * 0.01, np.random.default_rng(1).normal(0.0, 5e-4, 2000)
    angle = pendulum(t, lambda _: 0.0, 2.5, 0.0, (0.08, 0.0), 9.81 * 0.02 / 0.005)
    table(here / "swing.csv", {"t": t, "theta": (angle + noise) / unit})
    (here / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = []\n')
    shell("import swing.csv --out runs --yes")
    found = load_map(here / "runs/columns.toml")
    assert set(found) == {"time_s", "q1_rad"} and found["q1_rad"].unit == written
    assert "% of the acceleration" in shell.out
    shell("fit runs/swing.csv --rig rig.toml --fix beta2=0.02 --model-out model.json")
    assert load_model(here / "model.json").parameters[0].value == pytest.approx(0.005, rel=0.01)


def test_a_table_without_a_header_is_said_to_have_none(here: Path, shell: Shell) -> None:
    file = record(here / "x.csv")
    file.write_text("\n".join(file.read_text().splitlines()[1:]))
    said = shell.fails("import x.csv --guess --map c.toml")
    assert "has no header line: its 3 columns have no names" in said


def test_seconds_of_a_record_are_imported_alone(here: Path, shell: Shell) -> None:
    """A hand holds the pendulum before it is let go."""
    record(here / "x.csv")
    shell("import x.csv --out runs --yes --span 5,9")
    time_s = read_csv(here / "runs/x.csv").time_s
    assert (time_s[0], time_s[-1]) == (pytest.approx(5.0), pytest.approx(8.995))
    shell.read()
    for wanted, said in (("50,66", "no sample between 50 and 66 s; it goes from 0 to 14.995 s"),
                         ("9,5", "'9,5' is not FROM,TO in seconds"), ("5", "is not FROM,TO")):
        assert said in shell.fails("import x.csv --map runs/columns.toml --out runs --span", wanted)


def test_a_span_of_a_record_by_the_calendar_is_said_to_the_millisecond(
        here: Path, shell: Shell) -> None:
    (here / "x.csv").write_text("t,a\n" + "".join(f"{1.7e9 + k / 100:.2f},{k / 100:.2f}\n" for k in range(100)))
    (here / "c.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    call = "import x.csv --map c.toml --out runs --span"
    assert "it goes from 1700000000 to 1700000000.99 s" in shell.fails(call, "0,1")
    shell(call, "1700000000.1,1700000000.8")


def test_a_file_without_times_needs_a_rate(here: Path, shell: Shell) -> None:
    (here / "x.json").write_text(json.dumps({"rate": 50, "data": {"angles": [k / 100 for k in range(100)]}}))
    (here / "c.toml").write_text('[columns.q1_rad]\nname = "data.angles"\n')
    call = "import x.json --map c.toml --out runs"
    assert "has no times" in (said := shell.fails(call)) and "--rate" in said
    shell(call, "--rate 50")
    run = read_csv(here / "runs/x.csv")
    assert np.diff(run.time_s) == pytest.approx(0.02) and run.columns["q1_rad"] == pytest.approx(np.arange(100) / 100)


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
    time, angle, torque = rows_of(record(tmp_path / "j.csv")).T
    found = guess(table(tmp_path / "x.csv", {"t": time, name: make(angle), "joint_angle": angle, "torque": torque}, 8))
    said = shell.err
    assert f"{name!r} is {told}" in said and "correlation" in said
    assert found["q1_rad"].name == "joint_angle" and not {"q2_rad", "q3_rad"} & set(found)


def test_two_joints_that_move_alike_are_two(tmp_path: Path) -> None:
    time = np.arange(1000) / 100.0
    first = 0.5 * np.sin(3.0 * time)
    second = 0.5 * np.sin(3.0 * time - 0.01) + 1e-3 * np.random.default_rng(1).normal(size=1000)
    file = table(tmp_path / "x.csv", {"t": time, "q1_pos": first, "q2_pos": second, "q3_pos": 0.4 * np.cos(time)})
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) in (0, 1)
    assert {"q1_rad", "q2_rad", "q3_rad"} <= set(load_map(tmp_path / "c.toml"))


@pytest.mark.parametrize("names", [("angle_rad", "torque_nm"), ("pos", "effort"), ("theta", "tau")])
def test_without_a_time_the_rate_is_asked_for(names: tuple[str, str], here: Path,
                                             shell: Shell) -> None:
    _, angle, torque = rows_of(record(here / "j.csv")).T
    table(here / "x.csv", dict(zip(names, (angle, torque))), 8)
    assert "give its rate by --rate HZ" in shell.fails("import x.csv --guess --map c.toml")


def test_a_counter_of_time_that_wraps_is_told(tmp_path: Path, shell: Shell) -> None:
    time, angle, torque = rows_of(record(tmp_path / "j.csv")).T
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
def test_matlab_objects_alone_are_named_with_the_remedy(names: list[str], kind: str, told: str, here: Path,
                                                       shell: Shell) -> None:
    mat_objects(here / "o.mat", names, kind)
    said = shell.fails("import o.mat --guess --map c.toml")
    assert told in said and "which only MATLAB can read" in said and f"save {names[0]}.Time" in said
