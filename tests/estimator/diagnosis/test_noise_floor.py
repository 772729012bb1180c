"""The noise floor holds a disturbance that wanders, and not a law that the model lacks."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from pytest import approx

from daq import FloatArray
from estimator import FitOptions
from estimator.diagnosis.account import base, nothing, with_noise
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.decision_rule import EDGE, WHOLE_RUNS
from estimator.diagnosis.error_table import NOMINAL, floor_of, measure, sensors_of
from estimator.diagnosis.family import _Rows, hidden_motion
from estimator.diagnosis.model import Model, nominal_model, smooth
from estimator.diagnosis.noise_check import noisy_sensors
from estimator.diagnosis.noise_floor import noise_floor
from estimator.likelihood import Noise, Process
from estimator.model import leg2
from estimator.prediction import FloorNoise, channel_names, floor_errors, white_noise
from tests.support.mujoco_leg import Leg, multisine, record
from tests.support.ornstein_uhlenbeck import disturbed_record

RUNS = 4


def nominal(wanders: bool, options: FitOptions | None = None) -> Model:
    """A leg's nominal model; its knee feels a disturbance, or a spring at the pivot is missing."""
    rng, leg = default_rng(8), Leg()
    time = np.arange(2000) / 100.0
    runs = [disturbed_record(leg, rng, 0.03, 0.2, f"run{k}") if wanders else
            record(leg, rng, tau=multisine(rng, time, 1.2), name=f"run{k}", spring=(0.5, 0.2)) for k in range(RUNS)]
    return nominal_model(split_runs(runs, leg2(lever_arm=leg.lever), options or FitOptions()))


def error(model: Model, floor: FloorNoise) -> float:
    return measure([model], NOMINAL, floor, default_rng(0), [NOMINAL]).error(NOMINAL)


def test_a_disturbance_is_noise() -> None:
    model = nominal(True)
    floor = noise_floor(model)
    assert floor.noise.disturbance[1] == approx(0.03, rel=0.35)
    assert 0.08 < floor.noise.time_constant[1] < 0.5 and floor.repeated[1] < 0.2
    assert error(model, white_noise(model.state.noise)) > 1.5 and error(model, floor) < 1.4
    told = nothing(with_noise(base(model, {}, None), model, floor)).sentence
    assert f"Noise includes an unmeasured torque of {floor.noise.disturbance[1]:.2g} N m (rms) at joint 2" in told
    quiet = floor._replace(noise=replace(floor.noise, disturbance=np.zeros(2)))
    assert "unmeasured" not in nothing(with_noise(base(model, {}, None), model, quiet)).sentence


def test_a_law_that_the_model_lacks_is_not() -> None:
    model = nominal(False)
    floor = noise_floor(model)
    assert floor.repeated[0] > 0.6
    assert error(model, floor) > EDGE
    is_a_mean_of_replicates_over_whole_runs(model, floor)


def is_a_mean_of_replicates_over_whole_runs(model: Model, floor: FloorNoise) -> None:
    """A leg that sticks left 1.0 to 8.5 floors by the one replicate that was drawn."""
    run, horizons, rng = model.split.test[0], (0.1, np.inf), default_rng(5)
    fitted = smooth(model, run)
    found = floor_of(model, run, fitted, 5, horizons, floor, 2)[:, sensors_of(model).index("q2_rad")]

    def drawn(over: tuple[float, ...]) -> FloatArray:
        errors = floor_errors(fitted, rng, over, lambda signals: model.split.problem(
            [run], model.problem.stage.angle_range, signals=signals), floor)
        return errors[:, channel_names(fitted.problem).index("q2_rad")] ** 2

    first = drawn(horizons)
    whole = np.mean([first[1], *(drawn((np.inf,))[0] for _ in range(WHOLE_RUNS // 2 - 1))], axis=0)
    assert found[0] == approx(first[0]) and found[1] == approx(whole)


def test_a_process_has_its_level_and_time_constant() -> None:
    noise = Noise(np.array([0.01]), np.array([1e-4]), disturbance=np.array([0.5]), time_constant=np.array([0.2]))
    drawn: FloatArray = Process.of(noise, 0.01).draw(200_000, 0, default_rng(1))
    assert drawn.std() == approx(0.5, rel=0.03)
    assert np.corrcoef(drawn[:-20], drawn[20:])[0, 1] == approx(np.exp(-1.0), abs=0.03)


def test_a_sensor_is_held_at_the_noise_that_it_is_known_to_have() -> None:
    model = nominal(True, FitOptions(noise={"gyro_radps": 0.002}))
    (gyro,) = noisy_sensors(model)
    rows = _Rows(model)
    hidden = hidden_motion(rows, NOMINAL)
    assert hidden is not None and hidden.declared == 1 and hidden.stated and "gyro" in hidden.text
    assert gyro.kind == "gyro" and rows.models[1].state.noise.gyro[0] == approx(0.002, rel=1e-6)
