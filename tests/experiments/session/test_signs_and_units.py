"""Remedies of a set-up that looks wrong: a unit is named where it explains the torque; little motion gets no advice."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, parse_rig
from estimator.fitting import next_measurement
from estimator.fitting.next_measurement import INSTRUMENTS
from estimator.model import joint1
from experiments.session import Setup, setup_of, suspect
from legid.cli import main
from tests.support.fits import synthetic_fit
from tests.support.imported_files import table_of
from tests.support.mujoco_leg import Leg, random_leg, record
from tests.support.prescribed import SWING_RIG, negated, swing_run, written
from tests.support.runs import with_columns, without
from tests.support.shell import Shell

DEGREES, TURNS = 180.0 / np.pi, 0.5 / np.pi


def turning_run() -> Dataset:
    """A driven joint that turns on for 9 turns, faster and slower."""
    rng, t = np.random.default_rng(1), np.arange(1000) / 100.0
    q = 6.0 * t + 0.8 * np.sin(3.0 * t) + 0.3 * np.sin(7.0 * t)
    v = 6.0 + 2.4 * np.cos(3.0 * t) + 2.1 * np.cos(7.0 * t)
    a = -7.2 * np.sin(3.0 * t) - 14.7 * np.sin(7.0 * t)
    tau = joint1().inverse_dynamics(q[:, None], v[:, None], a[:, None], np.array([0.1, 0.3, 0.02, 0.05]))[:, 0]
    return Dataset("turning.csv", 100.0, t, {"q1_rad": q + 1e-4 * rng.normal(size=t.size),
                                             "tau1_nm": tau + 0.02 * rng.normal(size=t.size)})


def geared_run() -> Dataset:
    """A swing whose inertia is that of the motor's rotor: 17 m of length by its gravity moment."""
    run = swing_run(viscous=0.5, coulomb=0.3)
    q = run["q1_rad"]
    more = np.gradient(np.gradient(q, 0.01), 0.01) * 0.4 - 0.27 * 9.81 * np.sin(q)
    return with_columns(run, tau1_nm=run["tau1_nm"] + more)


def fit_of(runs: list[Dataset], folder: Path, shell: Shell) -> tuple[int, str]:
    """Exit status of `legid fit` and all that it says."""
    rig = folder / "rig.toml"
    rig.write_text(SWING_RIG)
    status = main(["fit", *written(runs, folder), "--rig", str(rig)])
    return status, "".join(shell.read())


def test_a_geared_joint_is_told_of_its_rotor_and_of_no_unit(tmp_path: Path, shell: Shell) -> None:
    status, said = fit_of([geared_run()], tmp_path, shell)
    assert status == 0 and "beta1 over beta2 makes a length of 1" in said and "the motor's rotor" in said
    assert "looks" not in said and "NOT TO BE USED" not in said


@pytest.mark.parametrize("turns_on, factor, unit", [
    (True, DEGREES, "deg"), (True, TURNS, "turn"), (False, DEGREES, "deg")])
def test_a_unit_that_explains_the_torque_is_named(turns_on: bool, factor: float, unit: str, tmp_path: Path,
                                                  shell: Shell) -> None:
    run = turning_run() if turns_on else swing_run(viscous=0.02, coulomb=0.05, seconds=10.0)
    _, said = fit_of([with_columns(run, q1_rad=factor * run["q1_rad"])], tmp_path, shell)
    assert f'name = "q1_rad" and unit = "{unit}" under [columns.q1_rad]' in said


def test_a_joint_that_turned_on_is_not_asked_for_its_unit(tmp_path: Path, shell: Shell) -> None:
    run = turning_run()
    unexplained = with_columns(replace(run, name="noise.csv"), tau1_nm=np.random.default_rng(3).normal(size=len(run)))
    for one in (run, unexplained):
        _, said = fit_of([one], tmp_path, shell)
        assert "q1_rad swings" not in said and "unit = " not in said and "the columns cannot be right" not in said


def test_an_angle_that_swings_too_far_in_any_unit_is_to_be_checked(tmp_path: Path,
                                                                   shell: Shell) -> None:
    run = swing_run(viscous=0.02, seconds=10.0)
    unexplained = with_columns(run, q1_rad=4096 * TURNS * run["q1_rad"],
                               tau1_nm=np.random.default_rng(3).normal(size=len(run)))
    status, said = fit_of([unexplained], tmp_path, shell)
    assert status == 1 and "q1_rad swings over" in said and "check that it is the angle of this joint" in said
    assert "give its unit" not in said


@pytest.mark.parametrize("count", [1, 2])
def test_columns_that_are_right_are_not_to_be_checked(count: int, tmp_path: Path,
                                                      shell: Shell) -> None:
    """A motor that pushes along with every acceleration: no sign and no unit makes a mechanism of that."""
    runs = []
    for k in range(count):
        run = replace(swing_run(viscous=0.2, coulomb=0.2, seed=3 + k), name=f"swing{k}.csv")
        pushed = -0.2 * np.gradient(np.gradient(run["q1_rad"], 0.01), 0.01)
        runs.append(with_columns(run, tau1_nm=run["tau1_nm"] + pushed))
    status, said = fit_of(runs, tmp_path, shell)
    last = said.strip().splitlines()[-1]
    assert status == 1 and "no masses move like this" in last and "with --fix NAME=VALUE" in last
    assert "looks" not in last and ("--each" in last) == (count == 2)


READINGS = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")
JOINT = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'
LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'
IMU = LEG + "[imu]\nlever_arm_m = 0.2\n"


def one_sine(seed: int, frequency_hz: float, amplitude: float, noise: float) -> Dataset:
    """A pendulum of 0.05 kg m^2 and 0.12 kg m that follows one sine."""
    rng = np.random.default_rng(seed)
    t, w = np.arange(0.0, 20.0, 0.01), 2.0 * np.pi * frequency_hz
    phase = float(rng.uniform(0.0, 6.0))
    q, v = amplitude * np.sin(w * t + phase), amplitude * w * np.cos(w * t + phase)
    torque = (-0.05 * w**2 * q + 0.12 * 9.81 * np.sin(q) + 0.02 * v + 0.01 * np.tanh(v / 0.02))
    return Dataset("sine", 100.0, t, {"q1_rad": q + rng.normal(0.0, noise, t.size),
                                      "tau1_nm": torque + rng.normal(0.0, 0.03, t.size)})


def told(setup: Setup) -> tuple[str, ...]:
    found = suspect(setup.datasets, setup.mechanism, setup.options, 1.0, True)
    return (*found.remedies, *found.against)


@pytest.mark.parametrize("frequency_hz, amplitude, noise", [(0.8, 0.3, 2e-4), (2.0, 0.1, 1e-3)])
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 6, 7])
def test_one_sine_says_nothing_of_signs(frequency_hz: float, amplitude: float, noise: float, seed: int) -> None:
    assert told(setup_of([one_sine(seed, frequency_hz, amplitude, noise)], parse_rig(JOINT))) == ()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_leg_that_hardly_moves_says_nothing_of_signs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    run = record(random_leg(rng), rng, seconds=10.0, amplitude=0.1, high=0.3)
    imu, encoders = without(run, "q1_rad"), without(run, *READINGS)
    assert told(setup_of([imu], parse_rig(IMU))) == told(setup_of([encoders], parse_rig(LEG))) == ()


def test_a_sign_that_is_wrong_is_still_named() -> None:
    rng = np.random.default_rng(5)
    run = record(Leg(), rng, seconds=10.0)
    turned = without(negated(run, "tau2_nm"), *READINGS)
    assert told(setup_of([turned], parse_rig(LEG)))[0].startswith("tau2_nm looks negated")


def test_a_fit_of_little_motion_asks_for_motion(tmp_path: Path, shell: Shell) -> None:
    """It ended as "a mass that is not positive", with segments that disagree by numbers of ninety digits."""
    run = record(Leg(), 4, seconds=10.0, amplitude=0.08, high=1.0)
    file = table_of(without(run, "q1_rad"), tmp_path / "weak.csv")
    (tmp_path / "rig.toml").write_text(IMU)
    status = main(["fit", str(file), "--rig", str(tmp_path / "rig.toml"), "--json", str(tmp_path / "f.json")])
    said = shell.read()
    document = json.loads((tmp_path / "f.json").read_text())
    first = said.out.splitlines()[0]
    assert "not positive" not in said.out and "negated" not in said.out + said.err
    assert not re.search(r"\d{12}", said.out)
    assert first.startswith("NOT TO BE USED") == bool(document["inadmissible"]) == (status == 1)
    assert "not all are determined" in first


@pytest.mark.parametrize("share", [1.0, 1e-9])
def test_no_value_is_to_be_measured_finer_than_an_instrument_measures(share: float) -> None:
    result = synthetic_fit()
    shared = 0.2 * result.beta  # all parameters err together
    small = replace(result, beta=share * result.beta,
                    covariance=share**2 * (result.covariance + np.outer(shared, shared)))
    advice = next_measurement(small)
    if share == 1.0:
        assert not advice.source
        units = {p.name: p.unit for p in result.mechanism.parameters}
        assert advice.std >= INSTRUMENTS[units.get(advice.name, "m")]
    else:
        assert advice is None
