"""`legid simulate --rig`: a model behind its loop follows a plan as MuJoCo's leg followed it."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daq import Dataset, InputError, parse_rig
from daq.runs import read_csv, write_csv
from estimator import LoopTerm
from estimator.model import leg2
from experiments.models import load_model
from experiments.workflows import follow_commands
from experiments.workflows.loop_values import loop_findings
from tests.support.models import LEG as SETTINGS
from tests.support.models import write_model
from tests.support.mujoco_leg import Leg
from tests.support.servo_leg import COUNTS, follow
from tests.support.shell import Shell

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\ngain = 8.0\ndamping = 0.2\nlimit = 1.0\n'
BODY = Leg(viscous=(0.02, 0.03), coulomb=(0.01, 0.02))


@pytest.fixture
def run() -> Dataset:
    return follow(BODY, 6, gain=8.0, damping=0.2, limit=1.0, seconds=5.0)


def test_the_leg_follows_the_plan(here: Path, run: Dataset, shell: Shell) -> None:
    write_csv(Dataset("plan", 100.0, run.time_s, {"q2_cmd_rad": run["q2_cmd_rad"], "q1_rad": run["q1_rad"],
                                                  "q2_rad": run["q2_rad"]}), here / "plan.csv")
    (here / "rig.toml").write_text(RIG)
    write_model(here / "m.json", list(BODY.beta()), {**SETTINGS, "friction_velocity_radps": 0.02})
    shell("simulate m.json --plan plan.csv --rig rig.toml --out out.csv")
    found = read_csv(here / "out.csv", min_samples=2).columns
    for name in ("q1_rad", "q2_rad"):
        assert np.sqrt(np.mean((found[name] - run[name]) ** 2)) < 2.0 * 2.0 * np.pi / COUNTS
    assert np.abs(found["tau2_nm"]).max() <= 1.0 + 1e-9


def test_what_is_lacking_is_named(tmp_path: Path, run: Dataset) -> None:
    write_csv(Dataset("plan", 100.0, run.time_s, {"q2_rad": run["q2_rad"]}), tmp_path / "plan.csv")
    model = load_model(write_model(tmp_path / "m.json", list(BODY.beta()), SETTINGS))
    with pytest.raises(InputError, match="q2_cmd_rad is missing"):
        follow_commands(model, tmp_path / "plan.csv", parse_rig(RIG), "m.json")
    with pytest.raises(InputError, match="no gain under"):
        follow_commands(model, tmp_path / "plan.csv", parse_rig(RIG.split("[servo]")[0]), "m.json")


@pytest.mark.parametrize("std_s, said", [(0.001, "act 12 ms late, +-2 ms"), (4e55, "do not show how late")])
def test_a_delay_that_the_runs_do_not_show_has_no_interval_of_years(std_s: float, said: str) -> None:
    servo = parse_rig(RIG).servo
    result: Any = SimpleNamespace(mechanism=leg2(), loop=(LoopTerm("delay_s", 1, 0.012, std_s),), trajectories=())
    assert servo is not None
    assert said in loop_findings(result, servo)[0].text
