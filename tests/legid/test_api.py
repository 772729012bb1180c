"""The Python API: docs/example.py as a script, and what the functions refuse."""

import inspect
import runpy
import tempfile
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from estimator import Combination
from estimator import Diagnosis as Details
from experiments.emulation import LegBody
from experiments.emulation.hidden_effects import REST_RAD, SPRING_NM
from legid import api
from tests.support.paths import ROOT

EXAMPLE = ROOT / "docs/example.py"


@pytest.fixture(scope="module")
def example(module_path: Path) -> dict[str, Any]:
    """The example's names after it ran."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(module_path))
        return runpy.run_path(str(EXAMPLE))


@pytest.mark.slow
def test_the_example_finds_what_was_hidden(example: dict[str, Any]) -> None:
    found: legid.Diagnosis = example["found"]
    assert found.verdict == "named" and [(c.effect, c.joint) for c in found.causes] == [("joint_stiffness", 2)]
    stiffness, preload = found.causes[0].size
    assert stiffness.value == pytest.approx(SPRING_NM, rel=0.05)
    assert preload.value == pytest.approx(SPRING_NM * REST_RAD, rel=0.1)
    assert example["after"].rmse["q2_rad"] < 0.2 * example["before"].rmse["q2_rad"]


@pytest.mark.slow
def test_the_examples_results_have_the_shapes_that_the_docstrings_give(example: dict[str, Any]) -> None:
    result: legid.FitResult = example["result"]
    assert result.beta.shape == (9,) and result.covariance.shape == (9, 9) and result.ci95().shape == (9, 2)
    extended, truth = np.array(example["extended"].beta), np.array(LegBody().beta())
    assert np.all(np.abs(extended[:3] / truth[:3] - 1) < 0.02)
    assert np.all(np.abs(result.beta[:3] / truth[:3] - 1) > 0.1)  # the spring, which the nominal model put down to mass
    (run,), before = example["runs"][3:], example["before"]
    assert run.columns.keys() >= {"q2_rad", "tau2_nm", "gyro_radps", "accel_x_mps2", "accel_y_mps2"}
    assert before.q.shape == before.reference_q.shape == (len(before.time_s), 2)
    again, simulated = api.load_model(example["folder"] / "extended.json"), example["what_if"]
    assert again == example["extended"] and [e.name for e in again.effects] == ["joint_stiffness"]
    assert len(simulated) == 600 and simulated.rate_hz == 100.0 and "accel_x_mps2" in simulated


@pytest.mark.slow
def test_load_gives_what_record_gave(example: dict[str, Any]) -> None:
    again = api.load(example["folder"] / "run1.mcap")
    first = example["runs"][0]
    assert again.columns.keys() == first.columns.keys()
    assert all(np.array_equal(again[name], first[name], equal_nan=True) for name in first.columns)


@pytest.mark.slow
def test_results_draw_themselves_and_remember_where_they_come_from(example: dict[str, Any]) -> None:
    assert (example["folder"] / "diagnosis.png").stat().st_size > 10_000
    found: legid.Diagnosis = example["found"]
    assert list(found.to_frame()["effect"]) == ["joint_stiffness", "joint_stiffness"]
    assert len(found.to_frame("candidates")) == len(found.candidates) > 5
    page = found._repr_html_()
    assert found.sentence.split(".")[0] in unescape(page)
    run, rig = example["runs"][0], api.load_rig(example["rig_file"])
    alone = api.fit(run)
    assert np.array_equal(alone.beta, api.fit([run], rig).beta) and alone.runs == (run,) and alone.rig == rig
    assert list(alone.to_frame().index) == list(alone.mechanism.names)
    assert len(alone.plot().axes) == len(alone.trajectories[0].predicted) + 2
    seen = api.validate(example["nominal"], example["runs"][2:])
    assert len(seen) == 2 and len(seen.plot().axes) == 4 and len(seen[0].plot().axes) == 2
    assert seen.to_frame().loc["run4.mcap", "q2_rad"] == seen[1].rmse["q2_rad"]
    assert seen[1].to_frame().shape == (len(seen[1].time_s), 4)


@pytest.mark.slow
def test_no_model_is_made_of_a_fit_that_is_not_sure(example: dict[str, Any]) -> None:
    result, runs, rig = example["result"], example["runs"][:3], example["rig_file"]
    for found, told in (
            (replace(result.estimate, converged=False), "did not converge"),
            (replace(result.estimate, undetermined=(Combination((("beta8", 1.0),)),)), "does not determine beta8"),
            (Details("fit_failed", "too short"), "too short")):
        with pytest.raises(api.WorkError, match=told):
            api.model(found, runs, rig)
    with pytest.raises(api.WorkError, match="too short"):
        legid.Diagnosis.of(Details("fit_failed", "too short")).plot()


def test_bad_input_is_an_input_error(tmp_path: Path) -> None:
    plan, rig, run = api.multisine(seed=0, duration_s=6.0, peak_nm=0.1), tmp_path / "rig.toml", tmp_path / "run.mcap"
    for model, emulate, told in (
            ("leg2", "a_ghost", "cannot be hidden"), ("joint1", "none", "only a leg2 can be emulated"),
            ("joint1", None, r"has no \[devices.controller\]")):
        rig.write_text(f'[mechanism]\nmodel = "{model}"\nactuated = [1]\n')
        with pytest.raises(api.InputError, match=told):
            api.record(rig, plan, run, emulate=emulate)
    for file, told in ((run, "No such file"), (rig, "is of no kind that is known")):
        with pytest.raises(api.InputError, match=told):
            api.load(file, rig)
    assert not run.exists()


def test_every_function_is_typed_and_explained() -> None:
    functions = [found for name in vars(legid)["__all__"] if inspect.isfunction(found := getattr(legid, name))]
    assert {f.__name__ for f in functions} >= {"load", "fit", "diagnose", "validate", "record", "simulate", "model"}
    for f in functions:
        assert "raises" in (f.__doc__ or "").lower(), f.__name__
        signature = inspect.signature(f)
        assert signature.return_annotation is not signature.empty, f.__name__
        assert all(p.annotation is not p.empty for p in signature.parameters.values()), f.__name__
