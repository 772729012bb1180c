"""Runs of little motion: no advice on signs that they do not show, no impossible precision, no fault without cause."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, parse_rig
from estimator.fitting import next_measurement
from estimator.fitting.next_measurement import INSTRUMENTS
from experiments.cli import main
from experiments.session import Setup, setup_of, suspect
from tests.support.fits import synthetic_fit
from tests.support.imported_files import table_of
from tests.support.mujoco_leg import Leg, random_leg, record
from tests.support.prescribed import negated
from tests.support.runs import without
from tests.support.shell import Shell

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
