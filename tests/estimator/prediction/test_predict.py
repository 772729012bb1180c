"""How far models predict: closed forms, the noise floor, and what `legid validate` prints of it."""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from pytest import approx

from daq import Dataset
from estimator import FitOptions
from estimator.model import joint1, leg2
from estimator.prediction import (
    HORIZONS_S,
    FittedModel,
    floor_errors,
    predict,
    predict_filtered,
    predict_run,
    smooth,
    tabulate,
)
from estimator.signals import split_signals
from legid.cli.main import build_parser
from tests.support.prescribed import ARM_RIG, BETA, arm_run, swing_run, written
from tests.support.shell import Shell, document

ARM = leg2(actuated=(0, 1))
OPTIONS = FitOptions(sensors="encoder")
PENDULUM = np.array([0.1, 0.3, 0.02, 0.0])


def arm(beta: np.ndarray = BETA) -> FittedModel:
    return FittedModel(ARM, "linear", beta)


def pendulum(beta: np.ndarray = PENDULUM) -> FittedModel:
    return FittedModel(joint1(), "linear", beta)


def test_the_truth_predicts_best_and_every_model_loses_with_the_horizon() -> None:
    wrong = BETA * np.array([1, 1, 1, 1.1, 1, 1, 1, 1, 1])
    table = predict([arm(), arm(wrong)], [arm_run(1, torque=0.0, encoder=1e-6)], OPTIONS, (0.1, 0.5))
    assert table.horizons_s == (0.1, 0.5, np.inf) and table.pieces.tolist() == [100, 20, 1]
    for c in ("q1_rad", "q2_rad"):
        assert table.rms(0, c, 0.1) < table.rms(0, c, 0.5) < 0.3 * table.rms(1, c, 0.5)
        assert table.rms(0, c, 0.5) < 0.1 * table.rms_kept(c, 0.5)
        assert table.rms_kept(c, 0.1) < 0.3 * table.rms_kept(c, 0.5)
    signals = split_signals([arm_run(1, torque=0.0, encoder=0.0)], ARM, OPTIONS)
    filtered = predict_filtered([arm(), arm(wrong)], signals, OPTIONS, 0.5)
    assert filtered.score(0.5) < -2.0 and filtered.score(0.5, 1) > filtered.score(0.5) + 1.0
    assert filtered.score(60.0) == np.inf  # no stretch is as long


def test_a_free_swing_errs_by_what_a_wrong_gravity_makes_of_it() -> None:
    """Small swings of a pendulum whose period is off by dw: the error over h is A |2 sin(dw h / 2)|, its rms over a
    swing's phases A |sin(dw h / 2)| sqrt 2, summed over the times up to h."""
    inertia, gravity, amplitude = 0.1, 0.3, 0.05
    w = np.sqrt(gravity * 9.81 / inertia)
    t = np.arange(4000) / 200.0
    q = amplitude * np.cos(w * t)
    # the torque that makes the swing an exact sine, although the pendulum is not linear
    tau = inertia * (-(w**2)) * q + gravity * 9.81 * np.sin(q)
    run = Dataset("swing.csv", 200.0, t, {"q1_rad": q, "tau1_nm": tau})
    off = 1.02
    found = predict([pendulum(np.array([inertia, gravity * off, 0.0, 0.0]))], [run],
                    replace(OPTIONS, noise={"encoder_rad": 1e-6}), (1.0,))
    s = np.linspace(0.0, 1.0, 2001)
    expected = amplitude * np.sqrt(np.mean(2.0 * np.sin(0.5 * (np.sqrt(off) - 1.0) * w * s) ** 2))
    assert found.rms(0, "q1_rad", 1.0) == approx(expected, rel=0.05)
    assert found.variance[0] == approx(amplitude**2 / 2.0, rel=0.01)


def test_a_pendulum_without_error_errs_by_the_noise_floor() -> None:
    runs = [swing_run(0.02, seed=k, encoder=1e-4) for k in range(8)]
    smoothed = [smooth(pendulum(), run, OPTIONS) for run in runs]
    parts = [predict_run([one], HORIZONS_S, run) for one, run in zip(smoothed, runs)]
    rng = np.random.default_rng(1)
    floors = [floor_errors(one, rng, HORIZONS_S, pendulum().problem) for one in smoothed for _ in range(3)]
    floor = np.mean([np.mean(f[:, 0] ** 2, axis=-1) for f in floors], axis=0)
    error = np.sqrt(tabulate(parts).squares[0, :, 0].mean(axis=0) / floor)
    assert error == approx(np.ones(len(HORIZONS_S)), rel=0.2)
    heavy = pendulum(PENDULUM * np.array([1.03, 1, 1, 1]))
    wrong = tabulate([predict_run([smooth(heavy, run, OPTIONS)], HORIZONS_S, run) for run in runs])
    assert (np.sqrt(wrong.squares[0, :, 0].mean(axis=0) / floor)[1:] > 2.0).all()


def test_misfits_prefer_the_truth_by_run() -> None:
    runs = [swing_run(0.02, seed=k, encoder=1e-4) for k in range(3)]
    table = predict([pendulum(), pendulum(PENDULUM * np.array([1.05, 1, 1, 1]))], runs, OPTIONS, (0.1,))
    assert (table.misfits[1] > table.misfits[0] + 10.0).all() and table.smoother == 0


def test_a_simulation_that_diverges_is_counted() -> None:
    pushed = BETA - np.array([0, 0, 0, 0, 0, 1.0, 1.0, 0, 0])
    run = arm_run(1, seconds=1.2)
    assert predict_filtered([arm(pushed)], split_signals([run], ARM, OPTIONS), OPTIONS, 0.6).score(0.6) == np.inf
    table = predict([arm(pushed)], [run], OPTIONS, (0.1,))
    assert table.lost[0, -1] == 1 and table.rms(0, "q1_rad", np.inf) == np.inf
    assert np.isfinite(table.rms(0, "q1_rad", 0.1))


def test_cost_grows_in_proportion_to_the_record() -> None:
    taken = []
    for seconds in (20.0, 80.0):
        run = swing_run(0.02, seconds=seconds, encoder=1e-4)
        spent = []
        for _ in range(3):
            begin = time.process_time()
            predict([pendulum()], [run], OPTIONS)
            spent.append(time.process_time() - begin)
        taken.append(min(spent))
    assert taken[1] < 8.0 * taken[0]


def test_the_default_horizons_are_those_of_the_help() -> None:
    told = f"default: {','.join(f'{h:g}' for h in HORIZONS_S[:-1])}"
    for command in ("validate", "compare"):
        parser = build_parser()._commands()[command]
        assert told in " ".join(parser.format_help().split())


def test_validate_prints_horizons_with_baseline_noise_and_another_model(tmp_path: Path, shell: Shell) -> None:
    runs = written([arm_run(k, seconds=6.0) for k in range(3)], tmp_path)
    rig, model, other = (tmp_path / name for name in ("rig.toml", "model.json", "other.json"))
    rig.write_text(ARM_RIG)
    shell("fit", *runs[:2], "--rig", rig, "--model-out", model)
    raised = json.loads(model.read_text())
    raised["parameters"][3]["value"] *= 1.2
    other.write_text(json.dumps(raised))
    shell.read()
    found = document("validate", model, *runs[1:], "--rig", rig, "--against", other, "--horizons 0.25,0.1")
    printed = shell.read()
    assert "the model was fitted to run run1.csv" in printed.out and "fitted to run run2.csv" not in printed.out
    assert "last velocity" in printed.out and "noise alone" in printed.out
    assert found["fitted_to"] == ["run1.csv"]
    assert [h["horizon_s"] for h in found["horizons"]] == approx([0.1, 0.25, 1.0, 5.99])
    for h in found["horizons"]:
        assert h["rmse"]["q1_rad"] < 0.5 * h["against"]["rmse"]["q1_rad"]
        assert h["noise"]["q1_rad"] == approx(1e-4, rel=0.4)
    assert found["horizons"][2]["rmse"]["q1_rad"] < 0.1 * found["horizons"][2]["last_velocity"]["q1_rad"]
