"""What a command does not use, it does not wait for."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from daq.runs import write_csv
from tests.support.mujoco_leg import Leg, record
from tests.support.paths import ROOT

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {lever}\n'
RECORDER = "import sys, experiments.workflows.record; print([name for name in {slow} if name in sys.modules])"
SLOW = ("matplotlib", "jinja2", "mcap", "can", "pyarrow")
"""Packages each of which takes as long to import as a fit of thousands of samples. Numba and SciPy are none: one loads
compiled kernels, the other's splines test how the torque acts between samples."""
CODE = """
import sys
from experiments.cli import main
assert main(sys.argv[1:]) == 0
print([name for name in {slow} if name in sys.modules])
"""


def test_a_fit_imports_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    leg = Leg()
    write_csv(record(leg, np.random.default_rng(3), seconds=10), tmp_path / "run.csv")
    (tmp_path / "rig.toml").write_text(RIG.format(lever=leg.lever))
    command = ["fit", str(tmp_path / "run.csv"), "--rig", str(tmp_path / "rig.toml")]
    done = subprocess.run([sys.executable, "-c", CODE.format(slow=SLOW), *command], capture_output=True, text=True,
                          timeout=120, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout and done.stdout.splitlines()[-1] == "[]", done.stdout


@pytest.mark.parametrize("command", [["--version"], ["--help"], ["info", "run.csv"]])
def test_a_command_without_a_fit_loads_no_compiler(command: list[str], tmp_path: Path) -> None:
    write_csv(record(Leg(), np.random.default_rng(3), seconds=2), tmp_path / "run.csv")
    done = subprocess.run([sys.executable, "-c", CODE.format(slow=("numba", "llvmlite")), *command],
                          capture_output=True, text=True, timeout=120, cwd=tmp_path,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "[]", done.stdout + done.stderr


def test_python_without_a_fit_loads_no_compiler() -> None:
    code = "import sys, legid.api, estimator; print({'numba', 'llvmlite'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, cwd=ROOT,
                          check=True)
    assert done.stdout == "set()\n"


def test_a_recording_loads_no_mathematics() -> None:
    slow = ("scipy", "numba", "matplotlib", "jinja2")
    done = subprocess.run([sys.executable, "-c", RECORDER.format(slow=slow)], capture_output=True, text=True,
                          timeout=120, cwd=ROOT, check=True)
    assert done.stdout == "[]\n"
