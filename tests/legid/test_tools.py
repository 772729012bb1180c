"""Functions around a fit: files of other programs, plans, simulated runs."""

from pathlib import Path

import numpy as np
import pytest

import legid
from daq.runs import write_csv
from tests.support.paths import FIXTURES
from tests.support.shell import Shell

HEALTHY, RIG = FIXTURES / "healthy.mcap", FIXTURES / "rig.toml"


@pytest.fixture(scope="module")
def model(module_path: Path) -> Path:
    path = module_path / "model.json"
    legid.save_model(legid.model(legid.fit(legid.load(HEALTHY, RIG), method="wls")), path)
    return path


def test_a_file_that_is_read_is_the_run_that_import_writes(tmp_path: Path, shell: Shell) -> None:
    theirs, columns, out, again = (tmp_path / name for name in ("log.csv", "columns.toml", "imported", "again.csv"))
    write_csv(legid.load(HEALTHY), theirs)
    columns.write_text('[columns.q2_rad]\nname = "q2_rad"\n[columns.tau2_nm]\nname = "tau2_nm"\nsign = -1\n')
    shell("import", theirs, "--map", columns, "--out", out)
    write_csv(legid.read(theirs, columns), again)
    assert again.read_bytes() == (out / "log.csv").read_bytes()
    same = legid.read(theirs, {"q2_rad": {"name": "q2_rad"}, "tau2_nm": {"name": "tau2_nm", "sign": -1}})
    assert all(np.array_equal(same[name], legid.read(theirs, columns)[name], equal_nan=True) for name in same.columns)


def test_a_plan_with_and_without_a_prior_model(model: Path, tmp_path: Path, shell: Shell) -> None:
    plain, designed = legid.excite(RIG, seconds=6.0), legid.excite(RIG, model, seconds=6.0, tries=1, steps=1)
    assert len(plain.to_frame()) == 600 and len(designed.to_frame()) == 9
    for found, words in ((plain, []), (designed, ["--model", model, "--tries 1 --steps 1"])):
        assert len(found.plot().axes) == 1
        shown, written = tmp_path / "shell.csv", tmp_path / "python.csv"
        shell("excite --rig", RIG, "--seconds 6 --force --out", shown, *words)
        legid.write_plan(found.plan, written)
        assert written.read_bytes() == shown.read_bytes()


def test_a_simulation_of_files_is_that_of_a_model_and_a_plan(model: Path, tmp_path: Path, shell: Shell) -> None:
    plan, out = tmp_path / "plan.csv", tmp_path / "run.csv"
    legid.write_plan(legid.multisine(seed=1, duration_s=12.0, peak_nm=0.1), plan)
    one, other = legid.simulate(model, plan), legid.simulate(legid.load_model(model), legid.read_plan(plan))
    assert all(np.array_equal(one[name], other[name]) for name in other.columns)
    shell("simulate", model, "--plan", plan, "--out", out)
    write_csv(one, tmp_path / "python.csv")
    assert out.read_bytes() == (tmp_path / "python.csv").read_bytes()
    assert len(legid.simulate(model, HEALTHY, rate_hz=100.0)) > 100
    with pytest.raises(legid.InputError, match="holds torques"):
        legid.simulate(model, legid.read_plan(plan), rig=RIG)
