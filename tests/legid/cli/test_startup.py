"""What a command does not use, it does not wait for."""

from pathlib import Path

import pytest

from daq.runs import write_csv
from tests.support.mujoco_leg import Leg, record
from tests.support.paths import ROOT
from tests.support.processes import ran

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {lever}\n'
RECORDER = "import sys, experiments.workflows.record; print([name for name in {slow} if name in sys.modules])"
SLOW = ("matplotlib", "jinja2", "mcap", "can", "pyarrow")
"""Packages each of which takes as long to import as a fit of thousands of samples. Numba and SciPy are none: one loads
compiled kernels, the other's splines test how the torque acts between samples."""
CODE = """
import sys
from legid.cli import main
assert main(sys.argv[1:]) == 0
print([name for name in {slow} if name in sys.modules])
"""


def last_line(code: str, *command: str, cwd: Path = ROOT) -> str:
    """What a program prints last."""
    return ran("-c", code, *command, cwd=cwd).stdout.splitlines()[-1]


def test_a_fit_imports_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    leg = Leg()
    write_csv(record(leg, 3, seconds=10), tmp_path / "run.csv")
    (tmp_path / "rig.toml").write_text(RIG.format(lever=leg.lever))
    assert last_line(CODE.format(slow=SLOW), "fit", "run.csv", "--rig", "rig.toml", cwd=tmp_path) == "[]"


@pytest.mark.parametrize("command", [["--version"], ["--help"], ["info", "run.csv"]])
def test_a_command_without_a_fit_loads_no_compiler(command: list[str], tmp_path: Path) -> None:
    write_csv(record(Leg(), 3, seconds=2), tmp_path / "run.csv")
    assert last_line(CODE.format(slow=("numba", "llvmlite")), *command, cwd=tmp_path) == "[]"


def test_python_without_a_fit_loads_no_compiler() -> None:
    assert last_line("import sys, legid.api, estimator; print({'numba', 'llvmlite'} & set(sys.modules))") == "set()"


def test_a_recording_loads_no_mathematics() -> None:
    assert last_line(RECORDER.format(slow=("scipy", "numba", "matplotlib", "jinja2"))) == "[]"
