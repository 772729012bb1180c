"""`nuisances_of`: what may be wrong with a rig, column by column, and by how much.

A tolerance is the standard deviation of a size before any run. The rig file states it, or the effect has a default.
Defaults of sizes whose unit has a torque are for a rig whose torques reach 1 N m, and are scaled by those of the runs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.effects import (
    WHEEL_M,
    Effect,
    EncoderEffect,
    GearEffect,
    GenericReading,
    GenericTorque,
    ImuEffect,
    LawEffect,
    SensorEffect,
    Size,
    VelocityFilter,
    battery,
    classes,
    library,
)
from estimator.likelihood import Candidate, LatentProblem
from estimator.model import Mechanism
from estimator.score.score import Score

BEYOND = 2.0
"""Tolerances, 1 sigma, beyond which a size is a fault: about the 95 % interval of what a rig may have."""
TORQUE_GAIN, GAIN = "torque_gain", 0.05
"""The scale of the measured torque, and its default tolerance."""
GAIN_SOURCE = "a torque constant by its data sheet, +-10 %; legid calibrate shunt --weight shows it"
STRUCTURE = "structure"
"""Source of all generic terms together."""
ONLY = "none"
"""Key of stated tolerances: what is not stated has none."""
SHAPES = 3
"""Most points of an effect's grid of shapes: what lies between two is nearly in their span."""
REACHED = 0.99
"""Quantile of the measured torque's size that counts as its reach."""
POWERS_OF_U = {"u": 1, "u^2": 2}
"""Generic term -> power of the motor's torque that it is: its tolerance is for a torque that reaches one."""
Stated = Mapping[str, Sequence[float]]
"""Effect, or effect@joint, to the tolerance of each size."""


class Nuisance(NamedTuple):
    """One column: a size of something that may be wrong."""

    source: str
    """The effect's key, or STRUCTURE."""
    group: str
    """Of what is enlarged together."""
    tolerance: float
    size: int = 0
    """Which of its sizes."""
    reading: bool = False
    """Whether it is of what a sensor reads, in a form that is known."""


def small_effects(problem: LatentProblem) -> tuple[Candidate, ...]:
    """Effects of the library that small sizes define, and that are no parameters of `problem` yet."""
    return tuple(Candidate(effect, effect.usual) for effect in _listed(problem) if effect.usual is not None)


def nuisance_candidates(problem: LatentProblem, stated: Stated) -> tuple[Candidate, ...]:
    """`small_effects`; then every other effect of the library with a tolerance; then generic terms.

    A fit and a diagnosis have one order: the last digits of two orders put them 7e-5 standard errors apart.
    """
    m = problem.mechanism
    others = [effect for effect in _listed(problem) if effect.usual is None] + [VelocityFilter(j) for j in m.followers]
    found = [Candidate(effect, shape) for effect in others if any(_stated(effect, stated))
             for shape in _thinned(effect)]
    generic = [] if ONLY in stated and STRUCTURE not in stated else battery(m, problem.has_imu, _encoders(problem))
    return (*small_effects(problem), *found, *map(Candidate, generic))


def nuisances_of(candidates: Sequence[Candidate], problem: LatentProblem, stated: Stated) -> list[Nuisance]:
    """One for each column of `candidates`."""
    reach = torque_reach(problem)
    return [Nuisance(*_place(one.effect), tolerance, k, isinstance(one.effect, SensorEffect)) for one in candidates
            for k, tolerance in enumerate(_tolerances(one.effect, stated, reach, problem.mechanism.length_unit == "m"))]


class WithGain(NamedTuple):
    """A score with the column of the torque's scale, and its nuisance; without either where there is none."""

    score: Score
    nuisances: tuple[Nuisance, ...] = ()


def with_torque_gain(score: Score, along: FloatArray, mechanism: Mechanism, stated: Stated) -> WithGain:
    """`score` with a last column for the scale of all torques, which moves the first m parameters by `along` (m,).

    tau_measured = (1 + g) tau, so that the parameters that the runs show are (1 + g) beta. None is added without a
    motor, or where the input is a voltage.
    """
    tolerance = float(next(iter(stated.get(TORQUE_GAIN, () if ONLY in stated else (GAIN,))), 0.0))
    if not mechanism.actuated or mechanism.force_unit == "V" or not tolerance:
        return WithGain(score)
    count = score.score.size
    wide = np.append(along, np.zeros(count - along.size))
    return WithGain(score.along(np.column_stack([np.eye(count), wide])),
                    (Nuisance(TORQUE_GAIN, TORQUE_GAIN, tolerance),))


def torque_reach(problem: LatentProblem) -> FloatArray:
    """(n,) quantile REACHED of the measured torque's size; of a joint without a motor, the largest of all joints'.

    Zero where no joint has a motor: nothing then tells how large an omitted torque may be, and only readings have
    tolerances.
    """
    driven = list(problem.mechanism.actuated)
    reach = np.zeros(problem.n)
    if driven:
        reach[driven] = np.quantile(np.abs(np.nan_to_num(problem.torque[:, driven])), REACHED, axis=0)
    return np.where(reach > 0.0, reach, reach.max(initial=0.0) or float(bool(driven)))


def default_tolerances() -> dict[str, tuple[float, ...]]:
    """Effect to the default of each of its sizes, for a rig whose torques reach 1 N m; without those that have none."""
    found = {kind.name: tuple(size.tolerance for size in kind.sizes) for kind in classes()}
    return {TORQUE_GAIN: (GAIN,), **{name: sizes for name, sizes in found.items() if any(sizes)}}


def tolerance_sources() -> dict[str, str]:
    """Effect to where its defaults come from."""
    return {TORQUE_GAIN: GAIN_SOURCE, **{kind.name: kind.tolerance_source for kind in classes()}}


def torque_power(unit: str) -> int:
    """Power of a torque or force that a unit has: 1 of N m/rad and of kg m^2, -1 of rad/(N m), 0 of rad/s."""
    over, _, under = unit.partition("/")
    if found := re.search(r"\(N m\)\^(\d)", under):
        return -int(found[1])
    return int(bool(re.search(r"\bN\b|\bkg\b", over))) - int(bool(re.search(r"\bN\b|\bkg\b", under)))


def _encoders(problem: LatentProblem) -> list[int]:
    return [int(j) for j in np.flatnonzero(problem.has_encoder)]


def _listed(problem: LatentProblem) -> list[Effect]:
    """Of the library, without those that `problem` has."""
    own = {effect.key for effect in problem.effects}
    return [effect for effect in library(problem.mechanism, problem.has_imu, _encoders(problem))[0]
            if effect.key not in own]


def _thinned(effect: Effect) -> list[tuple[float, ...]]:
    grid = effect.grid()
    return [grid[round(k)] for k in np.linspace(0, len(grid) - 1, min(SHAPES, len(grid)))]


def _stated(effect: Effect, stated: Stated) -> tuple[float, ...]:
    """Tolerances as stated or by default, not scaled."""
    own = stated.get(effect.key, stated.get(effect.name))
    if own is not None:
        return tuple(own)[: len(effect.sizes)] + (0.0,) * (len(effect.sizes) - len(own))
    return tuple(0.0 if ONLY in stated else size.tolerance for size in effect.sizes)


def _tolerances(effect: Effect, stated: Stated, reach: FloatArray, slide: bool) -> list[float]:
    if isinstance(effect, GenericTorque | GenericReading):
        factor = float(stated.get(STRUCTURE, (1.0,))[0]) * _raised(reach.max(), -POWERS_OF_U.get(effect.label, 0))
        if slide and isinstance(effect, GenericReading) and effect.channel.kind == "encoder":
            factor *= WHEEL_M
        return [factor * _scaled(size, effect, reach) for size in effect.sizes]
    if effect.key in stated or effect.name in stated:
        return list(_stated(effect, stated))
    return [0.0 if ONLY in stated else _scaled(size, effect, reach) for size in effect.sizes]


def _scaled(size: Size, effect: Effect, reach: FloatArray) -> float:
    scale = _raised(reach.max() if effect.joint is None else reach[effect.joint], torque_power(size.unit))
    wheel = WHEEL_M if effect.slide and re.match(r"rad\b", size.unit) else 1.0
    return size.tolerance * scale * wheel


def _raised(reach: float, power: int) -> float:
    """`reach` to a power of torque; zero where nothing is driven and the power is not zero."""
    return float(reach**power) if reach > 0.0 else float(power == 0)


def _place(effect: Effect) -> tuple[str, str]:
    """(source, group)"""
    joint = f" {(effect.joint or 0) + 1}"
    if isinstance(effect, GenericTorque):
        return STRUCTURE, f"{STRUCTURE} of torque{joint}"
    if isinstance(effect, GenericReading):
        return STRUCTURE, f"{STRUCTURE} of {effect.channel}"
    if isinstance(effect, GearEffect):
        return effect.key, f"gear{joint}"
    if isinstance(effect, ImuEffect):
        return effect.key, "IMU"
    if isinstance(effect, EncoderEffect):
        return effect.key, f"encoder{joint}"
    if isinstance(effect, LawEffect):
        return effect.key, f"torques at joint{joint}"
    return effect.key, effect.key
