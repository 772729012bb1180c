"""Noise that a fit finds against what the rig declares."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimator.diagnosis.noise_check import in_words, noise_ratios, noisy_sensors
from estimator.likelihood import Noise
from estimator.model import leg2
from estimator.signals import ACCEL_X, ACCEL_Y, GYRO, encoder_of

DECLARED = {"torque_nm": 0.02, "encoder_rad": 2e-4, "gyro_radps": 0.005, "accel_mps2": 0.05}


def model_of(declared: dict[str, float], **found: float) -> Any:
    """A model whose noise levels are those declared but for `found`."""
    levels = {"pivot": 0.002, "knee": 0.02, "encoder": 2e-4, "gyro": 0.005, "accel": 0.05} | found
    noise = Noise(np.array([levels["pivot"], levels["knee"]]), np.array([np.inf, levels["encoder"]]),
                  np.array([levels["gyro"]]), np.array([[levels["accel"], levels.get("accel_y", levels["accel"])]]))
    shown = Noise(np.zeros(2), np.array([np.inf, 2e-4]), np.array([0.005]), np.array([[0.05, 0.05]]))
    problem = SimpleNamespace(has_encoder=np.array([False, True]), imu_count=1, shown=shown)
    split = SimpleNamespace(known=declared, mechanism=leg2())
    return SimpleNamespace(split=split, problem=problem, state=SimpleNamespace(noise=noise))


def told(model: Any) -> list[str]:
    return [in_words(*one) for one in noisy_sensors(model).items()]


@pytest.mark.parametrize(("channel", "level", "said"), [
    ("gyro", 0.095, "gyro is 19.0 times"), ("accel", 0.08, "accelerometer's x axis is 1.6 times"),
    ("accel_y", 0.08, "accelerometer's y axis is 1.6 times"), ("encoder", 0.002, "encoder of joint 2 is 10.0 times")])
def test_a_sensor_noisier_than_declared_is_named(channel: str, level: float, said: str) -> None:
    assert told(model_of(DECLARED)) == []
    assert any(said in text for text in told(model_of(DECLARED, **{channel: level})))


def test_without_a_declared_level_neighbouring_samples_stand_in() -> None:
    assert set(noise_ratios(model_of({}))) == {GYRO, ACCEL_X, ACCEL_Y, encoder_of(1)}
    assert told(model_of({}, gyro=0.011)) == [] and "gyro" in told(model_of({}, gyro=0.02))[0]


@pytest.mark.parametrize("declared", [{}, DECLARED])
def test_a_sensor_that_is_noisier_than_its_neighbouring_samples_is_listed(declared: dict[str, float]) -> None:
    """The torque is not: a disturbance makes it noisier on healthy legs, too."""
    assert not noisy_sensors(model_of(declared, knee=1.0, pivot=1.0))
    (encoder,) = noisy_sensors(model_of(declared, encoder=0.015)).items()
    (gyro,) = noisy_sensors(model_of(declared, gyro=0.02)).items()
    assert "encoder of joint 2 is 75.0 times" in in_words(*encoder) and "gyro is 4.0 times" in in_words(*gyro)
