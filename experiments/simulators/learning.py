"""`learning_files`: a model for simulators of policy learning, with what each holds and what the difference costs.

Isaac Lab, mjlab, Newton and Genesis know of a joint: rotor inertia, viscous and dry friction, and, but for Genesis, a
delay of the command in whole steps. `reduced` is the model that such a simulator can have: simulated by legid, its
free-run error says what the difference costs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from msgspec import structs

from experiments.models import EffectValue, Model, build_mechanism
from experiments.simulators.bam import bam_parameters
from experiments.simulators.mjcf import mjcf_of
from experiments.simulators.parts import Parts, parts_of
from experiments.simulators.urdf import urdf_notes, urdf_of

STEP_S = 0.005
"""Step of the policy's physics: delays are counted in it."""
HELD, NEAREST, LEFT_OUT = "held", "nearest", "left out"
READINGS = ("gyro_bias", "gyro_scale", "accelerometer_bias", "imu_misalignment", "imu_lever_arm", "encoder_offset",
            "encoder_scale", "encoder_eccentricity", "sensor_time_skew")


@dataclass(frozen=True)
class Simulator:
    """One simulator's joint."""

    name: str
    file: str
    delays: bool
    springs: bool
    """Whether the file of the leg gives the joint its spring."""


SIMULATORS = (Simulator("Isaac Lab", "isaaclab_leg.py", True, False), Simulator("mjlab", "mjlab_leg.py", True, True),
              Simulator("Newton", "newton_leg.py", True, False), Simulator("Genesis", "genesis_leg.py", False, False))


BAM = """bam.json has the friction and the armature of the {servo} that moves the driven joint, for BAM:

    model = bam.model.load_model(motor_name="{servo}", model="{variant}")
    model.load_parameters("bam.json")

Its kt and R stay as BAM bundles them, since a model of torques does not know them. Friction that grows with the load is
nearest: BAM multiplies the difference of motor and external torque, legid the transmitted torque.
"""


class Fate(NamedTuple):
    """Fate of one effect in a simulator."""

    effect: str
    how: str
    words: str


class Reduced(NamedTuple):
    """A model that a simulator can have."""

    simulator: Simulator
    model: Model
    fates: tuple[Fate, ...]


def reduced(model: Model, simulator: Simulator) -> Reduced:
    """`model` as the simulator holds it, and what becomes of each effect."""
    beta, kept, fates = dict(zip(_terms(model), model.beta)), list[EffectValue](), list[Fate]()
    for effect in model.effects:
        fate, own = _fate(effect, simulator, beta)
        fates.append(Fate(f"{effect.name}@{effect.joint}" if effect.joint else effect.name, *fate))
        kept += own
    if model.structure is not None:
        fates.append(Fate("structure", LEFT_OUT, "no joint has tables of torque"))
    parameters = tuple(structs.replace(p, value=value) for p, value in zip(model.parameters, beta.values()))
    count = len(parameters) + sum(len(e.sizes) + len(e.shapes) for e in kept)
    less = structs.replace(model, parameters=parameters, effects=tuple(kept), structure=None, ci95=(),
                           covariance=((None,) * count,) * count)
    return Reduced(simulator, less, tuple(fates))


def _terms(model: Model) -> list[tuple[str, tuple[int, ...]]]:
    return [(p.term, p.at) for p in build_mechanism(model.mechanism).parameters]


def _fate(effect: EffectValue, simulator: Simulator, beta: dict[tuple[str, tuple[int, ...]], float]
          ) -> tuple[tuple[str, str], list[EffectValue]]:
    """What becomes of an effect, in words, and what of it stays; `beta` takes what is like friction."""
    at, size = ((effect.joint or 1) - 1,), effect.sizes
    if effect.name == "rotor_inertia":
        return (HELD, "armature"), [effect]
    if effect.name == "torque_delay" and simulator.delays and size["delay"] < 0.0:
        steps = round(-size["delay"] / STEP_S)
        late = structs.replace(effect, sizes={"delay": -steps * STEP_S})
        return (NEAREST, f"{steps} steps of {1e3 * STEP_S:g} ms"), [late]
    if effect.name == "joint_stiffness" and simulator.springs:
        return (HELD, "stiffness and springref of the MJCF"), [effect]
    if effect.name == "asymmetric_friction":
        _add(beta, at, 0.5 * size["coulomb_difference"], 0.5 * size["viscous_difference"])
        return (NEAREST, "the mean of both directions"), []
    if effect.name in ("joint_elasticity", "backlash"):
        _add(beta, at, size["motor_coulomb"], size["motor_viscous"])
        rotor = EffectValue(name="rotor_inertia", joint=effect.joint, sizes={"inertia": size["motor_inertia"]})
        return (NEAREST, "friction and inertia of the motor; the gear does not twist"), [rotor]
    if effect.name == "stribeck_friction":
        return (NEAREST, "dry friction in motion" + ("; the excess as static friction" if simulator.name == "Isaac Lab"
                                                     else "")), []
    if effect.name in READINGS:
        return (LEFT_OUT, "an error of a sensor: add it to the observations"), []
    return (LEFT_OUT, "the joint has no such part"), []


def _add(beta: dict[tuple[str, tuple[int, ...]], float], at: tuple[int, ...], coulomb: float, viscous: float) -> None:
    for term, value in (("coulomb", coulomb), ("viscous", viscous)):
        if (term, at) in beta:
            beta[term, at] += value


def learning_files(model: Model, where: str, errors: Mapping[str, Mapping[str, float]] | None = None, servo: str = ""
                   ) -> dict[str, str]:
    """Name of each file to its text: the leg as MJCF and URDF, one module a simulator, and the table of what is held.

    - `errors`: simulator, or "model", to the rms free-run error of each channel.
    - `servo`: name of the driven joint's actuator in BAM, whose parameters are written, too.

    Raises `InputError`.
    """
    texts = {}
    every = [reduced(model, simulator) for simulator in SIMULATORS]
    for one in every:
        parts = parts_of(one.model, where)
        texts[one.simulator.file] = _module(one, parts, model)
        if one.simulator.name == "mjlab":
            texts["leg.xml"] = mjcf_of(parts, ["The leg as mjlab, Newton and Genesis read it"])
    plain = parts_of(structs.replace(every[0].model, effects=()), where)
    texts["leg.urdf"] = urdf_of(plain, urdf_notes(plain))
    texts["README.md"] = _table(model, every, errors or {})
    if servo:
        found = bam_parameters(parts_of(model, where), servo)
        texts["bam.json"] = json.dumps(found, indent=2) + "\n"
        texts["README.md"] += "\n" + BAM.format(servo=servo, variant=found["model"])
    return texts


def _module(one: Reduced, parts: Parts, model: Model) -> str:
    """Text of the simulator's module for what it holds of `model`."""
    from jinja2 import Environment, StrictUndefined

    delays = {e.joint or 0: -e.sizes["delay"] for e in one.model.effects if e.name == "torque_delay"}
    excess = {e.joint: e.sizes["excess_torque"] for e in model.effects if e.name == "stribeck_friction"}
    joints = [{"name": joint.name, "driven": joint.driven, "armature": joint.armature, "viscous": joint.viscous,
               "coulomb": joint.coulomb, "static": joint.coulomb + excess.get(k, 0.0),
               "steps": round(delays.get(k, delays.get(0, 0.0)) / STEP_S) if joint.driven else 0}
              for k, joint in enumerate(parts.joints, 1)]
    template = Path(__file__).with_name(f"{one.simulator.file}.jinja").read_text(encoding="utf-8")
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
                              keep_trailing_newline=True)
    return environment.from_string(template).render(joints=joints, step=STEP_S, gravity=model.mechanism.gravity_mps2)


def _table(model: Model, every: list[Reduced], errors: Mapping[str, Mapping[str, float]]) -> str:
    lines = ["# A leg for policy learning", "",
             "Written by legid from an identified model. The modules are text for the simulators that they name. "
             "legid ran none of them.", "", "| effect | " + " | ".join(r.simulator.name for r in every) + " |",
             "|---" * (len(every) + 1) + "|"]
    for k, fate in enumerate(every[0].fates):
        cells = [f"{r.fates[k].how}: {r.fates[k].words}" for r in every]
        lines.append(f"| {fate.effect} | " + " | ".join(cells) + " |")
    if not every[0].fates:
        lines.append("| none | " + " | ".join(["held"] * len(every)) + " |")
    if errors:
        channels = list(errors["model"])
        lines += ["", "Free-run error (rms, whole runs) of the model, and of what each simulator holds of it, by "
                  "legid's simulation:", "", "| | " + " | ".join(channels) + " |", "|---" * (len(channels) + 1) + "|"]
        lines += [f"| {name} | " + " | ".join(f"{found[c]:.4g}" for c in channels) + " |"
                  for name, found in errors.items()]
    else:
        lines += ["", "Give runs by --starts: then the table has what the differences cost in free-run error."]
    return "\n".join([*lines, ""])
