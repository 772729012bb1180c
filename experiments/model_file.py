"""MODEL.json: an identified model as typed data. Reading one never runs anything."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from daq.errors import InputError

SCHEMA = "legid.model/1"
NonNegative = Annotated[float, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Joint = Annotated[int, Meta(ge=1)]


class _Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class MechanismSettings(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `experiments.rigs.build_mechanism` needs; joints count from 1."""

    model: Literal["leg2", "biped3", "joint1", "chain"]
    actuated: tuple[Joint, ...]
    gravity_mps2: NonNegative = 9.81
    links: Annotated[int, Meta(ge=1, le=20)] = 2
    input: Literal["torque", "voltage"] = "torque"
    prismatic: bool = False
    lever_arm_m: NonNegative = 0.0
    rotor_inertia: tuple[Joint, ...] = ()
    torque_offset: tuple[Joint, ...] = ()
    friction_velocity_radps: Positive = 0.01


class ParameterValue(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of beta."""

    name: str
    meaning: str
    unit: str
    value: float


class EffectValue(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One effect that extends the nominal model."""

    name: str
    joint: Joint | None
    """From 1; null for an effect of the whole rig."""
    sizes: dict[str, float]
    """Size -> value, in the units that the effect states."""
    shapes: dict[str, float] = {}
    """Shape -> value, likewise."""


class Provenance(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the numbers come from."""

    runs: tuple[str, ...]
    method: str
    sensors: Literal["imu", "encoder"]
    date: str
    """UTC, ISO 8601."""
    version: str
    """Of this program."""


class Model(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One MODEL.json."""

    schema: Literal["legid.model/1"]
    mechanism: MechanismSettings
    parameters: tuple[ParameterValue, ...]
    covariance: tuple[tuple[float | None, ...], ...]
    """In the order of `parameters`, then sizes and shapes of each of `effects`; null where not determined."""
    noise: dict[str, float]
    """1 sigma by channel."""
    hold: Literal["zero", "linear", "average"]
    """How a torque sample acts until the next."""
    effects: tuple[EffectValue, ...] = ()
    gear_ratio: Positive = 1.0
    """Of the motor; effects may depend on it."""
    reach: tuple[tuple[float, float], ...] = ()
    """Smallest and largest angle of each joint in the runs fitted [rad]; effects may depend on it."""
    provenance: Provenance

    @property
    def beta(self) -> list[float]:
        """Values in the order of `parameters`."""
        return [parameter.value for parameter in self.parameters]


def values_of(model: Model) -> dict[str, tuple[float, float]]:
    """Parameter -> (value, standard deviation), infinite where it is not determined."""
    found = {}
    for k, parameter in enumerate(model.parameters):
        variance = model.covariance[k][k]
        found[parameter.name] = (parameter.value, math.inf if variance is None else math.sqrt(max(variance, 0.0)))
    return found


def save_model(model: Model, path: Path | str) -> None:
    """Write MODEL.json. Raises `InputError` where that place cannot be written."""
    from experiments.output import write_json

    write_json(path, model)


def load_model(path: Path | str) -> Model:
    """Read and check MODEL.json. Raises `InputError` naming the file and the place in it."""
    where = str(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(where, error.strerror or str(error), "give a model written by legid fit") from None
    try:
        model = msgspec.json.decode(data, type=Model)
    except msgspec.ValidationError as error:
        raise InputError(where, _lower(str(error).replace("`$.", "`")),
                         f"give a model of schema {SCHEMA}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(where, f"is not JSON: {_lower(str(error))}", "give a model written by legid fit") from None
    fault = _fault(model)
    if fault:
        raise InputError(where, fault, "give a model written by legid fit")
    return model


def _fault(model: Model) -> str:
    """What the types cannot say; empty when all is well."""
    from experiments.extended_model import effects_fault
    from experiments.rigs import build_mechanism

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
    fault = effects_fault(model)
    if fault:
        return fault
    count = len(names) + sum(len(e.sizes) + len(e.shapes) for e in model.effects)
    if len(model.covariance) != count or any(len(row) != count for row in model.covariance):
        return f"`covariance` is not {count} by {count}"
    if any(not (math.isfinite(level) and level >= 0) for level in model.noise.values()):
        return "`noise` holds a level that is not a positive number"
    return ""


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
