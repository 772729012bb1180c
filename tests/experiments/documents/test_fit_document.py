"""`legid.fit/1` as a struct: files of earlier versions are read, shown and told, and what only a fit has is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from experiments.reports import fit_summary, fit_text
from tests.support.fits import document_of, synthetic_fit

FIRST: dict[str, Any] = {
    "schema": "legid.fit/1", "model": "leg2", "method": "mle", "sensors": "imu",
    "parameters": [
        {"name": "beta1", "meaning": "I1 + m1*lc1^2 + m2*l1^2", "unit": "kg m^2", "value": 0.1, "std": 0.001,
         "ci95": [0.098, 0.102], "fixed": False},
        {"name": "beta8", "meaning": "Coulomb friction, pivot", "unit": "N m", "value": None, "std": None,
         "ci95": [None, None], "fixed": False},
        {"name": "beta9", "meaning": "Coulomb friction, knee", "unit": "N m", "value": 0.2, "std": 0.0,
         "ci95": [0.2, 0.2], "fixed": True}],
    "noise": {"gyro_radps": 0.005, "torque_nm": 0.02}, "torque_residual_rms_nm": [0.01, 0.02], "converged": True,
    "iterations": 8, "samples": 2000, "wall_s": 0.05}
"""As the first version wrote it."""
LATER: dict[str, Any] = {
    **FIRST, "undetermined": ["beta8 -0.5*beta6"], "warnings": ["few samples"], "assumptions": ["noise is white"],
    "trust": {"level": "bad", "sentence": "DO NOT TRUST the parameters: these runs do not determine all parameters.",
              "reasons": ["Move it."]},
    "noise": {"torque_nm": 0.03, "torque_nm_by_joint": [0.01, 0.03], "accel_mps2": 0.05,
              "accel_mps2_by_axis": [0.03, 0.06]},
    "agreement": {"unit": "run", "runs": ["a", "b"], "p_value": 2e-5, "disagree": True, "parameters": [
        {"name": "beta1", "mean": 0.1, "scatter": 0.02, "seen": True, "by_run": [0.08, 0.12], "widened": 2.2}]},
    "second_opinion": {"method": "shooting", "disagreement": 1.2, "reported": "mle", "parameters": [
        {"name": "beta1", "value": 0.11, "ci95": [0.1, 0.12], "disagreement": 1.2}], "not_compared": ["beta8"],
        "held_out": None},
    "budget": [{"parameter": "beta1", "half_width": 0.002, "moved": 0.0, "parts": [
        {"source": "noise", "std": 0.001, "tolerance": []}]}], "tolerances_enlarged": {"IMU": 6.0},
    "findings": [{"role": "fault", "kind": "columns", "text": "gyro and accelerometer contradict each other"}],
    "set_aside": [{"run": "b.csv", "why": "it stands still"}], "damaged": [],
    "provenance": {"version": "0.1.0", "commit": "unknown", "runs": [{"file": "a.csv", "sha256": "0" * 64}]}}
"""With keys of later ones."""


def read(tmp_path: Path, document: dict[str, Any]) -> legid.FitResult:
    (tmp_path / "fit.json").write_text(json.dumps(document))
    return legid.FitResult.read(tmp_path / "fit.json")


def test_the_first_version_is_read_and_told(tmp_path: Path) -> None:
    found = read(tmp_path, FIRST)
    np.testing.assert_array_equal(found.beta, [0.1, np.nan, 0.2])
    np.testing.assert_array_equal(found.ci95()[0], [0.098, 0.102])
    assert found.fixed == {"beta9": 0.2} and found.trust.level == "caution" and list(found.std)[:1] == [0.001]
    text = found.text()
    assert "leg2, mle, sensors imu: 2000 samples, 8 iterations, 0.05 s, converged" in text
    assert "torque residual (rms): joint 1 0.01 N m, joint 2 0.02 N m" in text and "beta8      not determined" in text
    assert list(found.to_frame()["fixed"]) == [False, False, True] and "<table>" in found._repr_html_()


def test_what_later_versions_say_is_told(tmp_path: Path) -> None:
    text = read(tmp_path, LATER).text().splitlines()
    assert text[:2] == ["DO NOT TRUST the parameters: these runs do not determine all parameters.", "Move it."]
    assert {"not determined by this data: beta8 -0.5*beta6", "warning: few samples", "assumed: noise is white",
            "warning: gyro and accelerometer contradict each other",
            "the runs ask for larger tolerances: IMU 6 times"} <= set(text)
    assert any("torque 1 0.01 N m, torque 2 0.03 N m, accelerometer x 0.03" in line for line in text)
    assert any(line.startswith("runs disagree about beta1 (I1 + m1*lc1^2 + m2*l1^2): 0.080 .. 0.120") for line in text)
    assert "second opinion, by multiple shooting: largest disagreement 1.2 half widths, in beta1; not compared: " \
        "beta8" in text


def test_what_was_read_is_written_as_it_was(tmp_path: Path) -> None:
    found = read(tmp_path, LATER)
    found.to_json(tmp_path / "again.json")
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["second_opinion"].pop("why") == "" and again["provenance"]["runs"][0].pop("inside") == ""
    assert {key: again["provenance"][key] for key in LATER["provenance"]} == LATER["provenance"]
    assert {key: again[key] for key in LATER if key != "provenance"} == {
        key: value for key, value in LATER.items() if key != "provenance"}
    assert found.document["parameters"] == LATER["parameters"]


def test_a_file_has_no_motion(tmp_path: Path) -> None:
    found = read(tmp_path, FIRST)
    found.page(tmp_path / "p.html")
    page = (tmp_path / "p.html").read_text()
    assert "<h2>Parameters</h2>" in page and "<h2>Torques</h2>" not in page
    for ask in (found.plot, lambda: found.covariance, lambda: legid.model(found)):
        with pytest.raises(legid.WorkError, match="read from a file, which has no covariance and no motion"):
            ask()


def test_a_joint_s_level_keeps_its_number() -> None:
    """The list of levels has one entry for each joint with a motor."""
    plain = document_of(synthetic_fit())
    assert plain.driven == (2,) and plain.levels == {"gyro_radps": 0.005, "accel_mps2": 0.05}
    plain.noise, plain.driven = {"torque_nm": 0.2, "torque_nm_by_joint": (0.1, 0.2)}, (2, 3)
    assert plain.levels == {"torque_nm": 0.2, "torque2_nm": 0.1, "torque3_nm": 0.2}


def test_samples_that_the_fit_left_out_are_told() -> None:
    fit = document_of(synthetic_fit())
    assert " 1500 samples," in fit_text(fit) and fit.recorded == 0
    fit.recorded = 1600
    assert " 1500 of 1600 samples," in fit_text(fit) and " 1500 of 1600 samples." in fit_summary(fit)
    fit.recorded = 1500
    assert " 1500 samples," in fit_text(fit)
