"""A leg in MuJoCo with a magnet near its knee's middle, and the structure learnt from its runs."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from estimator import FitOptions
from estimator.model import leg2
from estimator.prediction import FittedModel, RunSignals, Structure, find_structure
from estimator.signals import split_signals
from tests.support.mujoco_leg import Leg, record

OPTIONS = FitOptions(sensors="encoder", hold="linear", noise={"encoder_rad": 2.3e-4})
FRICTION_VELOCITY = 0.02
Law = Callable[[float, float, float, float], tuple[float, float]]


def magnet(q1: float, q2: float, v1: float, v2: float) -> tuple[float, float]:
    """Torques that act on pivot and knee [N m]."""
    return 0.0, -0.3 * (q2 - 0.1) / 0.3 * math.exp(-(((q2 - 0.1) / 0.3) ** 2))


def true_model() -> FittedModel:
    """The leg's true parameters, without any law."""
    return FittedModel(leg2(actuated=(1,), velocity_scale=FRICTION_VELOCITY), "linear", Leg().beta())


def runs_of(law: Law | None, seed: int, count: int, seconds: float = 5.0) -> list[RunSignals]:
    """Runs of the leg, read by both encoders."""
    data = [record(Leg(), np.random.default_rng([seed, k]), seconds=seconds, amplitude=1.0, name=f"r{k}", law=law,
                   friction_velocity=FRICTION_VELOCITY, torque=0.01) for k in range(count)]
    return [RunSignals(d.name, tuple(split_signals([d], true_model().mechanism, OPTIONS))) for d in data]


@cache
def hidden_magnet() -> Structure:
    """Learnt from five runs, each left out once."""
    found = find_structure(true_model(), runs_of(magnet, 1, 5), OPTIONS)
    assert found is not None
    return found
