"""CONTRIBUTING.md alone is enough: each of its files, put where it says, is in use without any other change."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PACKAGES = ("drivers", "daq", "estimator", "experiments", "legid")
TESTS = ("tests/support", "evidence/blind", "tests/estimator/effects")
FILES = re.findall(r"^`(\w+/\S+\.py)`:\n\n```python\n(.*?)^```",
                   (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
"""Name and content of each."""


@pytest.fixture(scope="module")
def house(module_path: Path) -> Path:
    """The packages and what tests share, with the files of CONTRIBUTING.md."""
    assert [Path(name).parent.as_posix() for name, _ in FILES] == [
        "estimator/effects", "estimator/model", "drivers", "drivers", "legid/cli/commands"]
    for name in (*PACKAGES, *TESTS):
        shutil.copytree(ROOT / name, module_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", module_path)
    for name, code in FILES:
        assert not (module_path / name).exists(), name
        (module_path / name).write_text(code, encoding="utf-8")
    return module_path


def run(house: Path, *command: str, status: int = 0) -> str:
    done = subprocess.run([sys.executable, "-m", *command], cwd=house, env={**os.environ, "PYTHONPATH": str(house)},
                          capture_output=True, text=True, timeout=240)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout


def test_an_effect_a_mechanism_a_device_a_drive_and_a_command_are_one_file_each(house: Path, tmp_path: Path) -> None:
    said = run(house, "tests.support.contributed", str(tmp_path))
    assert "wind (by joint)" in said and said.endswith("2.00 s\n")


def test_the_effect_keeps_the_contract_and_is_asked_for_a_plant(house: Path) -> None:
    said = run(house, "pytest", "-rA", "-p", "no:cacheprovider", "tests/estimator/effects", "-k", "wind", status=1)
    passed, failed = (set(re.findall(rf"^{word} .*test_contract.py::(\w+)\[wind\]", said, re.MULTILINE))
                      for word in ("PASSED", "FAILED"))
    assert failed == {"test_it_is_found_with_its_size_in_a_plant_of_other_code"} and len(passed) == 6, said
    assert "add a plant to tests/support/hidden_effects.py" in said


def test_the_files_keep_the_rules_of_style(house: Path) -> None:
    run(house, "ruff", "check", "--no-cache", *(name for name, _ in FILES))


def test_without_its_file_a_newcomer_is_not_known(house: Path) -> None:
    """The copy is what runs: the packages here know no wind."""
    from estimator.effects import classes

    assert "wind" not in {kind.name for kind in classes()}
