"""`legid excite`: within limits by another simulator, odd, and as informative as it says, by refits."""

from pathlib import Path

import numpy as np
import pytest
from mujoco_leg import Leg, record
from test_model_export import LEG, write_model

from daq.plan import read_plan
from daq.rig import load_rig
from estimator.fit import fit
from estimator.mechanism import leg2
from estimator.options import FitOptions
from experiments.cli import main
from experiments.excite_design import RATE_HZ, TAPER_S, covariance, within_limits
from experiments.model_file import load_model
from experiments.rigs import build_mechanism

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[limits]
torque_nm = 1.5
speed_radps = 12.0
q1_rad = {q1}
q2_rad = 2.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig, and a prior model that is off by some per cent."""
    path = tmp_path_factory.mktemp("excite")
    (path / "rig.toml").write_text(RIG.format(q1=1.0))
    beta = Leg().beta() * (1 + 0.05 * np.random.default_rng(3).standard_normal(9))
    write_model(path / "model.json", list(beta), LEG)
    return path


def excite(folder: Path, name: str, *more: str) -> int:
    return main(["excite", "--rig", str(folder / "rig.toml"), "--model", str(folder / "model.json"), "--out",
                 str(folder / name), "--seconds", "8", "--tries", "12", *more])


@pytest.fixture(scope="module")
def plan(folder: Path) -> np.ndarray:
    assert excite(folder, "plan.csv") == 0
    return read_plan(folder / "plan.csv").torque_nm


def test_the_true_leg_stays_within_the_limits(plan: np.ndarray) -> None:
    """The true leg is not the prior; the margin of a fifth is there for that."""
    run = record(Leg(), np.random.default_rng(0), seconds=8.0, tau=plan, hold="zero", gyro=0.0)
    assert np.abs(plan).max() <= 0.8 * 1.5
    assert np.abs(run["q1_rad"]).max() < 1.0 and np.abs(run["q2_rad"]).max() < 2.0
    assert np.abs(run["gyro_radps"]).max() < 12.0
    assert np.abs(np.diff(run["q2_rad"])).max() * 100 < 12.0
    assert np.ptp(run["q2_rad"]) > 0.5  # it is no plan that avoids the limits by doing nothing


def test_only_odd_harmonics(plan: np.ndarray) -> None:
    """A sum of odd harmonics of one period changes sign after half of it; the tapered ends do not count."""
    half, edge = plan.size // 2, round(TAPER_S * RATE_HZ) + 1
    first, second = plan[edge: half - edge], plan[half + edge: 2 * half - edge]
    np.testing.assert_allclose(second, -first, atol=1e-6)
    assert plan[0] == plan[-1] == 0.0


def test_condition_numbers_are_printed_and_seeds_are_realisations(folder: Path,
                                                                  capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed in (("a.csv", "1"), ("b.csv", "1"), ("c.csv", "2")):
        assert excite(folder, name, "--tries", "4", "--seed", seed) == 0
    out = capsys.readouterr().out
    assert out.count("condition number before") == 3
    texts = [(folder / f"{name}.csv").read_text() for name in "abc"]
    assert texts[0] == texts[1] != texts[2]


def test_refits_agree_with_what_is_predicted(folder: Path, plan: np.ndarray) -> None:
    """Real fits on MuJoCo's data, with the plan and with a sine of the same length and limits."""
    model, rig = load_model(folder / "model.json"), load_rig(folder / "rig.toml")
    mechanism = build_mechanism(model.mechanism)
    t = np.arange(plan.size) / RATE_HZ
    sine = within_limits(model, mechanism, np.sin(2 * np.pi * 0.5 * t), rig.limits, 0.8)
    assert sine is not None
    log_det = []
    for tau in (sine.torque_nm, plan):
        run = record(Leg(), np.random.default_rng(7), seconds=8.0, tau=tau, hold="zero")
        found = fit([run], leg2(lever_arm=0.2), FitOptions(sensors="imu", hold="zero"))
        log_det.append(np.linalg.slogdet(found.covariance)[1])
    assert log_det[1] < log_det[0]
    predicted = covariance(model, mechanism, plan)
    assert predicted is not None
    ratio = np.sqrt(np.diag(predicted) / np.diag(found.covariance))
    assert ratio.min() > 0.5 and ratio.max() < 2.0, ratio


def test_one_joint(tmp_path: Path) -> None:
    write_model(tmp_path / "model.json", [0.02, 0.1, 0.03, 0.01], {"model": "joint1", "actuated": (1,)})
    (tmp_path / "rig.toml").write_text(RIG.format(q1=1.0).replace("leg2", "joint1").replace("[2]", "[1]"))
    assert excite(tmp_path, "plan.csv", "--tries", "2") == 0
    assert 0 < read_plan(tmp_path / "plan.csv").peak_nm <= 0.8 * 1.5


def test_what_cannot_be_is_one_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert excite(folder, "x.csv", "--high", "0.2") == 2
    assert excite(folder, "x.csv", "--margin", "2") == 2
    assert excite(folder, "x.csv", "--seed", "-1") == 2
    write_model(tmp_path / "model.json", [0.02, 0.1, 0.03, 0.01], {"model": "joint1", "actuated": (1,)})
    (tmp_path / "rig.toml").write_text(RIG.format(q1=1.0))
    assert excite(tmp_path, "x.csv") == 2
    (tmp_path / "model.json").write_bytes((folder / "model.json").read_bytes())
    (tmp_path / "rig.toml").write_text(RIG.format(q1=1e-6))
    assert excite(tmp_path, "x.csv", "--tries", "1") == 1
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 5
    assert "odd harmonics" in errors[0] and "give a model of this rig" in errors[3] and "widen [limits]" in errors[4]
    assert not (folder / "x.csv").exists() and not (tmp_path / "x.csv").exists()


def test_a_first_plan_needs_no_model_and_is_gentle(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = ["excite", "--rig", str(folder / "rig.toml"), "--out", str(folder / "first.csv")]
    assert main([*start, "--seconds", "8"]) == 0
    first = read_plan(folder / "first.csv")
    assert first.peak_nm == pytest.approx(0.1 * 1.5) and first.duration_s == pytest.approx(8.0)
    assert main([*start, "--seconds", "8", "--peak", "0.7", "--seed", "1"]) == 0
    second = read_plan(folder / "first.csv").torque_nm
    assert np.abs(second).max() == pytest.approx(0.7) and not np.allclose(second / 0.7, first.torque_nm / 0.15)
    assert main([*start, "--peak", "2"]) == 2
    assert main([*start, "--peak", "1", "--model", str(folder / "model.json")]) == 2
    assert main([*start, "--seconds", "3"]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 3 and "limit of 1.5 N m" in errors[0] and "leave out --peak" in errors[1]
