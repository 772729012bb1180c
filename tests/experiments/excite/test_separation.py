"""`legid excite --separate`: rivals apart sooner than by the default design, by a known ratio, within limits."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import load_rig
from daq.recording import read_plan
from experiments.cli import main
from experiments.excite import Band, Bench, Search, contest_of, design, question_of, separate, widening_bands
from experiments.excite.optimal_design import Series
from experiments.excite.separation import Contest, expected_ratios, settling_seconds
from experiments.models import load_model
from experiments.session import setup_of
from tests.support.models import LEG, LEG_RIG, write_model
from tests.support.mujoco_leg import Leg

DRAG = {"effect": "quadratic_drag", "joint": 2, "size": [{"name": "drag", "value": 0.001}]}
STRIBECK = {"effect": "stribeck_friction", "joint": 2, "size": [{"name": "excess_torque", "value": 0.01}]}
DELAY = {"effect": "torque_delay", "joint": None, "size": [{"name": "delay", "value": 0.001}]}
ELASTIC = {"effect": "joint_elasticity", "joint": 2, "size": [{"name": "compliance", "value": 0.002},
                                                              {"name": "motor_viscous", "value": 0.005}]}
SPRING = {"effect": "joint_stiffness", "joint": 2, "size": [{"name": "stiffness", "value": 0.02},
                                                            {"name": "preload", "value": 0.0}]}


def diagnosis(folder: Path, verdict: str, causes: list[Any], candidates: Sequence[Any] = (), **more: Any) -> Path:
    path = folder / "d.json"
    path.write_text(json.dumps({"schema": "legid.diagnosis/1", "verdict": verdict, "causes": causes,
                                "candidates": list(candidates), **more}))
    return path


def contest(folder: Path, path: Path, most_nm: float = 1.5) -> Contest:
    write_model(folder / "model.json", (1.02 * Leg().beta()).tolist(), LEG)
    (folder / "rig.toml").write_text(LEG_RIG.format(q1=1.0).replace("torque_nm = 1.5", f"torque_nm = {most_nm}"))
    rig, model = load_rig(folder / "rig.toml"), load_model(folder / "model.json")
    return contest_of(Bench(model, rig, "model.json"), question_of(path), model, setup_of([], rig, "imu").options)


def test_the_design_separates_sooner_than_the_default_and_keeps_the_limits(tmp_path: Path) -> None:
    rivals = contest(tmp_path, diagnosis(tmp_path, "one_of", [DELAY, ELASTIC]))
    band = Band(5.0, 0.0, 3.0)
    usual = design(rivals.bench, band, Search(tries=1, steps=20)).best
    found = separate(rivals, [band], Search(tries=1, steps=20))
    (by_default,) = expected_ratios(rivals, usual.torque_nm)
    assert found.pairs == (("torque_delay", "joint_elasticity@2"),)
    assert found.after[0] > 2.0 * by_default > 0.0 and found.after[0] >= found.before[0]
    for name, most in (("torque_nm", 1.5), ("speed_radps", 12.0), ("q1_rad", 1.0), ("q2_rad", 2.0)):
        assert 0.0 < found.best.peaks[name] <= 0.8 * most * (1.0 + 1e-9)


def test_rivals_that_fast_motion_tells_apart_get_faster_motion(tmp_path: Path) -> None:
    """An IMU that is turned errs as one with a bias does, as long as the leg hardly accelerates. Torque is short."""
    turned = {"effect": "imu_misalignment", "joint": None, "size": [{"name": "angle", "value": 0.05}]}
    biased = {"effect": "accelerometer_bias", "joint": None, "size": [{"name": "bias_x", "value": 0.5}]}
    rivals = contest(tmp_path, diagnosis(tmp_path, "one_of", [turned, biased]), 0.2)
    bands, search = widening_bands(5.0, 0.0, 100.0), Search(tries=1, steps=20)
    assert [round(band.high_hz, 1) for band in bands] == [3.0, 6.0, 8.3]
    (wide,), (narrow,) = (separate(rivals, tried, search).after for tried in (bands, bands[:1]))
    assert wide > 1.2 * narrow > 0.0


@pytest.mark.parametrize(("rate_hz", "highest"), [(20.0, [3.0]), (50.0, [3.0, 50.0 / 12.0]),
                                                  (1000.0, [3.0, 6.0, 100.0 / 12.0])])
def test_bands_end_where_a_period_has_too_few_samples(rate_hz: float, highest: list[float]) -> None:
    assert [band.high_hz for band in widening_bands(5.0, 0.0, rate_hz)] == pytest.approx(highest)


def test_a_plan_of_few_lines_repeats_itself() -> None:
    """Odd harmonics: after half a period the wave is its negative."""
    series = Series(Band(20.0, 0.0, 5.0), most=10)
    assert series.hz == pytest.approx(np.arange(1, 20, 2) / 4.0)
    assert Series(Band(20.0, 2.5, 3.0), most=10).hz == pytest.approx(Series(Band(20.0, 2.5, 3.0)).hz)  # few as it is
    wave = series.basis(100.0)[:, 100:-100]
    assert wave[:, 200:1700] == pytest.approx(-wave[:, :1500], abs=1e-9)


def test_the_expected_ratio_is_that_of_a_regression(tmp_path: Path) -> None:
    """Columns of a known matrix in place of the run's: least squares with both rivals' models, in closed form."""
    rows = np.random.default_rng(2).normal(size=(60, 40))
    rivals = contest(tmp_path, diagnosis(tmp_path, "one_of", [DRAG, SPRING]))
    p, own = rivals.bench.mechanism.p, rivals._places
    drag, spring = rows[:, own["quadratic_drag@2"][0]], rows[:, own["joint_stiffness@2"][0]]
    found = rivals.ratios(rows.T @ rows)
    for ratio, truth, other in ((found[0], drag @ [0.001], spring), (found[1], spring @ [0.02, 0.0], drag)):
        base = np.concatenate([rows[:, :p], other], axis=1)
        left = truth - base @ np.linalg.lstsq(base, truth, rcond=None)[0]
        assert ratio == pytest.approx(left @ left, rel=1e-6)


def test_a_rotor_without_a_joint_is_that_of_the_driven_joint(tmp_path: Path) -> None:
    rotor = {"effect": "rotor_inertia", "joint": None, "size": [{"name": "inertia", "value": 0.001}]}
    rivals = contest(tmp_path, diagnosis(tmp_path, "one_of", [rotor, SPRING]))
    there = contest(tmp_path, diagnosis(tmp_path, "one_of", [{**rotor, "joint": 2}, SPRING]))
    torque = 0.3 * np.sin(0.06 * np.arange(400))
    assert expected_ratios(rivals, torque) == pytest.approx(expected_ratios(there, torque), rel=1e-9)
    assert expected_ratios(rivals, torque)[0] > 0.0


def test_seconds_until_settled_hold_for_normal_ratios() -> None:
    """The log likelihood ratio of t seconds has mean m t and variance 2 m t."""
    rng = np.random.default_rng(0)
    for power in (0.5, 0.9):
        seconds = settling_seconds(10.0, 2.0, power)
        mean = 0.2 * seconds
        draws = mean + np.sqrt(2.0 * mean) * rng.normal(size=100_000)
        assert np.mean(draws > np.log(20.0)) == pytest.approx(power, abs=0.005)


def test_the_command_writes_a_plan_and_says_how_long_it_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]
                                                              ) -> None:
    path = diagnosis(tmp_path, "one_of", [DRAG, STRIBECK])
    contest(tmp_path, path)
    words = ["excite", "--rig", str(tmp_path / "rig.toml"), "--model", str(tmp_path / "model.json"), "--separate",
             str(path), "--tries", "1", "--steps", "2", "--seconds", "4"]
    assert main([*words, "--out", str(tmp_path / "plan.csv")]) == 0
    out = capsys.readouterr().out
    assert "quadratic_drag@2 or stribeck_friction@2: likelihood ratio 20 expected after" in out and "90 %" in out
    assert 0.0 < read_plan(tmp_path / "plan.csv").peak_nm <= 0.8 * 1.5
    assert main([*words, "--session", str(tmp_path / "s")]) == 2
    assert "--separate: designs one plan" in capsys.readouterr().err


def test_the_rivals_of_every_verdict_that_leaves_some(tmp_path: Path) -> None:
    rows = [{"effect": "stribeck_friction", "joint": 2, "size": 0.02, "smallest_detectable": 0.01},
            {"effect": "quadratic_drag", "joint": 2, "size": None, "smallest_detectable": 0.003},
            {"effect": "quadratic_drag", "joint": 2, "size": 0.1, "smallest_detectable": 0.003},
            {"effect": "joint_stiffness", "joint": 2, "size": 0.3, "smallest_detectable": 0.01}]
    found = question_of(diagnosis(tmp_path, "partial", [SPRING], rows))
    assert [r.label for r in found.rivals] == ["stribeck_friction@2", "quadratic_drag@2"]
    assert found.rivals[1].sizes == {"drag": 0.003} and [r.label for r in found.sure] == ["joint_stiffness@2"]
    changes = [{"effect": "parameter", "joint": None, "size_name": "beta7", "change": 0.01},
               {"effect": "gyro_scale", "joint": None, "size_name": "scale_error", "change": 0.02}]
    found = question_of(diagnosis(tmp_path, "changed_unexplained", [], changes, against={"runs": []}))
    assert found.against and [r.label for r in found.rivals] == ["beta7", "gyro_scale"]
    rivals = contest(tmp_path, tmp_path / "d.json")
    moved = rivals.bench.fine.move(0.3 * np.sin(0.06 * np.arange(400)))
    assert moved is not None and rivals.ratios(rivals.information(moved)).min() > 0.0


def test_a_rival_that_is_left_out_is_named_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    payload = {"effect": "payload", "joint": 2, "size": [{"name": "mass", "value": 0.1}]}
    gone = {"effect": "a_ghost", "joint": 1, "size": [{"name": "fright", "value": 0.1}]}
    path = diagnosis(tmp_path, "one_of", [payload, DRAG, gone, STRIBECK], against={"runs": []})
    found = question_of(path)
    assert [r.label for r in found.rivals] == ["quadratic_drag@2", "stribeck_friction@2"]
    assert [line.split(":")[0] for line in found.left_out] == ["payload at link 2 is left out", "a_ghost@1 is left out"]
    contest(tmp_path, path)
    assert main(["excite", "--rig", str(tmp_path / "rig.toml"), "--model", str(tmp_path / "model.json"), "--separate",
                 str(path), "--tries", "1", "--steps", "1", "--seconds", "4", "--out", str(tmp_path / "p.csv")]) == 0
    assert "payload at link 2 is left out: it changes several parameters" in capsys.readouterr().out
    with pytest.raises(Exception, match="payload at link 2 is left out"):
        question_of(diagnosis(tmp_path, "one_of", [payload, DRAG], against={"runs": []}))


@pytest.mark.parametrize(("verdict", "causes", "said"), [
    ("named", [DRAG, STRIBECK], "leaves no rivals"), ("one_of", [DRAG], "fewer than two rivals"),
    ("one_of", [{"effect": "quadratic_drag"}], "are damaged")])
def test_a_diagnosis_without_rivals_is_refused(verdict: str, causes: list[Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(Exception, match=said):
        question_of(diagnosis(tmp_path, verdict, causes))
