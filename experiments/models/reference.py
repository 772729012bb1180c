"""The block `reference` of MODEL.json: what reference runs say, without the runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from msgspec import structs

from daq import FloatArray, InputError
from estimator import FitOptions
from estimator.change import LogLevels, Reference, Structure, known_reference
from estimator.free_runs import FittedModel
from estimator.likelihood import Noise
from estimator.loops import LawSize, LawSizes
from estimator.score import Score
from experiments.models.effect_library import known_effects
from experiments.models.mechanism_settings import build_mechanism
from experiments.models.schema import LawValues, MechanismSettings, Model, ReferenceValues

REMEDY = "give the runs that it was fitted to, or write it again: legid diagnose RUN... --model-out MODEL.json"


def reference_values_of(reference: Reference) -> ReferenceValues:
    """The block of a reference."""
    fit, structure, model = reference.fit, reference.structure, reference.fit.model
    noise = {"torque": fit.noise.torque, "encoder": fit.noise.encoder, "gyro": fit.noise.gyro,
             "accel": fit.noise.accel.ravel()}
    if fit.noise.torque_correlation is not None:
        noise["torque_correlation"] = fit.noise.torque_correlation.ravel()
    upper = np.triu_indices(reference.known.score.size)
    return ReferenceValues(
        runs=reference.runs, sensors=fit.options.sensors,  # type: ignore[arg-type]
        hold=model.hold, friction_velocity_radps=tuple(map(float, model.mechanism.velocity_scales)),
        followers=tuple(j + 1 for j in model.mechanism.followers),
        beta=tuple(map(float, model.beta)), reach=tuple((float(a), float(b)) for a, b in model.reach),
        noise={kind: tuple(float(x) if np.isfinite(x) else None for x in levels) for kind, levels in noise.items()},
        common=structure.common, own=structure.own, freedom=structure.freedom, unit=tuple(map(float, structure.unit)),
        drift=tuple(map(float, structure.drift)) if structure.drift.any() else (),
        columns=fit.columns, score=tuple(map(float, reference.known.score)),
        information=reference.known.information[upper].astype("<f8").tobytes(), levels=dict(reference.noise.levels),
        errors=dict(reference.errors.levels),
        law=tuple(LawValues(effect=effect, joint=joint + 1, size=tuple(map(float, one.size)), blocks=one.blocks,
                            std=tuple(float(x) if np.isfinite(x) else None for x in one.std))
                  for (joint, effect), one in reference.law.every().items()))


def reference_of(model: Model, where: str, settings: MechanismSettings, options: FitOptions) -> Reference:
    """The reference in the model of the file `where`, for a rig of these settings. Raises `InputError` where the model
    has none, or is of another rig or version."""
    known_effects()
    held = model.reference
    if held is None:
        raise InputError(where, "does not hold how much its runs scatter", REMEDY)
    speeds = {"friction_velocity_radps": 1.0}
    if structs.replace(model.mechanism, **speeds) != structs.replace(settings, **speeds):
        raise InputError(where, "is a model of another mechanism than the rig file's", "give a model of this rig")
    mechanism = build_mechanism(structs.replace(model.mechanism, friction_velocity_radps=held.friction_velocity_radps))
    mechanism = replace(mechanism, followers=tuple(j - 1 for j in held.followers))
    options = replace(options, sensors=held.sensors, hold=held.hold, smoothing_velocity="given")
    noise = {kind: np.array([np.inf if x is None else x for x in levels]) for kind, levels in held.noise.items()}
    m = len(held.columns)
    try:
        levels = Noise(noise["torque"], noise["encoder"], noise["gyro"], noise["accel"].reshape(-1, 2),
                       options.accel_correlation, _square(noise.get("torque_correlation")))
        fit = known_reference(FittedModel(mechanism, held.hold, np.array(held.beta), noise=levels,
                                          angle_range=np.array(held.reach), gear_ratio=model.gear_ratio), options)
        information = _symmetric(np.frombuffer(held.information, "<f8"), m)
    except (KeyError, ValueError):
        raise InputError(where, "has a damaged block `reference`", REMEDY) from None
    drift = held.drift or (0.0,) * m
    if fit.columns != held.columns or not len(held.score) == len(held.unit) == len(drift) == m:
        raise InputError(where, "was written with another library of effects", REMEDY)
    law = LawSizes(known={(one.joint - 1, one.effect): LawSize(
        np.array(one.size), np.array([np.inf if x is None else x for x in one.std]), one.blocks) for one in held.law})
    structure = Structure(held.common, held.own, np.array(held.unit), mechanism.p, held.freedom, np.array(drift))
    return Reference(fit, structure, Score(np.array(held.score), information),
                     LogLevels(len(held.runs), held.levels), LogLevels(len(held.runs), held.errors), held.runs, law)


def _square(values: FloatArray | None) -> FloatArray | None:
    return None if values is None else values.reshape(round(values.size**0.5), -1)


def _symmetric(upper: FloatArray, m: int) -> FloatArray:
    """(m, m) from its upper triangle by rows. Raises ValueError where that has another size."""
    found = np.zeros((m, m))
    found[np.triu_indices(m)] = upper
    return found + np.triu(found, 1).T
