"""What modules of several rooms share: a recorded run, made once, and one thread for every library of arrays."""

from __future__ import annotations

import gc
import os
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.support.shell import Answers, Shell

HERE = Path(__file__).parent
UNKNOWN: set[str] = set()
LONGEST = ("docs/test_tutorial.py", "legid/test_api.py", "experiments/session/test_servo_law.py", "test_packaging.py",
           "experiments/workflows/test_executor.py", "experiments/workflows/test_demo.py", "test_contributing.py")
"""Begun first by `make test-slow`: a worker that begins one last works alone."""

gc.disable()  # modules and tests that are collected stay: to look for garbage among them takes a quarter of their time
for library in ("OMP", "OPENBLAS"):  # before numpy is imported; two workers share two cores
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the cases of tests/tiers.toml; a case has the tier of its own line, else that of its function's."""
    tiers = tomllib.loads((HERE / "tiers.toml").read_text(encoding="utf-8"))
    tier_of = {name: tier for tier, names in tiers.items() for name in names}
    UNKNOWN.update(tier_of)
    items.sort(key=lambda item: not item.path.as_posix().endswith(LONGEST))
    for item in items:
        if item.path.is_relative_to(HERE):
            name = f"{item.path.relative_to(HERE).as_posix()}::{item.name}"
            found = [one for one in (name, name.partition("[")[0]) if one in tier_of]
            UNKNOWN.difference_update(found)
            if found:
                item.add_marker(tier_of[found[0]])


@pytest.fixture(scope="session")
def unknown_cases(pytestconfig: pytest.Config) -> set[str]:
    """Names in tests/tiers.toml that no test has; empty where not all tests are collected."""
    return UNKNOWN if [Path(arg).resolve() for arg in pytestconfig.args] == [HERE] else set()


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    """Types commands and reads what they say."""
    from tests.support.shell import Shell

    return Shell(capsys)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own, which is the current one: a command names its files as a user does."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Answers:
    """Says what is answered at a terminal; the questions asked are in the list returned."""
    def give(*texts: str) -> list[str]:
        rest, asked = iter(texts), []

        def answer(question: str = "") -> str:
            asked.append(question)
            for text in rest:
                return text
            raise EOFError

        monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
        monkeypatch.setattr("builtins.input", answer)
        return asked

    return give


@pytest.fixture(scope="module")
def module_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the tests of a module share."""
    return tmp_path_factory.mktemp("module")


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds of the demo's rig through emulated chips, drivers, recorder and clocks, to be read only."""
    from daq.rig import load_rig
    from experiments.emulation.emulated_rig import record_emulated
    from experiments.excite.multisine import random_multisine
    from tests.support.paths import DEMO_RIG

    path = tmp_path_factory.mktemp("demo_run") / "run.mcap"
    record_emulated(path, load_rig(DEMO_RIG), DEMO_RIG.read_text(), random_multisine(1, 5.0, 0.5), 1)
    return path
