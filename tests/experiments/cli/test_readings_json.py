"""Faulty readings of the runs that were used are in the JSON of a validation and a diagnosis, as in that of a fit."""

import json
from pathlib import Path

import numpy as np

import legid
from tests.support.driven_pendulum import pendulum_run
from tests.support.shell import Shell

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


def test_every_document_has_the_faulty_readings(tmp_path: Path, shell: Shell) -> None:
    runs = []
    for k in range(3):
        run = pendulum_run("r", k)
        angle = run["q1_rad"].copy()
        if k == 1:
            angle[len(angle) // 2] += 2.0
        runs.append(tmp_path / f"r{k}.csv")
        np.savetxt(runs[-1], np.column_stack([run.time_s, angle, run["tau1_nm"]]), delimiter=",", comments="",
                   header="time_s,q1_rad,tau1_nm")
    (tmp_path / "rig.toml").write_text(RIG)
    rig, names = str(tmp_path / "rig.toml"), [str(run) for run in runs]
    files = {what: str(tmp_path / f"{what}.json") for what in ("fit", "model", "validate", "diagnose")}
    shell("fit", *names, "--rig", rig, "--json", files["fit"], "--model-out", files["model"])
    shell("validate", files["model"], *names, "--rig", rig, "--json", files["validate"])
    shell("diagnose", *names, "--rig", rig, "--json", files["diagnose"], "--workers 1")
    found = {what: json.loads(Path(files[what]).read_text())["readings"] for what in ("fit", "validate", "diagnose")}
    (fault,) = found["fit"]
    assert (fault["run"], fault["column"], fault["what"], fault["done"]) == ("r1.csv", "q1_rad", "isolated", "left_out")
    assert found["validate"] == found["diagnose"] == found["fit"]
    diagnosis = legid.diagnose(legid.load(runs, rig))
    assert diagnosis.document["readings"] == found["fit"]
    diagnosis.page(tmp_path / "d.html")
    assert "off in one reading" in (tmp_path / "d.html").read_text() and len(repr(diagnosis)) < 400
