"""Files that do not say all: what import asks for, and what it refuses to guess."""

from pathlib import Path

import numpy as np
import pytest

from experiments.exchange.binary import read_mat, read_parquet
from tests.support.free_swing import swing
from tests.support.imported_files import guess, imported, pendulum, rows_of, table
from tests.support.mujoco_leg import Leg
from tests.support.shell import Shell


def free_chain() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times and angles of two links that swing freely."""
    leg = Leg(viscous=(0.002, 0.0015), coulomb=(0.01, 0.004))
    run = swing(leg, np.random.default_rng(0), (1.4, -1.0), seconds=15.0)
    return run.time_s, run["q1_rad"], run["q2_rad"]


@pytest.mark.parametrize("unit", [1.0, 180.0 / np.pi])
def test_two_angles_without_a_torque_are_a_free_chain(unit: float, tmp_path: Path,
                                                      shell: Shell) -> None:
    t, q1, q2 = free_chain()
    file = table(tmp_path / "x.csv", {"time": t, "theta1": unit * q1, "theta2": unit * q2, "u": 0.1 * np.sin(t)})
    assert {name: (c.name, c.unit, c.sign) for name, c in guess(file).items() if name != "time_s"} == {
        "q1_rad": ("theta1", "deg" if unit > 1.0 else "", 1), "q2_rad": ("theta2", "deg" if unit > 1.0 else "", 1)}
    err = shell.err
    assert "actuated = []" in err and "'u' may drive a joint" in err


@pytest.mark.parametrize("unit", [1.0, 180.0 / np.pi, 1000.0])
def test_a_joint_that_a_nameless_column_drives_is_no_free_swing(unit: float, tmp_path: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    found = guess(table(tmp_path / "x.csv", {"t": t, "theta": unit * q, "u": 40.0 * tau}), status=1)
    assert found["q1_rad"].name == "theta" and "tau1_nm" not in found
    assert "NOT KNOWN: no column is known to be its torque" in (tmp_path / "x.toml").read_text()
    assert "'u' may drive a joint" in shell.err and "swing freely" not in shell.err


def test_forces_are_no_angles_and_a_wrench_is_asked_for(tmp_path: Path, shell: Shell) -> None:
    t, q1, q2 = free_chain()
    axes = {f"/base/wrench/{name}": np.sin(t + k) for k, name in enumerate(
        f"{kind}/{axis}" for kind in ("force", "torque") for axis in "xyz")}
    file = table(tmp_path / "x.csv", {"time": t, "shoulder_position": q1, "elbow_position": q2, **axes})
    found = guess(file, status=1)
    assert [found[name].name for name in ("q1_rad", "q2_rad")] == ["shoulder_position", "elbow_position"]
    assert len(found) == 3 and "no name says which of them is the torque of which joint" in shell.err


def test_efforts_of_unwritten_memory_are_no_torque(here: Path, shell: Shell) -> None:
    t, q, _ = pendulum()
    lines = "".join(f"{a:.3f},{b:.6f},{-5.38e-310 * (k % 5)!r}\n" for k, (a, b) in enumerate(zip(t, q)))
    (here / "x.csv").write_text("time,position,effort\n" + lines)
    assert "'effort' holds no torque" in shell.fails("import x.csv --guess --map c.toml")


@pytest.mark.parametrize("unit", ["A", "mA", "counts"])
def test_amperes_need_a_scale(unit: str, here: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    table(here / "x.csv", {"t": t, "q": q, "i": tau})
    base = ('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "q"\n'
            f'[columns.tau1_nm]\nname = "i"\nunit = "{unit}"\n')
    (here / "m.toml").write_text(base)
    command = "import x.csv --map m.toml --out out"
    assert f"is in {unit} and has no scale; give scale, the torque at the joint per {unit}" in shell.fails(command)
    (here / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n' + base)
    assert "has no scale" in shell.fails("fit x.csv --rig rig.toml")
    (here / "m.toml").write_text(base + "scale = 0.05\n")
    shell(command)


def test_a_rate_stands_for_times_in_a_guess(here: Path, shell: Shell) -> None:
    _, q, tau = pendulum()
    file = table(here / "x.csv", {"position": q, "torque": tau})
    assert "time_s" not in guess(file, "--rate 100") and "--rate 100" in shell.out
    shell("import x.csv --map x.toml --rate 100 --out out")


def test_a_wrapped_angle_is_unwrapped_before_the_guess(tmp_path: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    file = table(tmp_path / "x.csv", {"t": t, "angle_deg": np.degrees(q) % 360.0, "torque": tau})
    run = rows_of(imported(file))
    assert "a wrapped angle. Unwrapped" in shell.err and np.ptp(run[:, 1] - q) < 1e-6


def test_lists_in_parquet_are_columns(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    state = np.random.default_rng(1).normal(size=(40, 3)).astype(np.float32)
    fixed = pa.FixedSizeListArray.from_arrays(pa.array(state.ravel()), 3)
    parquet.write_table(pa.table({"timestamp": np.arange(40) * 0.02, "observation.state": fixed,
                                  "action": pa.array(state.tolist()), "task": ["lift"] * 40}), tmp_path / "e.parquet")
    found = read_parquet(tmp_path / "e.parquet")
    lists = [f"{name}[{k}]" for name in ("observation.state", "action") for k in (1, 2, 3)]
    assert found.names == ["timestamp", *lists]
    np.testing.assert_allclose(found.table_of("observation.state[2]").columns["observation.state[2]"], state[:, 1])
    assert found.left_out == {"task": "holds string, no column of numbers"}


def test_objects_of_matlab_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scipy.io.matlab import MatlabOpaque

    kind = [(field, object) for field in ("s0", "s1", "s2", "arr")]
    held = np.array([(b"Theta1", b"MCOS", b"timeseries", np.zeros((6, 1), np.uint32))], dtype=kind)
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: {"tout": np.arange(60.0), "None": MatlabOpaque(held)})
    found = read_mat(tmp_path / "x.mat")
    assert found.names == ["tout"]
    assert found.left_out == {"Theta1": "is a MATLAB timeseries object, which only MATLAB can read: save "
                                        "struct(Theta1) or Theta1.Data instead"}


def test_a_file_of_another_program_is_sent_to_import(here: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    (here / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n')
    table(here / "x.csv", {"stamp": t, "winkel": q, "moment": tau})
    said = shell.fails("fit x.csv --rig rig.toml")
    assert "run: legid import x.csv --map columns.toml --guess" in said
