"""A model with effects: checked, and run by the estimator's own likelihood and simulation.

An effect's torque is added to the equation of motion and its readings to the sensors, by the same class that found
it. Session time, which a friction that drifts depends on, starts at the first run given.
"""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np

from daq import FloatArray, WorkError
from estimator import TWO_SIDED
from estimator.effects import Effect, Shape, placed
from estimator.likelihood import FreeRun, Latents, Noise, State, free_run
from estimator.model import Mechanism, simulate
from estimator.prediction import FittedModel
from estimator.score import TORQUE_GAIN
from estimator.signals import SignalSet, imu_columns
from experiments.models.effect_library import known_effects
from experiments.models.mechanism_settings import build_mechanism
from experiments.models.schema import EffectValue, Model
from experiments.models.structure import laws_of


def effects_fault(model: Model) -> str:
    """Faults of the model's effects; empty without any."""
    if not model.effects:
        return ""
    known = known_effects()
    for value in model.effects:
        if value.name not in known:
            return f"is extended by {value.name}, an effect that this installation does not know (see legid effects)"
        kind = known[value.name]
        if (value.joint is not None) != kind.per_joint and not kind.per_motor:  # a motor's may have one or not
            return f"`effects` gives {value.name} {'no' if kind.per_joint else 'a'} joint"
        shapes = shapes_of(kind, value)
        for what, wanted, found in (("sizes", kind.sizes, value.sizes), ("shapes", shapes, value.shapes)):
            if {w.name for w in wanted} != set(found):
                return f"`effects` gives {value.name} the {what} {', '.join(found) or 'none'}, it has " \
                       f"{', '.join(w.name for w in wanted) or 'none'}"
        if not all(math.isfinite(v) for v in (*value.sizes.values(), *value.shapes.values())):
            return f"`effects` gives {value.name} a size that is not finite"
    joints = len(model.reach)
    if any(value.joint is not None and value.joint > joints for value in model.effects) or not joints:
        return "`reach` does not give the angles of every joint that `effects` names"
    return ""


def with_default_shapes(model: Model) -> Model:
    """The model with the shapes that its file does not state and an effect has a default for; held, so known exactly.

    A file of a release before the shape existed lacks it.
    """
    if not model.effects:
        return model
    known, effects = known_effects(), []
    covariance, at = [list(row) for row in model.covariance], len(model.parameters)
    for value in model.effects:
        kind, shapes = known.get(value.name), dict(value.shapes)
        at += len(value.sizes)
        for place, shape in enumerate(kind.shapes if kind else ()):
            if shape.name not in shapes and shape.default is not None:
                shapes[shape.name] = shape.default
                for row in covariance:
                    row.insert(at + place, 0.0)
                covariance.insert(at + place, [0.0] * (len(covariance) + 1))
        at += len(shapes)
        effects.append(msgspec.structs.replace(value, shapes=shapes))
    return msgspec.structs.replace(model, effects=tuple(effects), covariance=tuple(map(tuple, covariance)))


def shapes_of(kind: type[Effect], value: EffectValue) -> tuple[Shape, ...]:
    """Shapes of an effect in a model, those that it has behind a position loop included."""
    behind = {s.name for s in kind.loop_shapes} <= set(value.shapes)
    return (*kind.shapes, *kind.loop_shapes) if behind else kind.shapes


def effects_of(model: Model) -> list[tuple[Effect, FloatArray]]:
    """The model's effects with their sizes and shapes, in the estimator's order."""
    known, found, mechanism = known_effects(), [], build_mechanism(model.mechanism)
    for value in model.effects:
        kind = known[value.name]
        joint, shapes = None if value.joint is None else value.joint - 1, shapes_of(kind, value)
        behind = replace(mechanism, followers=(joint,)) if joint is not None and shapes != kind.shapes else mechanism
        effect = placed(kind, joint, behind)
        size = [*(value.sizes[s.name] for s in kind.sizes), *(value.shapes[s.name] for s in shapes)]
        found.append((effect, np.array(size)))
    return found


def effect_value(effect: Effect, size: FloatArray) -> EffectValue:
    """The other way round."""
    k = len(effect.sizes)
    return EffectValue(name=effect.name, joint=effect.joint_number,
                       sizes={s.name: float(v) for s, v in zip(effect.sizes, size[:k])},
                       shapes={s.name: float(v) for s, v in zip(effect.shapes, size[k:])})


def widening_of(model: Model) -> list[float]:
    """Width of each 95 % interval of a parameter or size, over that by its standard deviation alone."""
    out = [1.0] * len(model.covariance)
    for k, (parameter, interval) in enumerate(zip(model.parameters, model.ci95)):
        variance = model.covariance[k][k]
        if interval is not None and variance and interval[0] < parameter.value:
            out[k] = (interval[1] - interval[0]) / (2.0 * TWO_SIDED * math.sqrt(variance))
    return out


def shown_covariance(model: Model) -> FloatArray:
    """(m, m) covariance without the scale of the torque, which no run shows and which all models of a rig share."""
    covariance = np.array([[np.nan if c is None else c for c in row] for row in model.covariance], dtype=float)
    for part in model.budget:
        if part.source == TORQUE_GAIN:
            rows = np.array(part.directions)
            covariance[: rows.shape[1], : rows.shape[1]] -= rows.T @ rows
    return covariance


def fitted_model_of(model: Model) -> FittedModel:
    """The model of a file, its covariance widened to its intervals.

    It is without the scale of the torque, which the torque of every run shares with the parameters.
    """
    mechanism, wide = build_mechanism(model.mechanism), np.array(widening_of(model))
    pairs, covariance = effects_of(model), shown_covariance(model)
    return FittedModel(mechanism, model.hold, np.concatenate([np.array(model.beta), *[size for _, size in pairs]]),
                       (*(effect for effect, _ in pairs), *laws_of(model)), wide[:, None] * wide * covariance,
                       angle_range=np.array(model.reach, dtype=float) if pairs else None, gear_ratio=model.gear_ratio)


def simulate_extended(model: Model, mechanism: Mechanism, time_s: FloatArray, torque: FloatArray, q0: FloatArray
                      ) -> FreeRun:
    """Motion from rest at q0 (n,) under the acting torque (N, n), and what all sensors would read.

    Raises `WorkError` where the motion diverges.
    """
    rate = float((time_s.size - 1) / (time_s[-1] - time_s[0]))
    imus = len(mechanism.imus) if model.mechanism.has_imu else 0
    blank = dict.fromkeys([name for k in range(imus) for name in imu_columns(k)], np.zeros_like(time_s))
    signals = SignalSet("plan", rate, time_s, np.zeros_like(torque), torque, blank)
    fitted = fitted_model_of(model)
    problem = fitted.problem([signals])
    q, v, _ = simulate(mechanism, np.array(model.beta), q0, np.zeros_like(q0), torque, 1.0 / rate, model.hold)
    parameters = fitted.parameters
    noise = Noise(np.ones(mechanism.n), np.ones(mechanism.n))
    state = State(Latents(np.nan_to_num(q), np.nan_to_num(v), torque), parameters, noise,
                  np.zeros((parameters.size, parameters.size)))
    run = free_run(problem, state)
    if run is None:
        raise WorkError("the simulated motion diverges; check the model's parameters and the plan's torque")
    return run
