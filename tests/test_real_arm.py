"""Real records of a two-link arm through the ordinary commands; skipped where the data are not at hand.

The published parameters are those of the data sets' own READMEs (models 3.0 and 2.0), in the contract's terms.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.cli import main

DATA = Path(__file__).resolve().parents[2] / "shared" / "realdata"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the shared real records are not beside the checkout")
RIG = """
[mechanism]
model = "leg2"
actuated = {actuated}

[terms]
rotor_inertia = [2]
torque_offset = {actuated}
friction_velocity_radps = 0.05

[motor]
gear_ratio = 6.0

[noise]
encoder_rad = 0.002   # the gear's play, seen by no encoder

[filter]
cutoff_hz = 3.0

[sampling]
rate_hz = 100.0
hold = "average"
"""
DESIGNS = {
    "dfki_c0": (["00", "01", "02", "05", "06"], "04", [0.05354, 0.05328, 0.03623, 0.24113, 0.18117]),
    "dfki_a0": (["00", "01", "02", "03"], "12", [0.11116, 0.02346, 0.03332, 0.34912, 0.11106]),
}


@pytest.mark.parametrize("method", ["wls", "mle"])
@pytest.mark.parametrize("design", DESIGNS)
def test_published_parameters_are_found_within_ten_per_cent(design: str, method: str, tmp_path: Path) -> None:
    runs, left_out, published = DESIGNS[design]
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(actuated=[1, 2]))
    files = [str(DATA / design / f"{r}.csv.gz") for r in runs]
    out, model = tmp_path / "fit.json", tmp_path / "model.json"
    assert main(["fit", *files, "--rig", str(rig), "--method", method, "--json", str(out),
                 "--model-out", str(model)]) == 0
    found = {p["name"]: p["value"] for p in json.loads(out.read_text())["parameters"]}
    beta = np.array([found[f"beta{k + 1}"] for k in range(5)])
    assert np.max(np.abs(beta / published - 1)) < 0.10
    check = tmp_path / "check.json"
    assert main(["validate", str(model), str(DATA / design / f"{left_out}.csv.gz"), "--rig", str(rig),
                 "--json", str(check)]) == 0
    assert check.stat().st_size > 100


def test_the_passive_pivot_is_the_papers_case(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(actuated=[2]))
    files = [str(DATA / "dfki_c0" / f"{r}_passive.csv.gz") for r in ("03", "04")]
    out = tmp_path / "fit.json"
    assert main(["fit", *files, "--rig", str(rig), "--method", "wls", "--json", str(out)]) == 0
    found = {p["name"]: p["value"] for p in json.loads(out.read_text())["parameters"]}
    # gravity terms agree with the driven runs; the two runs excite the inertias poorly (the data's README)
    assert found["beta4"] == pytest.approx(0.2411, rel=0.15)
    assert found["beta5"] == pytest.approx(0.1812, rel=0.15)
