"""Faulty readings of the runs that were used are in the JSON of a validation and a diagnosis, as in that of a fit."""

from pathlib import Path

import legid
from tests.support.driven_pendulum import pendulum_run
from tests.support.imported_files import table_of
from tests.support.shell import document

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


def test_every_document_has_the_faulty_readings(here: Path) -> None:
    runs, rig = [], here / "rig.toml"
    for k in range(3):
        run = pendulum_run("r", k)
        run["q1_rad"][len(run) // 2] += 2.0 * (k == 1)
        runs.append(table_of(run, here / f"r{k}.csv"))
    rig.write_text(RIG)
    words = *runs, "--rig", rig
    read = document("fit", *words, "--model-out model.json")["readings"]
    (fault,) = read
    assert (fault["run"], fault["column"], fault["what"], fault["done"]) == ("r1.csv", "q1_rad", "isolated", "left_out")
    assert document("validate model.json", *words)["readings"] == read
    assert document("diagnose", *words, "--workers 1")["readings"] == read
    diagnosis = legid.diagnose(legid.load(runs, rig))
    assert diagnosis.document["readings"] == read
    diagnosis.page(here / "d.html")
    assert "off in one reading" in (here / "d.html").read_text() and len(repr(diagnosis)) < 400
