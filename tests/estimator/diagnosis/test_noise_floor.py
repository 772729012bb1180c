"""The noise floor holds a disturbance that wanders, and not a law that the model lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq import FloatArray
from estimator.diagnosis.conclusion import base, nothing, with_noise
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.decision_rule import EDGE
from estimator.diagnosis.error_table import measure_errors, with_floor
from estimator.diagnosis.noise_check import noisy_sensors, with_declared_noise
from estimator.diagnosis.noise_floor import noise_floor
from estimator.diagnosis.model import Model, fit_nominal
from estimator.likelihood import Noise, Process
from estimator.model import leg2
from estimator.options import FitOptions
from estimator.prediction import FloorNoise
from tests.support.mujoco_leg import Leg, multisine, record
from tests.support.ornstein_uhlenbeck import disturbed_record

RUNS = 4


def nominal(wanders: bool, options: FitOptions | None = None) -> Model:
    """A leg's nominal model; its knee feels a disturbance, or a spring at the pivot is missing."""
    rng, leg = np.random.default_rng(8), Leg()
    time = np.arange(2000) / 100.0
    runs = [disturbed_record(leg, rng, 0.03, 0.2, f"run{k}") if wanders else
            record(leg, rng, tau=multisine(rng, time, 1.2), name=f"run{k}", spring=(0.5, 0.2)) for k in range(RUNS)]
    return fit_nominal(split_runs(runs, leg2(lever_arm=leg.lever), options or FitOptions()))


def error(model: Model, floor: FloorNoise | None) -> float:
    seeds = np.arange(len(model.split.confirm))
    table = measure_errors([model], model, seeds)
    return (table if floor is None else with_floor(table, floor, seeds)).error(0)


def test_a_disturbance_is_noise() -> None:
    model = nominal(True)
    floor = noise_floor(model)
    assert floor.noise.disturbance[1] == pytest.approx(0.03, rel=0.35)
    assert 0.08 < floor.noise.time_constant[1] < 0.5 and floor.repeated[1] < 0.2
    assert error(model, None) > 1.5 and error(model, floor) < 1.4
    told = nothing(with_noise(base(model, {}, None), model, floor)).sentence
    assert f"Noise includes an unmeasured torque of {floor.noise.disturbance[1]:.2g} N m (rms) at joint 2" in told
    quiet = floor._replace(noise=replace(floor.noise, disturbance=np.zeros(2)))
    assert "unmeasured" not in nothing(with_noise(base(model, {}, None), model, quiet)).sentence


def test_a_law_that_the_model_lacks_is_not() -> None:
    model = nominal(False)
    floor = noise_floor(model)
    assert floor.repeated[0] > 0.6
    assert error(model, floor) > EDGE


def test_a_process_has_its_level_and_time_constant() -> None:
    noise = Noise(np.array([0.01]), np.array([1e-4]), disturbance=np.array([0.5]), time_constant=np.array([0.2]))
    drawn: FloatArray = Process.of(noise, 0.01).draw(200_000, 0, np.random.default_rng(1))
    assert drawn.std() == pytest.approx(0.5, rel=0.03)
    assert np.corrcoef(drawn[:-20], drawn[20:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.03)


def test_a_sensor_is_held_at_the_noise_that_it_is_known_to_have() -> None:
    model = nominal(True, FitOptions(noise={"gyro_radps": 0.002}))
    (gyro,) = noisy_sensors(model)
    again = with_declared_noise(model)
    assert gyro.kind == "gyro" and again.state.noise.gyro[0] == pytest.approx(0.002, rel=1e-6)
