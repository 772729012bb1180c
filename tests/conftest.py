"""What modules of several rooms share: a recorded run, made once, and one thread for every library of arrays."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

gc.disable()  # modules and tests that are collected stay: to look for garbage among them takes a quarter of their time
for library in ("OMP", "OPENBLAS"):  # before numpy is imported; two workers share two cores
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    gc.enable()


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
