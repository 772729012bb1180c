"""The guess for a walker: units, signs, absolute angles, which angle is the torso's; chains stay chains."""

from pathlib import Path

import numpy as np
import pytest

from daq import Dataset
from experiments.cli import main
from experiments.exchange.column_map import load_map
from experiments.models import load_model
from tests.support.mujoco_tree import disturbed, move, random_tree, torques
from tests.support.walker_plant import RIG, Gait, Plant, Walker, random_walker, record, walk

NAMED = ["torso_pitch", "left_hip_pos", "right_hip_pos", "left_hip_torque", "right_hip_torque"]
LAST = ["q1", "q2", "q3", "tau1", "tau2"]
"""The angle without a motor is the torso's, wherever it stands."""


@pytest.fixture(scope="module")
def walked() -> list[Dataset]:
    """Two bodies, 100 and 200 Hz, by a plant that shares nothing with the estimator."""
    out = []
    for seed, body, rate in ((2, Walker(), 100.0), (6, random_walker(np.random.default_rng(6)), 200.0)):
        rng = np.random.default_rng(seed)
        out.append(record("walk.csv", walk(Plant(body), Gait(), 10, rng, rate, round(400 / rate)), rng, stance=False))
    return out


def write(path: Path, data: Dataset, names: list[str], *, unit: float = 1.0, signs: tuple[int, ...] = (1, 1, 1),
          works: tuple[int, int] = (1, 1), absolute: bool = False, last: bool = False) -> Path:
    """The record as another program logs it; the torso's angle first, or `last`."""
    q = np.stack([data[f"q{k}_rad"] for k in (1, 2, 3)], axis=1)
    if absolute:
        q[:, 1:] = q[:, :1] - q[:, 1:]
    q = (q * signs / unit)[:, [1, 2, 0] if last else [0, 1, 2]]
    tau = np.stack([data["tau2_nm"], data["tau3_nm"]], axis=1) * works
    np.savetxt(path, np.column_stack([data.time_s, q, tau]), delimiter=",", comments="", fmt="%.9g",
               header=",".join(["time", *names]))
    return path


@pytest.mark.parametrize(("unit", "written", "signs", "works"), [
    (1.0, "", (1, 1, 1), (1, 1)),
    (np.pi / 180, "deg", (1, -1, 1), (-1, 1)),
    (1e-3, "mrad", (-1, -1, -1), (-1, -1)),
    (2 * np.pi, "turn", (-1, 1, 1), (1, -1)),
])
@pytest.mark.parametrize("which", [0, 1])
def test_units_and_signs_of_a_walker(walked: list[Dataset], which: int, unit: float, written: str,
                                     signs: tuple[int, ...], works: tuple[int, int], tmp_path: Path,
                                     capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "x.csv", walked[which], NAMED, unit=unit, signs=signs, works=works)
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) == 0
    found = load_map(tmp_path / "c.toml")
    for k in range(3):
        angle = found[f"q{k + 1}_rad"]
        assert (angle.name, angle.unit, angle.sign) == (NAMED[k], written, signs[k])
    assert [(found[f"tau{k}_nm"].name, found[f"tau{k}_nm"].sign) for k in (2, 3)] == list(zip(NAMED[3:], works))
    said = capsys.readouterr().out
    assert "a walker's torso: the rates of all joints jump 9 times" in said
    assert "which leg is the left one does not show" in said


@pytest.mark.parametrize("sign", [1, -1])
def test_absolute_angles_and_a_torso_that_comes_last(walked: list[Dataset], sign: int, tmp_path: Path) -> None:
    file = write(tmp_path / "x.csv", walked[0], LAST, signs=(sign,) * 3, absolute=True, last=True)
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) == 0
    found = load_map(tmp_path / "c.toml")
    assert [(found[f"q{k}_rad"].name, found[f"q{k}_rad"].sign) for k in (1, 2, 3)] == [
        ("q3", sign), ("'q1' - 'q3'", -sign), ("'q2' - 'q3'", -sign)]
    assert [found[f"tau{k}_nm"].name for k in (2, 3)] == ["tau1", "tau2"]


def test_a_walker_s_file_goes_to_a_fit(walked: list[Dataset], tmp_path: Path) -> None:
    """Backwards, in degrees, with a sensor of the torso's own and a contact's force."""
    file = write(tmp_path / "x.csv", walked[0], NAMED, unit=np.pi / 180, signs=(-1, 1, -1), works=(1, -1))
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    gyro = np.gradient(table[:, 1], table[:, 0])
    np.savetxt(file, np.column_stack([table, gyro, 100.0 * (table[:, 2] > table[:, 3])]), delimiter=",", comments="",
               header=",".join(["time", *NAMED, "gyro_y", "left_contact_force"]), fmt="%.9g")
    (tmp_path / "rig.toml").write_text(RIG)
    assert main(["import", str(file), "--yes", "--out", str(tmp_path / "runs")]) == 0
    out = tmp_path / "model.json"
    assert main(["fit", str(tmp_path / "runs" / "x.csv"), "--rig", str(tmp_path / "rig.toml"), "--model-out",
                 str(out)]) == 0
    found = [p.value for p in load_model(out).parameters]
    np.testing.assert_allclose(found, Walker().beta, rtol=0.1)


def test_torques_of_another_machine_are_no_walker_s(walked: list[Dataset], tmp_path: Path,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "x.csv", walked[0], NAMED)
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[:, 4:] = np.random.default_rng(2).normal(size=(len(table), 2)).cumsum(axis=0)
    np.savetxt(file, table, delimiter=",", comments="", header=",".join(["time", *NAMED]))
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) == 1
    said = capsys.readouterr().err
    assert "explain the torques" in said and "no walker either" in said


@pytest.mark.parametrize("seed", range(3))
def test_a_chain_is_no_walker(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three joints by MuJoCo, the first one without a motor, with names that would do for a walker."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, (-1, 0, 1))
    run = disturbed(move(tree, torques(tree, rng, 12.0, 100.0, 0.5, (1, 2)), 100.0), (1, 2), 100.0, rng)
    file = write(tmp_path / "x.csv", run, NAMED, signs=(1, -1, 1))
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) == 0
    found = load_map(tmp_path / "c.toml")
    assert [found[f"q{k}_rad"].sign for k in (1, 2, 3)] == [1, -1, 1]
    assert "a walker" not in "".join(capsys.readouterr())
