"""A model with effects: checked, and run by the estimator's own likelihood and simulation.

An effect's torque is added to the equation of motion and its readings to the sensors, by the same class that found
it. Session time, which a friction that drifts depends on, starts at the first run given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daq import Dataset, FloatArray, WorkError
from estimator import FitOptions
from estimator.effects import Effect, placed
from estimator.fitting import Validation, iterate, noise_floors, start_state
from estimator.likelihood import ExtendedProblem, FreeRun, Latents, Noise, Stage, State, free_run
from estimator.model import Mechanism, simulate
from estimator.signals import SignalSet, angle_column, encoder_of, imu_columns, split_signals
from experiments.models.effect_library import known_effects
from experiments.models.mechanism_settings import build_mechanism
from experiments.models.schema import EffectValue, Model


def effects_fault(model: Model) -> str:
    """What is wrong with the model's effects; empty when all is well."""
    if not model.effects:
        return ""
    known = known_effects()
    for value in model.effects:
        if value.name not in known:
            return f"is extended by {value.name}, an effect that this installation does not know (see legid effects)"
        kind = known[value.name]
        if (value.joint is not None) != kind.per_joint:
            return f"`effects` gives {value.name} {'no' if kind.per_joint else 'a'} joint"
        for what, wanted, found in (("sizes", kind.sizes, value.sizes), ("shapes", kind.shapes, value.shapes)):
            if {w.name for w in wanted} != set(found):
                return f"`effects` gives {value.name} the {what} {', '.join(found) or 'none'}, it has " \
                       f"{', '.join(w.name for w in wanted) or 'none'}"
        if not all(math.isfinite(v) for v in (*value.sizes.values(), *value.shapes.values())):
            return f"`effects` gives {value.name} a size that is not finite"
    joints = len(model.reach)
    if any(value.joint is not None and value.joint > joints for value in model.effects) or not joints:
        return "`reach` does not give the angles of every joint that `effects` names"
    return ""


def effects_of(model: Model) -> list[tuple[Effect, FloatArray]]:
    """The model's effects with their sizes and shapes, in the estimator's order."""
    known, found, mechanism = known_effects(), [], build_mechanism(model.mechanism)
    for value in model.effects:
        kind = known[value.name]
        effect = placed(kind, None if value.joint is None else value.joint - 1, mechanism)
        size = [*(value.sizes[s.name] for s in kind.sizes), *(value.shapes[s.name] for s in kind.shapes)]
        found.append((effect, np.array(size)))
    return found


def effect_value(effect: Effect, size: FloatArray) -> EffectValue:
    """The other way round."""
    k = len(effect.sizes)
    return EffectValue(name=effect.name, joint=None if effect.joint is None else effect.joint + 1,
                       sizes={s.name: float(v) for s, v in zip(effect.sizes, size[:k])},
                       shapes={s.name: float(v) for s, v in zip(effect.shapes, size[k:])})


def parameter_vector(model: Model) -> FloatArray:
    """beta, then the sizes and shapes of each effect."""
    return np.concatenate([np.array(model.beta), *[size for _, size in effects_of(model)]])


def problem_of(model: Model, mechanism: Mechanism, signals: Sequence[SignalSet], session_s: float = 0.0
               ) -> ExtendedProblem:
    """The stretches of one run under the model's effects; the run begins at `session_s`."""
    begin = tuple(float(s.time_s[0] - signals[0].time_s[0]) for s in signals)
    stage = Stage((0,) * len(begin), tuple(session_s + b for b in begin), begin, np.array(model.reach, dtype=float),
                  model.gear_ratio)
    return ExtendedProblem(signals, mechanism, model.hold, stage, [effect for effect, _ in effects_of(model)])


def validate_extended(model: Model, mechanism: Mechanism, options: FitOptions, datasets: Sequence[Dataset]
                      ) -> list[Validation]:
    """Free run of every gap-free stretch from its estimated first state, under the measured torque.

    What is compared are the angles that the encoders would have read. Raises `FitError`.
    """
    found, session_s = [], 0.0
    for data in datasets:
        signals = split_signals([data], mechanism, options)
        problem = problem_of(model, mechanism, signals, session_s)
        state = smoothed_state(model, problem, signals, options)
        run = free_run(problem, state, problem.torque - problem.torque_readings(state.x, state.beta))
        for where, stretch in zip(np.split(np.arange(problem.total), problem.ends[:-1]), signals):
            found.append(_compared(data, mechanism, stretch, state, run, where))
        session_s += problem.total * problem.dt
    return found


def smoothed_state(model: Model, problem: ExtendedProblem, signals: Sequence[SignalSet], options: FitOptions) -> State:
    """Most likely motion with all parameters held: noise levels from the data first, then held as well.

    Raises `FitError` where the equations of the fit cannot be solved.
    """
    mechanism, beta = problem.mechanism, np.array(model.beta)
    begin = start_state(problem, list(signals), mechanism, options, np.zeros(mechanism.p, dtype=bool), beta)
    parameters = parameter_vector(model)
    state = State(begin.x, parameters, begin.noise, np.zeros((parameters.size, parameters.size)))
    held = np.zeros(parameters.size, dtype=bool)
    iterate(problem, state, held, options, noise_floors(problem, mechanism, beta))
    if not state.converged:  # levels that still creep, such as that of a passive joint whose model is exact
        iterate(problem, state, held, options, None)
    return state


def _compared(data: Dataset, mechanism: Mechanism, stretch: SignalSet, state: State, run: FreeRun | None,
              where: NDArray[np.intp]) -> Validation:
    reference = state.x.q[where].copy()
    rows = np.searchsorted(data.time_s, stretch.time_s)
    for j in range(mechanism.n):
        if angle_column(mechanism, j) in data:
            values = data[angle_column(mechanism, j)][rows]
            reference[:, j] = np.where(np.isfinite(values), values, reference[:, j])
    rate = state.x.v[where]
    q = np.full_like(reference, np.nan) if run is None else \
        np.stack([run.readings[encoder_of(j)][where] for j in range(mechanism.n)], axis=-1)
    v = np.full_like(reference, np.nan) if run is None else run.v[where]
    sums, rmse = {}, {}
    for j in range(mechanism.n):
        for name, error in ((angle_column(mechanism, j), q[:, j] - reference[:, j]),
                            (f"q{j + 1}d", v[:, j] - rate[:, j])):
            sums[name] = float(np.sum(error**2)) if run is not None else math.inf
            rmse[name] = float(np.sqrt(np.mean(error**2))) if run is not None else math.inf
    horizon_s = 0.0 if run is None else len(rows) / data.rate_hz
    return Validation(data.name, stretch.time_s, q, v, reference, rate, sums, rmse, horizon_s, run is None)


def simulate_extended(model: Model, mechanism: Mechanism, time_s: FloatArray, torque: FloatArray, q0: FloatArray
                      ) -> FreeRun:
    """Motion from rest at q0 (n,) under the acting torque (N, n), and what all sensors would read.

    Raises `WorkError` where the motion runs away.
    """
    rate = float((time_s.size - 1) / (time_s[-1] - time_s[0]))
    imus = len(mechanism.imus) if model.mechanism.has_imu else 0
    blank = dict.fromkeys([name for k in range(imus) for name in imu_columns(k)], np.zeros_like(time_s))
    signals = SignalSet("plan", rate, time_s, np.zeros_like(torque), torque, blank)
    problem = problem_of(model, mechanism, [signals])
    q, v, _ = simulate(mechanism, np.array(model.beta), q0, np.zeros_like(q0), torque, 1.0 / rate, model.hold)
    parameters = parameter_vector(model)
    noise = Noise(np.ones(mechanism.n), np.ones(mechanism.n))
    state = State(Latents(np.nan_to_num(q), np.nan_to_num(v), torque), parameters, noise,
                  np.zeros((parameters.size, parameters.size)))
    run = free_run(problem, state)
    if run is None:
        raise WorkError("the simulated motion runs away; check the model's parameters and the plan's torque")
    return run
