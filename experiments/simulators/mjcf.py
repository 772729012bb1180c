"""Parts as MJCF (MuJoCo). Planar, in the plane of x and z, z up; angle 0 hangs, q grows towards x."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from experiments.models import Model
from experiments.simulators.bodies import Body
from experiments.simulators.friction import Clip, clips_of, numbers, solver_numbers
from experiments.simulators.parts import JointParts, Parts

AXIS = "0 -1 0"
SLIDE_AXIS = "1 0 0"
STEP_S = 0.0005
SHORTEST_STEP_S = 0.0001
"""For which the buffers of delays are long enough."""
FAR = 1e6
"""Angle of a stop on the side where there is none [rad]."""
RADIUS_M = 0.01
NEEDS = {"dcmotor": (3, 7), "delay": (3, 5), "polynomial damping": (3, 7)}
"""Element to the first MuJoCo that reads it."""
OLDEST = (3, 2)


class Start(NamedTuple):
    """State of one run's first sample."""

    run: str
    q: Sequence[float]
    v: Sequence[float]


def mjcf_of(parts: Parts, notes: Sequence[str], starts: Iterable[Start] = ()) -> str:
    """XML text of the model; `notes` and the parameters stand in its comment."""
    settings = parts.model.mechanism
    root = ET.Element("mujoco", model=settings.model)
    root.append(ET.Comment(comment_of(parts.model, notes)))
    ET.SubElement(root, "compiler", angle="radian")
    option = ET.SubElement(root, "option", timestep=repr(STEP_S), gravity=f"0 0 {-settings.gravity_mps2!r}",
                           integrator="RK4")
    ET.SubElement(option, "flag", contact="disable")
    clips = [clips_of(joint, inverse) for joint, inverse in zip(parts.joints, parts.inverse_inertia())]
    links = _bodies(ET.SubElement(root, "worldbody"), parts, clips)
    for build in (_tendons(parts, clips), _actuators(parts), _sensors(parts, links), _keys(parts, starts)):
        if len(build):
            root.append(build)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def comment_of(model: Model, notes: Sequence[str]) -> str:
    """Text of the comment that heads a file: the model behind it."""
    words = ["Written by legid from an identified model. Base parameters kept exactly: "
             + ", ".join(f"{p.name} = {p.value:.9g} {p.unit}" for p in model.parameters) + ".",
             "Masses and centres are one choice of many that move alike about a fixed pivot.",
             *(note if note.startswith("leg.py") else note[0].upper() + note[1:] for note in notes)]
    return " " + "\n       ".join(words).replace("--", "- -") + " "


def mjcf_notes(parts: Parts) -> list[str]:
    """Notes on what the file holds otherwise than the model, and which MuJoCo it needs."""
    notes = list(parts.notes)
    if any(joint.coulomb for joint in parts.joints):
        speeds = sorted({joint.smoothing for joint in parts.joints if joint.coulomb})
        notes.append("Coulomb friction is frictionloss, as soft as legid's friction smoothing velocity of "
                     f"{', '.join(f'{speed:g}' for speed in speeds)} rad/s")
    notes += [f"the file has {element}: MuJoCo {'.'.join(map(str, NEEDS[element]))} or newer reads it"
              for element in _elements(parts)]
    return notes


def needed_mujoco(parts: Parts) -> tuple[int, int]:
    """The first version of MuJoCo that reads the file."""
    return max([OLDEST, *(NEEDS[element] for element in _elements(parts))])


def _elements(parts: Parts) -> list[str]:
    there = {"dcmotor": any(j.ripples or j.bristles for j in parts.joints),
             "delay": any(j.delay_s for j in parts.joints) or parts.imu_delay_s > 0.0,
             "polynomial damping": any(j.drag for j in parts.joints)}
    return [element for element, needed in there.items() if needed]


def delayed_by(delay_s: float, half_step: bool) -> dict[str, str]:
    """Attributes of a delay. A command acts over the step that begins with it, so half a step is added."""
    return {"delay": repr(delay_s + (0.5 * STEP_S if half_step else 0.0)), "interp": "linear",
            "nsample": str(math.ceil(delay_s / SHORTEST_STEP_S) + 3)}


def _bodies(world: ET.Element, parts: Parts, clips: Sequence[Sequence[Clip]]) -> list[ET.Element]:
    """The links, in the world or on the stand; each with its joint."""
    parent, place, links = world, "0 0 0", []
    if parts.stand is not None:
        stand, mass = parts.stand, sum(body.mass for body in parts.bodies)
        parent = ET.SubElement(parent, "body", name="stand")
        ET.SubElement(parent, "joint", name="stand", type="slide", axis=SLIDE_AXIS, stiffness=repr(stand.stiffness),
                      damping=repr(stand.damping))
        ET.SubElement(parent, "inertial", pos="0 0 0", mass=repr(stand.mass - mass), diaginertia="1 1 1")
    for body, joint, own in zip(parts.bodies, parts.joints, clips):
        parent = ET.SubElement(parent, "body", name=body.link, pos=place)
        links.append(parent)
        _joint(parent, body, joint, own)
        ET.SubElement(parent, "inertial", pos=f"0 0 {-body.centre!r}", mass=repr(body.mass),
                      diaginertia=" ".join([repr(body.inertia)] * 3))
        ET.SubElement(parent, "geom", type="capsule", fromto=f"0 0 0 0 0 {-body.length!r}", size=repr(RADIUS_M))
        place = f"0 0 {-body.length!r}"
    return links


def _joint(parent: ET.Element, body: Body, joint: JointParts, clips: Sequence[Clip]) -> None:
    found = ET.SubElement(parent, "joint", name=joint.name, type="slide" if body.slides else "hinge",
                          axis=SLIDE_AXIS if body.slides else AXIS, armature=repr(joint.armature),
                          damping=numbers([joint.viscous, joint.drag] if joint.drag else [joint.viscous]))
    if joint.stiffness > 0.0:
        found.set("stiffness", repr(joint.stiffness))
        found.set("springref", repr(joint.preload / joint.stiffness))
    if clips:
        found.set("frictionloss", repr(clips[0].share * joint.coulomb))
        for key, value in zip(("solreffriction", "solimpfriction"), solver_numbers(clips[0], joint.coulomb)):
            found.set(key, value)


def _tendons(parts: Parts, clips: Sequence[Sequence[Clip]]) -> ET.Element:
    """Further clips of the dry friction, stops, and encoders with a scale."""
    root = ET.Element("tendon")

    def along(joint: JointParts, name: str, coefficient: float = 1.0, **settings: str) -> None:
        tendon = ET.SubElement(root, "fixed", settings, name=f"{joint.name}_{name}")
        ET.SubElement(tendon, "joint", joint=joint.name, coef=repr(coefficient))

    for joint, own in zip(parts.joints, clips):
        for clip in own[1:]:
            reference, impedance = solver_numbers(clip, joint.coulomb)
            along(joint, "friction", frictionloss=repr(clip.share * joint.coulomb), solreffriction=reference,
                  solimpfriction=impedance)
        for k, (stiffness, angle) in enumerate(joint.stops, 1):
            free = (-FAR, angle) if angle > 0 else (angle, FAR)
            along(joint, f"stop{k}", stiffness=repr(stiffness), springlength=numbers(free))
        if joint.scale != 1.0:
            along(joint, "encoder", joint.scale)
    return root


def _actuators(parts: Parts) -> ET.Element:
    """Motors, whose `ctrl` is the measured torque; then passive torques: constants, cogging, bristles."""
    root = ET.Element("actuator")
    for joint in parts.joints:
        if joint.driven:
            motor = ET.SubElement(root, "general", name=joint.name, joint=joint.name, gainprm="1")
            if joint.offset:
                motor.set("biastype", "affine")
                motor.set("biasprm", f"{-joint.offset!r} 0 0")
            if joint.delay_s:
                motor.attrib.update(delayed_by(joint.delay_s, True))
    for joint in parts.joints:
        if joint.stiffness <= 0.0 and (joint.stiffness or joint.preload):
            ET.SubElement(root, "general", name=f"{joint.name}_constant", joint=joint.name, gainprm="0",
                          biastype="affine", biasprm=f"{joint.preload!r} {-joint.stiffness!r} 0")
        passive = {"joint": joint.name, "input": "none", "motorconst": "0", "resistance": "1"}
        for k, ripple in enumerate(joint.ripples, 1):
            ET.SubElement(root, "dcmotor", passive, name=f"{joint.name}_ripple{k}", cogging=numbers(ripple))
        for k, (level, damping, displacement) in enumerate(joint.bristles, 1):
            ET.SubElement(root, "dcmotor", passive, name=f"{joint.name}_bristles{k}",
                          lugre=numbers([level / displacement, damping, level, level, 1.0]))
    return root


def _sensors(parts: Parts, links: Sequence[ET.Element]) -> ET.Element:
    """Encoders, then gyro and accelerometer of each IMU."""
    root = ET.Element("sensor")
    for j, joint in enumerate(parts.joints, 1):
        if joint.scale == 1.0:
            ET.SubElement(root, "jointpos", name=f"q{j}", joint=joint.name)
        else:
            ET.SubElement(root, "tendonpos", name=f"q{j}", tendon=f"{joint.name}_encoder")
    late = delayed_by(parts.imu_delay_s, False) if parts.imu_delay_s else {}
    for k, place in enumerate(parts.mechanism.imus if parts.model.mechanism.has_imu else ()):
        turn, excess = (parts.imu_turn_rad, parts.imu_excess_m) if k == 0 else (0.0, 0.0)
        # x tangential, y outwards; a right-handed z then points against the axis about which q1 grows
        c, s, own = math.cos(turn), math.sin(turn), str(k + 1) if k else ""
        ET.SubElement(links[place.link], "site", name=f"imu{own}", pos=f"0 0 {-(place.lever_arm + excess)!r}",
                      xyaxes=f"{c!r} 0 {s!r} {s!r} 0 {-c!r}")
        root.append(ET.Comment(f" accel{own} x, y are the run's columns; its gyro is minus gyro{own} z "))
        ET.SubElement(root, "gyro", late, name=f"gyro{own}", site=f"imu{own}")
        ET.SubElement(root, "accelerometer", late, name=f"accel{own}", site=f"imu{own}")
    return root


def _keys(parts: Parts, starts: Iterable[Start]) -> ET.Element:
    """The first state of each run, by its name."""
    root, still = ET.Element("keyframe"), [0.0] if parts.stand is not None else []
    for start in starts:
        ET.SubElement(root, "key", name=start.run, qpos=numbers([*still, *start.q]), qvel=numbers([*still, *start.v]))
    return root


