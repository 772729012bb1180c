"""Files that do not say all: what import asks for, and what it refuses to guess."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from experiments.exchange.binary import read_mat, read_parquet
from tests.support.imported_files import guess, pendulum, table
from tests.support.shell import Shell


def double_pendulum() -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and relative angles (n, 2) of two point masses that swing freely."""
    rng = np.random.default_rng(0)
    grid = np.arange(1500) * 0.01

    def rates(_: float, y: np.ndarray) -> list[float]:
        a, b, va, vb = y
        mass = np.array([[0.4, 0.06 * np.cos(a - b)], [0.06 * np.cos(a - b), 0.03]])
        load = np.array([-0.06 * np.sin(a - b) * vb**2 - 9.81 * 0.8 * np.sin(a) - 0.02 * va,
                         0.06 * np.sin(a - b) * va**2 - 9.81 * 0.15 * np.sin(b) - 0.003 * (vb - va)])
        return [va, vb, *np.linalg.solve(mass, load)]

    y = solve_ivp(rates, (0.0, grid[-1]), [1.4, 0.4, 0.0, 0.0], t_eval=grid, rtol=1e-8).y
    return grid, np.column_stack([y[0], y[1] - y[0]]) + 3e-4 * rng.normal(size=(grid.size, 2))


@pytest.mark.parametrize("unit", [1.0, 180.0 / np.pi])
def test_two_angles_without_a_torque_are_a_free_chain(unit: float, tmp_path: Path,
                                                      shell: Shell) -> None:
    t, q = double_pendulum()
    file = table(tmp_path / "x.csv", {"time": t, "theta1": unit * q[:, 0], "theta2": unit * q[:, 1],
                                        "u": 0.1 * np.sin(t)})
    assert {name: (c.name, c.unit, c.sign) for name, c in guess(file).items() if name != "time_s"} == {
        "q1_rad": ("theta1", "deg" if unit > 1.0 else "", 1), "q2_rad": ("theta2", "deg" if unit > 1.0 else "", 1)}
    err = shell.err
    assert "actuated = []" in err and "'u' may drive a joint" in err


def test_forces_are_no_angles_and_a_wrench_is_asked_for(tmp_path: Path, shell: Shell) -> None:
    t, q = double_pendulum()
    axes = {f"/base/wrench/{name}": np.sin(t + k) for k, name in enumerate(
        f"{kind}/{axis}" for kind in ("force", "torque") for axis in "xyz")}
    file = table(tmp_path / "x.csv", {"time": t, "shoulder_position": q[:, 0], "elbow_position": q[:, 1], **axes})
    found = guess(file, status=1)
    assert [found[name].name for name in ("q1_rad", "q2_rad")] == ["shoulder_position", "elbow_position"]
    assert len(found) == 3 and "no name says which of them is the torque of which joint" in shell.err


def test_efforts_of_unwritten_memory_are_no_torque(tmp_path: Path, shell: Shell) -> None:
    t, q, _ = pendulum()
    lines = "".join(f"{a:.3f},{b:.6f},{-5.38e-310 * (k % 5)!r}\n" for k, (a, b) in enumerate(zip(t, q)))
    (tmp_path / "x.csv").write_text("time,position,effort\n" + lines)
    assert "'effort' holds no torque" in shell.fails("import", tmp_path / "x.csv", "--guess --map", tmp_path / "c.toml")


@pytest.mark.parametrize("unit", ["A", "mA", "counts"])
def test_amperes_need_a_scale(unit: str, tmp_path: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    file = table(tmp_path / "x.csv", {"t": t, "q": q, "i": tau})
    text = '[columns.{}]\nname = "{}"\n'
    base = text.format("time_s", "t") + text.format("q1_rad", "q") + text.format("tau1_nm", "i") + f'unit = "{unit}"\n'
    (tmp_path / "m.toml").write_text(base)
    command = "import", file, "--map", tmp_path / "m.toml", "--out", tmp_path / "out"
    assert f"is in {unit} and has no scale; give scale, the torque at the joint per {unit}" in shell.fails(*command)
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n' + base)
    assert "has no scale" in shell.fails("fit", file, "--rig", tmp_path / "rig.toml")
    (tmp_path / "m.toml").write_text(base + "scale = 0.05\n")
    shell(*command)


def test_a_rate_stands_for_times_in_a_guess(tmp_path: Path, shell: Shell) -> None:
    _, q, tau = pendulum()
    file = table(tmp_path / "x.csv", {"position": q, "torque": tau})
    assert "time_s" not in guess(file, "--rate 100") and "--rate 100" in shell.out
    shell("import", file, "--map", tmp_path / "x.toml", "--rate 100 --out", tmp_path / "out")


def test_a_wrapped_angle_is_unwrapped_before_the_guess(tmp_path: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    file = table(tmp_path / "x.csv", {"t": t, "angle_deg": np.degrees(q) % 360.0, "torque": tau})
    guess(file)
    shell("import", file, "--map", tmp_path / "x.toml", "--out", tmp_path / "out")
    assert "a wrapped angle. Unwrapped" in shell.err
    run = np.loadtxt(tmp_path / "out" / "x.csv", delimiter=",", skiprows=1)
    assert np.ptp(run[:, 1] - q) < 1e-6


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


def test_a_file_of_another_program_is_sent_to_import(tmp_path: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n')
    file = table(tmp_path / "x.csv", {"stamp": t, "winkel": q, "moment": tau})
    said = shell.fails("fit", file, "--rig", tmp_path / "rig.toml")
    assert f"run: legid import {file} --map columns.toml --guess" in said
