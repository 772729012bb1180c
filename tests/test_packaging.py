"""The wheel in an environment of its own, away from the checkout: what `pip install legid` gives a newcomer."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from experiments.emulation import LegBody
from tests.support.models import LEG, write_model
from tests.support.paths import DEMO_RIG, ROOT

TIMEOUT_S = 600.0


def run(*words: object, cwd: Path) -> str:
    done = subprocess.run(list(map(str, words)), cwd=cwd, capture_output=True, text=True, timeout=TIMEOUT_S,
                          env={"PATH": "/usr/bin:/bin", "HOME": str(Path.home())})
    assert done.returncode == 0, (words, done.stdout[-2000:], done.stderr[-2000:])
    return done.stdout


@pytest.fixture(scope="module")
def wheel(module_path: Path) -> Path:
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", module_path, ROOT, cwd=module_path)
    (found,) = module_path.glob("legid-*.whl")
    return found


@pytest.mark.slow
def test_the_wheel_holds_every_file_that_the_packages_read(wheel: Path) -> None:
    listed = set(zipfile.ZipFile(wheel).namelist())
    tracked = run("git", "ls-files", "drivers", "daq", "estimator", "experiments", "legid", cwd=ROOT).splitlines()
    assert {name for name in tracked if not name.endswith(".md")} - listed == set()
    assert not any(name.startswith(("tests/", "docs/", "studies/", "firmware/")) for name in listed)


@pytest.mark.slow
def test_a_clean_environment_fits_and_writes_a_page(wheel: Path, tmp_path: Path) -> None:
    """Base dependencies alone: no extra is needed for the way from a plan to a page."""
    run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    python, legid = tmp_path / "venv" / "bin" / "python", tmp_path / "venv" / "bin" / "legid"
    run(python, "-m", "pip", "install", "--quiet", "--prefer-binary", wheel, cwd=tmp_path)
    assert "legid COMMAND --help" in run(legid, "--help", cwd=tmp_path)
    write_model(tmp_path / "true.json", list(LegBody().beta()), LEG)
    (tmp_path / "rig.toml").write_text(DEMO_RIG.read_text())
    run(legid, "excite", "--rig", "rig.toml", "--out", "plan.csv", cwd=tmp_path)
    run(legid, "simulate", "true.json", "--plan", "plan.csv", "--out", "run.csv", cwd=tmp_path)
    said = run(legid, "fit", "run.csv", "--html", "fit.html", "--model-out", "model.json", cwd=tmp_path)
    assert "converged" in said and "<svg" in (tmp_path / "fit.html").read_text()
    study = subprocess.run([legid, "monte-carlo", "biped3"], cwd=tmp_path, capture_output=True, text=True,
                           timeout=TIMEOUT_S)
    assert study.returncode == 1 and "clone the repository" in study.stderr and "Traceback" not in study.stderr
    assert "site-packages" in run(python, "-c", "import experiments; print(experiments.__file__)", cwd=tmp_path)
