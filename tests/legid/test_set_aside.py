"""Every verb sets a run aside that cannot be used, and says so: a leg whose knee's encoder is stuck, a real arm's."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

import legid
from daq.runs import write_csv
from experiments.documents import Document
from tests.support.packed_runs import stuck
from tests.support.paths import FIXTURES, REAL, ROOT, needs_records

Verb = Callable[[Sequence[Path], Path], Document]


def models_of(files: Sequence[Path], rig: Path) -> tuple[legid.Model, legid.Model]:
    """A model of the rig, and one with its first parameter larger."""
    found = legid.fit(legid.load(files, rig), method="wls")
    return legid.model(found), legid.model(legid.fit(found.runs, method="wls", fixed={
        found.parameters[0].name: 1.1 * float(found.beta[0])}))


VERBS = {
    "fit": lambda files, rig: legid.fit(legid.load(files, rig), method="wls"),
    "validate": lambda files, rig: legid.validate(models_of(files, rig)[0], legid.load(files, rig)),
    "compare": lambda files, rig: legid.compare(*models_of(files, rig), legid.load(files, rig)),
    "diagnose": lambda files, rig: legid.diagnose(legid.load(files, rig)),
    "tune": lambda files, rig: legid.tune(files, rig)}
LONG = {"diagnose", "tune"}


def told(made: Document) -> list[str]:
    return [run["run"] for run in made.document["set_aside"]]


@pytest.mark.parametrize("verb", [pytest.param(verb, marks=pytest.mark.slow if verb in LONG else ()) for verb in VERBS])
def test_of_a_leg(verb: str, tmp_path: Path) -> None:
    rig, good, bad = FIXTURES / "rig.toml", tmp_path / "healthy.csv", tmp_path / "bad.csv"
    write_csv(legid.load(FIXTURES / "healthy.mcap", rig), good)
    run = legid.load(good, rig)
    write_csv(legid.Dataset("bad.csv", run.rate_hz, run.time_s, dict(run.columns) | {"q2_rad": np.full(len(run), 0.3)}),
              bad)
    assert told(VERBS[verb]([good, bad], rig)) == ["bad.csv"]


@needs_records
@pytest.mark.parametrize("verb", [pytest.param(verb, marks=pytest.mark.study if verb in LONG else pytest.mark.slow)
                                  for verb in VERBS])
def test_of_a_real_arm(verb: str, tmp_path: Path) -> None:
    files, bad = [REAL / f"dfki_c0/{k}.csv.gz" for k in ("00", "01", "02", "05")], tmp_path / "bad.csv.gz"
    stuck(files[0], bad)
    assert told(VERBS[verb]([*files[:2], bad, *files[2:]], ROOT / "studies/rigs/dfki_first.toml")) == ["bad.csv.gz"]
