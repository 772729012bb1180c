"""Runs without a torque: swings of MuJoCo's leg, through the commands as they are typed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.runs import write_csv
from estimator import FitOptions, fit
from estimator.model import leg2
from experiments.judge import friction_shares
from tests.support.free_swing import swing
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.shell import Shell, document, values

STARTS = ((1.0, 0.5), (-0.8, 1.2), (0.6, -1.5), (1.3, -0.4))
RIG = '[mechanism]\nmodel = "leg2"\nactuated = {}\n'


@pytest.fixture(scope="module")
def leg() -> Leg:
    return replace(random_leg(77), viscous=(0.002, 0.0015), coulomb=(0.01, 0.004))


def files(folder: Path, leg: Leg, actuated: str, torque: bool, count: int = 2, seed: int = 78,
          quadratic: float = 0.0) -> list[Any]:
    """Swings as CSV files, and the arguments that name them and their rig."""
    rng = np.random.default_rng(seed)
    (folder / "rig.toml").write_text(RIG.format(actuated))
    paths = [folder / f"swing{k}.csv" for k in range(count)]
    for path, start in zip(paths, STARTS):
        write_csv(swing(leg, rng, start, quadratic=quadratic, torque=torque), path)
    return [*paths, "--rig", folder / "rig.toml"]


@pytest.mark.parametrize("actuated, torque", [("[2]", True), ("[]", True), ("[]", False)])
def test_with_one_parameter_given_the_others_follow(tmp_path: Path, leg: Leg, actuated: str, torque: bool,
                                                    shell: Shell) -> None:
    runs, beta = files(tmp_path, leg, actuated, torque), leg.beta()
    found = values(document("fit", *runs, "--fix", f"beta5={beta[4]}"))
    assert found[:5] == pytest.approx(beta[:5], rel=2e-3)
    assert found[5:] == pytest.approx(beta[5:], rel=0.03)
    text = shell.out
    assert "TRUST the ratios" in text and "torque 0" not in text
    # of what the joint loses Coulomb friction takes c |v|, viscous d v^2; held against the swing itself
    line, = (line for line in text.splitlines() if line.startswith("friction of joint 2"))
    qd = np.concatenate([np.gradient(np.loadtxt(path, delimiter=",", skiprows=1, usecols=2), 0.01)
                         for path in runs[:2]])
    dry, wet = beta[8] * np.sum(np.abs(qd)), beta[6] * np.sum(qd**2)
    share = float(line.split("takes ")[1].split(" %")[0])
    assert share == pytest.approx(100 * dry / (dry + wet), abs=3.0)


def test_no_share_is_told_where_a_fit_finds_no_friction(leg: Leg) -> None:
    """A hand that gives energy back, say: both terms end at their bounds."""
    run = swing(leg, np.random.default_rng(78), STARTS[0], seconds=5.0, torque=False)
    found = fit([run], leg2(actuated=()), FitOptions(sensors="encoder", fixed={"beta5": leg.beta()[4]}))
    assert [one.joint for one in friction_shares(found)] == [1, 2]
    (one,) = friction_shares(replace(found, beta=np.array([*found.beta[:6], 0.0, found.beta[7], 0.0])))
    assert one.joint == 1


def test_without_one_the_remedy_is_named_in_one_line(tmp_path: Path, leg: Leg, shell: Shell
                                                     ) -> None:
    runs = files(tmp_path, leg, "[2]", True, 1)
    for command in ("fit", "diagnose"):
        shell(command, *runs, *["--quiet"] * (command == "diagnose"), status=1)
        told = shell.err.strip().splitlines()[-1]
        assert "give one, e.g. --fix beta5=VALUE (m2*lc2 [kg m])" in told


@pytest.mark.slow
def test_a_drag_with_the_square_of_speed_is_told_from_the_other_forms(tmp_path: Path, leg: Leg) -> None:
    runs = files(tmp_path, leg, "[]", False, len(STARTS), 79, 0.004)
    told = document("diagnose", *runs, "--fix", f"beta5={leg.beta()[4]}", "--quiet")
    assert told["verdict"] == "named"
    cause, = told["causes"]
    assert (cause["effect"], cause["joint"]) == ("quadratic_drag", 2)
