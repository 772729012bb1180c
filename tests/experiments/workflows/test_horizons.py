"""How far ahead a model predicts, beside what costs nothing; runs of the fit are no validation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from estimator.fitting.prediction import measured_states, predict, prediction_score
from estimator.model.mechanism import leg2
from estimator.options import FitOptions
from experiments.cli import main
from tests.support.prescribed import ARM_RIG, BETA, arm_run, written

ARM = leg2(actuated=(0, 1))
OPTIONS = FitOptions(sensors="encoder")


def test_the_truth_predicts_best_and_every_model_loses_with_the_horizon() -> None:
    states = measured_states([arm_run(1, torque=0.0, encoder=0.0)], ARM, OPTIONS)
    true = [predict(states, ARM, BETA, "linear", h) for h in (0.1, 0.5, None)]
    wrong = predict(states, ARM, BETA * np.array([1, 1, 1, 1.1, 1, 1, 1, 1, 1]), "linear", 0.5)
    assert true[0].pieces > 4 * true[1].pieces > 0 and true[2].pieces == 1 and true[2].horizon_s == pytest.approx(9.99)
    assert (true[0].rmse < true[1].rmse).all() and (true[1].rmse < 0.3 * wrong.rmse).all()
    assert (true[1].rmse < 0.1 * true[1].baseline).all() and (true[0].baseline < 0.3 * true[1].baseline).all()
    assert prediction_score(states, ARM, BETA, "linear") < -2.0


def test_a_simulation_that_blows_up_is_counted_and_kept_out_of_the_error() -> None:
    states = measured_states([arm_run(1, seconds=3.0)], ARM, OPTIONS)
    pushed = BETA - np.array([0, 0, 0, 0, 0, 1.0, 1.0, 0, 0])
    found = predict(states, ARM, pushed, "linear", 1.0)
    assert found.blown > 0 and prediction_score(states, ARM, pushed, "linear") == np.inf


def test_validate_prints_horizons_beside_baseline_noise_and_another_model(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = written([arm_run(k, seconds=6.0) for k in range(3)], tmp_path)
    rig, model, other, out = (tmp_path / name for name in ("rig.toml", "model.json", "other.json", "out.json"))
    rig.write_text(ARM_RIG)
    assert main(["fit", *runs[:2], "--rig", str(rig), "--model-out", str(model)]) == 0
    document = json.loads(model.read_text())
    document["parameters"][3]["value"] *= 1.2
    other.write_text(json.dumps(document))
    capsys.readouterr()
    words = ["validate", str(model), *runs[1:], "--rig", str(rig), "--against", str(other), "--json", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "model.json was fitted to run1.csv" in printed.err and "run2.csv" not in printed.err
    assert "last velocity" in printed.out and "noise alone" in printed.out
    found = json.loads(out.read_text())
    assert found["fitted_to"] == ["run1.csv"]
    assert [h["horizon_s"] for h in found["horizons"]] == pytest.approx([0.1, 0.5, 1.0, 5.0, 5.99])
    for h in found["horizons"]:
        assert h["rmse"]["q1_rad"] < 0.5 * h["against"]["rmse"]["q1_rad"]
        assert h["noise"]["q1_rad"] == pytest.approx(1e-4, rel=0.4)
    assert found["horizons"][2]["rmse"]["q1_rad"] < 0.1 * found["horizons"][2]["last_velocity"]["q1_rad"]
