"""MODEL.json: an identified model as typed data. Reading one never runs anything."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec

from daq import InputError, input_errors, read_bytes
from estimator.model import HOLDS
from experiments.console import write_json
from experiments.models.mechanism_settings import build_mechanism
from experiments.models.schema import SCHEMA, Model

MOST_BYTES = 1 << 28
"""Of a model."""


def values_of(model: Model) -> dict[str, tuple[float, float]]:
    """Parameter -> (value, standard deviation), infinite where it is not determined."""
    found = {}
    for k, parameter in enumerate(model.parameters):
        variance = model.covariance[k][k]
        found[parameter.name] = (parameter.value, math.inf if variance is None else math.sqrt(max(variance, 0.0)))
    return found


def save_model(model: Model, path: Path | str) -> None:
    """Write MODEL.json. Raises `InputError` where that place cannot be written."""
    write_json(path, model)


def load_model(path: Path | str) -> Model:
    """Read and check MODEL.json. Raises `InputError` naming the file and the place in it."""
    where = str(path)
    with input_errors(path, "give a model written by legid fit"):
        data = read_bytes(path, MOST_BYTES)
    try:
        model = _decoded(data)
    except msgspec.ValidationError as error:
        raise InputError(where, _lower(str(error).replace("`$.", "`")),
                         f"give a model of schema {SCHEMA}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(where, f"is not JSON: {_lower(str(error))}", "give a model written by legid fit") from None
    except RecursionError:
        raise InputError(where, "is nested too deep", "give a model written by legid fit") from None
    from experiments.models.with_effects import with_default_shapes

    model = with_default_shapes(model)
    fault = _fault(model)
    if fault:
        raise InputError(where, fault, "give a model written by legid fit")
    return model


def _decoded(data: bytes) -> Model:
    try:
        return msgspec.json.decode(data, type=Model)
    except msgspec.ValidationError as error:
        if "covariance" not in str(error):
            raise
    return msgspec.convert(_with_covariance(msgspec.json.decode(data)), Model)


def _with_covariance(document: Any) -> Any:
    """`document` with a covariance of nothing determined where it gives none, as of a model that was published."""
    try:
        if document.get("covariance") is not None:
            return document
        count = len(document["parameters"]) + sum(len(e["sizes"]) + len(e.get("shapes", ())) for e in
                                                  document.get("effects", ()))
        return {**document, "covariance": [[None] * count] * count}
    except (AttributeError, KeyError, TypeError):
        return document  # which the types refuse


def _fault(model: Model) -> str:
    """What the types cannot say; empty when all is well."""
    from experiments.models.structure import structure_fault
    from experiments.models.with_effects import effects_fault

    try:
        names = build_mechanism(model.mechanism).names
    except ValueError as error:
        return str(error)
    found = tuple(parameter.name for parameter in model.parameters)
    if found != names:
        return f"`parameters` are {', '.join(found) or 'empty'}, {model.mechanism.model} has {', '.join(names)}"
    for parameter in model.parameters:
        if not math.isfinite(parameter.value):
            return f"`parameters` gives {parameter.name} no finite value"
    fault = effects_fault(model) or structure_fault(model)
    if fault:
        return fault
    if model.hold not in HOLDS:
        return f"`hold` is {model.hold!r}, none of {', '.join(HOLDS)}"
    count = len(names) + sum(len(e.sizes) + len(e.shapes) for e in model.effects)
    if len(model.covariance) != count or any(len(row) != count for row in model.covariance):
        return f"`covariance` is not {count} by {count}"
    if model.ci95 and len(model.ci95) != len(names):
        return f"`ci95` has not one interval for each of {len(names)} parameters"
    if any(len(row) != len(names) or not all(map(math.isfinite, row)) for part in model.budget
           for row in part.directions):
        return f"`budget` has a direction that is not {len(names)} finite numbers"
    levels = dict(model.noise)
    if not abs(levels.pop("accel_correlation", 0.0)) < 1.0:
        return "`noise` holds an accel_correlation that is not between -1 and 1"
    if any(not (math.isfinite(level) and level >= 0) for level in levels.values()):
        return "`noise` holds a level that is not a positive number"
    return ""


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
