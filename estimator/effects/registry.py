"""`classes`: every effect that a diagnosis knows; `library`: those that a rig can show."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from estimator.effects.base import BodyEffect, Effect, SensorEffect
from estimator.effects.gear_effect import GearEffect
from estimator.effects.hip_effect import hip_effect
from estimator.effects.sensor_effects import NO_ENCODER, EncoderEffect
from estimator.model import Mechanism

UNTESTABLE = {
    "torque_gain": "a wrong torque scale multiplies every parameter alike, so no motion shows it; a known weight does: "
                   "legid calibrate shunt --weight",
    "payload": "a load on a link is absorbed exactly by the inertial parameters; only a reference model shows it",
}
ENTRY_POINT = "legid.effects"
"""Group under which a user's own package names its `Effect` classes."""


def classes() -> tuple[type[Effect], ...]:
    """Every effect: the library's, then those that installed packages add under the entry point group."""
    from importlib.metadata import entry_points

    return (*library_classes(), *(point.load() for point in entry_points(group=ENTRY_POINT)))


def named(name: str) -> type[Effect]:
    """The effect of this name."""
    return next(kind for kind in classes() if kind.name == name)


@cache
def library_classes() -> tuple[type[Effect], ...]:
    """The classes with a `sentence` in the modules of this folder, in the order of files."""
    package = __name__.rpartition(".")[0]
    modules = [import_module(f"{package}.{info.name}") for info in iter_modules([str(Path(__file__).parent)])]
    return tuple(kind for module in modules for kind in vars(module).values()
                 if isinstance(kind, type) and issubclass(kind, Effect) and kind.__module__ == module.__name__
                 and vars(kind).get("sentence"))


def library(mechanism: Mechanism, has_imu: bool, encoders: Collection[int] | None = None
            ) -> tuple[list[Effect], dict[str, str]]:
    """Effects that can be tested on this rig, joint by joint, and why the others cannot (key -> reason).

    `encoders`: 0-based joints that have one; None: those of `has_imu`'s usual path.
    """
    effects: list[Effect] = []
    refused = dict(UNTESTABLE)
    read = range(mechanism.n) if encoders is None else encoders
    for kind in classes():
        for joint in joints_of(kind, mechanism):
            effect = placed(kind, joint, mechanism)
            why = effect.testable(mechanism, has_imu, mechanism.actuated) or _walking(effect, mechanism)
            if not why and issubclass(kind, (EncoderEffect, GearEffect)) and joint not in read:
                why = NO_ENCODER
            if why:
                refused[effect.key] = why
            else:
                effects.append(effect)
    return effects, refused


def joints_of(kind: type[Effect], mechanism: Mechanism) -> Sequence[int | None]:
    """0-based joints that have an effect of this kind; [None] for one of the whole rig."""
    if kind.per_loop:
        return mechanism.followers
    if kind.per_joint:
        return range(mechanism.n)
    return mechanism.actuated if kind.per_motor and len(mechanism.actuated) > 1 else [None]


def placed(kind: type[Effect], joint: int | None, mechanism: Mechanism) -> Effect:
    """An effect of this kind on this rig, at a joint (0-based), of a walker at the hip of a leg."""
    if joint is not None and joint in mechanism.exchanged:
        return hip_effect(kind, joint, mechanism.exchanged)
    slide = mechanism.length_unit == "m"
    if issubclass(kind, EncoderEffect):
        return kind(joint, slide, joint in mechanism.followers)
    return kind(joint, slide)


def _walking(effect: Effect, mechanism: Mechanism) -> str:
    """Why an effect makes no sense on a walker; empty where it does."""
    if not mechanism.exchanged:
        return ""
    if isinstance(effect, BodyEffect):
        return "a walker's foot stands elsewhere at every step"
    if effect.joint is not None and effect.joint not in mechanism.exchanged and not isinstance(effect, SensorEffect):
        return "a walker's joint 1 is the torso against the vertical: no friction or spring acts there"
    return ""

