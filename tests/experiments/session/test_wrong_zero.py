"""A joint that hangs elsewhere than at 0: its zero is estimated where gravity shows it, and asked for elsewhere."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daq import Dataset
from daq.rig import parse_rig
from experiments.session import prepare
from experiments.workflows import fit_runs
from tests.support.driven_pendulum import BETA, pendulum_run
from tests.support.servo_joint import GAIN, servo_run

JOINT = '[mechanism]\nmodel = "joint1"\nactuated = {}\n'
SERVO = JOINT.format([1]) + "[servo]\ngain = {}\ndamping = 0.1\nlimit = 100.0\n"


def free_swing() -> Dataset:
    """A pendulum of 0.02 kg m^2 and 0.05 kg m, read in steps of 1/2000 turn."""
    time = np.arange(1200) / 80.0
    q = solve_ivp(lambda t, x: [x[1], -9.81 * 2.5 * np.sin(x[0]) - 0.1 * x[1] - 0.1 * np.tanh(x[1] / 0.05)],
                  (0.0, 15.0), [0.9, 0.0], t_eval=time, rtol=1e-6).y[0]
    step = 2.0 * np.pi / 2000.0
    return Dataset("swing", 80.0, time, {"q1_rad": np.round(q / step) * step})


def off(data: Dataset, zero: float) -> Dataset:
    return replace(data, columns={name: x + zero if name.startswith("q1") else x for name, x in data.columns.items()})


MADE = {
    "a free swing": (free_swing, JOINT.format([]), {"beta2": 0.05}, -0.12),
    "a driven joint": (lambda: pendulum_run("r", 3), JOINT.format([1]), {}, 0.06),
    "a servo": (servo_run, SERVO.format(GAIN), {}, 0.08)}


@pytest.mark.parametrize("made", MADE)
def test_a_zero_that_is_not_hanging_is_estimated_and_told(made: str) -> None:
    make, text, fixed, zero = MADE[made]
    run, rig = make(), parse_rig(text)
    healthy = prepare([run], rig, choose=True, fixed=fixed)
    assert not [choice for choice in healthy.choices if choice.key == "encoder_zero"]
    found = prepare([off(run, zero)], rig, choose=True, fixed=fixed)
    (choice,) = [choice for choice in found.choices if choice.key == "encoder_zero"]
    told = re.search(r"q1 hangs at (\S+) rad, not at 0", str(choice))
    assert choice.value == (1,) and told is not None and float(told[1]) == pytest.approx(zero, abs=5e-3)
    difference = found.setup.datasets[0]["q1_rad"] - run["q1_rad"]
    assert np.nanmax(np.abs(difference)) < 6e-3 and np.nanstd(difference) < 1e-9
    asked = prepare([off(run, zero)], parse_rig(f"{text}[terms]\nencoder_zero = [1]\n"), fixed=fixed)
    assert np.nanmax(np.abs(asked.setup.datasets[0]["q1_rad"] - run["q1_rad"])) < 6e-3
    assert any("encoders' zeros are taken off" in note for note in asked.setup.notes)


def test_the_fit_has_the_parameters_of_the_true_zero() -> None:
    run, rig = pendulum_run("r", 3), parse_rig(JOINT.format([1]))
    right = fit_runs([run], rig, method="wls").result.beta
    repaired = fit_runs([off(run, 0.06)], rig, method="wls").result.beta
    np.testing.assert_allclose(repaired[:2], right[:2], rtol=0.02)
    np.testing.assert_allclose(repaired[:2], BETA[:2], rtol=0.05)


def test_a_zero_that_no_gravity_shows_is_asked_for() -> None:
    """About hanging a wrong zero of 3 degrees is a constant torque."""
    time = np.arange(600) / 50.0
    angle = 0.02 * np.sin(3.0 * time) + 0.01 * np.sin(7.0 * time + 1.0)
    angle += 1e-4 * np.random.default_rng(1).normal(size=600)
    torque = 0.1 * np.gradient(np.gradient(angle, time), time) + 1.2 * np.sin(angle)
    run = Dataset("small", 50.0, time, {"q1_rad": angle + 0.05, "tau1_nm": torque})
    found = prepare([run], parse_rig(JOINT.format([1]) + "[terms]\nencoder_zero = [1]\n"))
    np.testing.assert_array_equal(found.setup.datasets[0]["q1_rad"], run["q1_rad"])
    assert any("gravity does not show where the joints of encoder_zero hang" in note for note in found.setup.notes)
