"""Runs of a driven pendulum that may feel more than its nominal model knows: short, for whole diagnoses in seconds."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from daq import Dataset, FloatArray
from estimator import FitOptions
from estimator.diagnosis.context import DiagnosisContext, detected, generic_extension, scored
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.family import FittedFamily, family_of
from estimator.diagnosis.model import Model, nominal_model
from estimator.diagnosis.search import search
from estimator.effects import battery, library
from estimator.likelihood import Candidate
from estimator.model import Mechanism, joint1
from estimator.score import ScoreTests

RATE_HZ, SECONDS = 50.0, 6.0
BETA = np.array([0.05, 0.12, 0.04, 0.03])
"""Inertia [kg m^2], m lc [kg m], viscous [N m s/rad] and dry friction [N m]."""
SMOOTHING = 0.05
"""Friction has its full level from about this speed on [rad/s]."""
TRIED = ("quadratic_drag", "joint_stiffness", "torque_offset", "stribeck_friction", "asymmetric_friction",
         "torque_delay")


def mechanism() -> Mechanism:
    return joint1(velocity_scale=SMOOTHING)


def pendulum_run(name: str, seed: int, drag: float = 0.0, spring: float = 0.0, noise: float = 1.0) -> Dataset:
    """`drag` [N m s^2/rad^2] with the square of its speed, `spring` [N m/rad] about its lowest point; `noise` times
    that of its sensors, 0.2 mrad and 5 mN m."""
    rng = np.random.default_rng(seed)
    grid = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    tones = rng.uniform(1.0, 9.0, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    torque = (0.4 + 0.1 * rng.random()) * np.sum(np.sin(np.outer(grid, tones[0]) + tones[1]), axis=1)
    inertia, moment, viscous, coulomb = BETA

    def rates(t: float, y: FloatArray) -> list[float]:
        load = 9.81 * moment * np.sin(y[0]) + spring * y[0]
        lost = viscous * y[1] + coulomb * np.tanh(y[1] / SMOOTHING) + drag * y[1] * abs(y[1])
        return [y[1], (np.interp(t, grid, torque) - load - lost) / inertia]

    q = solve_ivp(rates, (0.0, grid[-1]), [0.0, 0.0], t_eval=grid, rtol=1e-7, atol=1e-9, max_step=5e-3).y[0]
    return Dataset(name, RATE_HZ, grid, {"q1_rad": q + 2e-4 * noise * rng.normal(size=q.size),
                                         "tau1_nm": torque + 0.005 * noise * rng.normal(size=q.size)})


def pendulum_runs(count: int, **hidden: float) -> list[Dataset]:
    return [pendulum_run(f"r{k}", 70 + k, **hidden) for k in range(count)]


class Searched(NamedTuple):
    """All of a diagnosis that the train runs say."""

    context: DiagnosisContext
    tests: ScoreTests
    generic: Model | None
    found: list[Explanation]
    family: FittedFamily


def search_runs(runs: Sequence[Dataset], velocity_scale: float = SMOOTHING) -> Searched:
    """With the effects of TRIED and six generic terms."""
    split = split_runs(runs, joint1(velocity_scale=velocity_scale), FitOptions(sensors="encoder"))
    effects = [e for e in library(split.mechanism, False, split.encoders)[0] if e.name in TRIED]
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    named = len(candidates)
    candidates += [Candidate(e) for e in battery(split.mechanism, False, split.encoders)[:6]]

    def say(stage: str, fraction: float) -> None:
        pass

    context, tests = scored(nominal_model(split), candidates, named, np.random.default_rng(0), say)
    generic = generic_extension(context, context.nominal, tests) if detected(context, tests) else None
    found = search(context, tests, say)
    return Searched(context, tests, generic, found, family_of(context, found, generic))


@cache
def searched(drag: float = 0.0, spring: float = 0.0) -> Searched:
    """Of four runs with this much hidden."""
    return search_runs(pendulum_runs(4, drag=drag, spring=spring))
