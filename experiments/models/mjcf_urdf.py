"""A model as MJCF (MuJoCo) or URDF. Planar, in the plane of x and z, z up; angle 0 hangs, q grows towards x."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from experiments.models.bodies import Body, bodies_of
from experiments.models.schema import EffectValue, Model

AXIS = "0 -1 0"
SLIDE_AXIS = "1 0 0"
STEP_S = 0.0005
RUBBING_STEP_S = 0.0002
"""With dry friction, whose stiffness MuJoCo bounds by twice the step: at 0.5 ms it would creep by a milliradian."""
DRY = "0.999 0.9999 0.001"
"""solimp of dry friction: as hard as it gets. MuJoCo's default lets a joint creep, by 13 mrad in 5 s."""
RADIUS_M = 0.01
KINDS = ("mjcf", "urdf")


@dataclass
class Extras:
    """Parts of a model's effects that MJCF can represent, by joint from 1 where they belong to one."""

    springs: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Stiffness [N m/rad] and the angle at which it rests [rad]."""
    drags: dict[int, float] = field(default_factory=dict)
    """c of c v |v| [N m s^2/rad^2]."""
    rotors: dict[int, float] = field(default_factory=dict)
    """[kg m^2]"""
    offsets: dict[int, float] = field(default_factory=dict)
    """What the measured torque reads above the one that acts [N m]; 0: at every motor."""
    excess_m: float = 0.0
    """How much farther from the pivot the IMU sits."""
    turn_rad: float = 0.0
    """How far the IMU is turned in the sense of q1."""
    left_out: list[str] = field(default_factory=list)


def held_effects(model: Model) -> Extras:
    """Effects that an MJCF file holds exactly; those that it cannot are `left_out`."""
    found = Extras()
    driven = model.mechanism.actuated
    for effect in model.effects:
        joint = effect.joint or (driven[0] if len(driven) == 1 else 0)
        if not _hold(found, effect, joint):
            found.left_out.append(effect.name)
    return found


def _hold(into: Extras, effect: EffectValue, joint: int) -> bool:
    """Put the effect into what the file holds; whether that can be done."""
    size = effect.sizes
    if effect.name == "joint_stiffness" and size["stiffness"] > 0:
        into.springs[joint] = size["stiffness"], size["preload"] / size["stiffness"]
    elif effect.name == "quadratic_drag" and size["drag"] >= 0:
        into.drags[joint] = size["drag"]
    elif effect.name == "rotor_inertia" and joint and size["inertia"] >= 0:
        into.rotors[joint] = size["inertia"]
    elif effect.name == "torque_offset":
        into.offsets[joint] = size["offset"]
    elif effect.name == "imu_lever_arm":
        into.excess_m += size["excess"]
    elif effect.name == "imu_misalignment":
        into.turn_rad += size["angle"]
    else:
        return False
    return True


def export_model(model: Model, kind: str, where: str) -> tuple[str, list[str]]:
    """(XML text, what of the model it does not hold or holds otherwise). Raises `InputError`."""
    bodies = bodies_of(model, where)
    extras = held_effects(model) if kind == "mjcf" else Extras(left_out=[effect.name for effect in model.effects])
    extras.left_out += ["structure"] if model.structure else []
    notes = _notes(model, bodies, kind, extras)
    bodies = [_extended(_passive(body), j, extras) for j, body in enumerate(bodies, 1)]
    root = _mjcf(model, bodies, extras) if kind == "mjcf" else _urdf(bodies)
    words = ["Written by legid from an identified model. Base parameters kept exactly: "
             + ", ".join(f"{p.name} = {p.value:.9g} {p.unit}" for p in model.parameters) + ".",
             "Masses and centres are one choice of many that move alike about a fixed pivot (models/bodies.py).",
             *(note[0].upper() + note[1:] + "." for note in notes)]
    root.insert(0, ET.Comment(" " + "\n       ".join(words).replace("--", "- -") + " "))
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n", notes


def _speeds(model: Model) -> str:
    speeds = model.mechanism.friction_velocity_radps
    return ", ".join(f"{speed:g}" for speed in (speeds if isinstance(speeds, tuple) else (speeds,)))


def _notes(model: Model, bodies: Sequence[Body], kind: str, extras: Extras) -> list[str]:
    notes = []
    if any(b.coulomb for b in bodies):
        notes.append("Coulomb friction is frictionloss, which holds a resting joint fast; legid rounds its sign off "
                     f"over {_speeds(model)} rad/s instead" if kind == "mjcf" else
                     "Coulomb friction is the attribute friction, which every simulator takes in its own way")
    notes += [f"{what} of {b.joint} is {value:g}, a fit's error: written as 0"
              for b in bodies for what, value in (("viscous friction", b.viscous), ("Coulomb friction", b.coulomb),
                                                  ("rotor inertia", b.rotor)) if value < 0]
    if kind == "urdf":
        notes += [f"URDF has no rotor inertia: {b.rotor:g} kg m^2 at {b.joint} is left out"
                  for b in bodies if b.rotor > 0]
        notes += [f"URDF has no torque offset: {b.offset:g} N m at {b.joint} is left out" for b in bodies if b.offset]
        notes.append(f"URDF has no gravity: set {model.mechanism.gravity_mps2:g} m/s2 along -z")
    if extras.left_out:
        notes.append(f"{kind.upper()} cannot hold these effects of the model, they are left out: "
                     + ", ".join(extras.left_out))
    if extras.drags:
        notes.append("quadratic drag is the second number of damping, which older MuJoCos do not read (4.0 does)")
    return notes


def _extended(body: Body, joint: int, extras: Extras) -> Body:
    """With the effects that are more of what a body has anyway."""
    return replace(body, rotor=body.rotor + extras.rotors.get(joint, 0.0),
                   offset=body.offset + (extras.offsets.get(joint, extras.offsets.get(0, 0.0)) if body.driven else 0.0))


def _passive(body: Body) -> Body:
    """Without the negative frictions that a fit may give and no simulator takes."""
    return replace(body, viscous=max(body.viscous, 0.0), coulomb=max(body.coulomb, 0.0), rotor=max(body.rotor, 0.0))


def _mjcf(model: Model, bodies: Sequence[Body], extras: Extras) -> ET.Element:
    s = model.mechanism
    root = ET.Element("mujoco", model=s.model)
    ET.SubElement(root, "compiler", angle="radian")
    rubs = any(body.coulomb for body in bodies)
    step = RUBBING_STEP_S if rubs else STEP_S
    option = ET.SubElement(root, "option", timestep=repr(step), gravity=f"0 0 {-s.gravity_mps2!r}", integrator="RK4")
    ET.SubElement(option, "flag", contact="disable")
    parent: ET.Element = ET.SubElement(root, "worldbody")
    place, first = "0 0 0", None
    for j, body in enumerate(bodies, 1):
        parent = ET.SubElement(parent, "body", name=body.link, pos=place)
        drag = f" {extras.drags[j]!r}" if j in extras.drags else ""
        joint = ET.SubElement(parent, "joint", name=body.joint, type="slide" if body.slides else "hinge",
                              axis=SLIDE_AXIS if body.slides else AXIS, damping=f"{body.viscous!r}{drag}",
                              frictionloss=repr(body.coulomb), armature=repr(body.rotor))
        if body.coulomb:
            joint.set("solreffriction", f"{2.0 * step!r} 1")
            joint.set("solimpfriction", DRY)
        if j in extras.springs:
            stiffness, rest = extras.springs[j]
            joint.set("stiffness", repr(stiffness))
            joint.set("springref", repr(rest))
        ET.SubElement(parent, "inertial", pos=f"0 0 {-body.centre!r}", mass=repr(body.mass),
                      diaginertia=" ".join([repr(body.inertia)] * 3))
        ET.SubElement(parent, "geom", type="capsule", fromto=f"0 0 0 0 0 {-body.length!r}", size=repr(RADIUS_M))
        place, first = f"0 0 {-body.length!r}", first if first is not None else parent
    actuator = ET.SubElement(root, "actuator")
    for body in bodies:
        if body.driven or body.offset:  # ctrl is the measured torque, which reads `offset` too much
            motor = ET.SubElement(actuator, "general", name=body.joint, joint=body.joint, gainprm="1")
            if body.offset:
                motor.set("biastype", "affine")
                motor.set("biasprm", f"{-body.offset!r} 0 0")
    if s.model == "leg2" and first is not None:
        # x tangential, y outwards; a right-handed z then points against the axis about which q1 grows
        c, sine = math.cos(extras.turn_rad), math.sin(extras.turn_rad)
        ET.SubElement(first, "site", name="imu", pos=f"0 0 {-(s.lever_arm_m + extras.excess_m)!r}",
                      xyaxes=f"{c!r} 0 {sine!r} {sine!r} 0 {-c!r}")
        sensor = ET.SubElement(root, "sensor")
        ET.SubElement(sensor, "accelerometer", name="accel", site="imu")
        ET.SubElement(sensor, "gyro", name="gyro", site="imu")
        root.insert(0, ET.Comment(" accel x, y are accel_x_mps2, accel_y_mps2; gyro z is minus gyro_radps "))
    return root


def _urdf(bodies: Sequence[Body]) -> ET.Element:
    root = ET.Element("robot", name="legid")
    ET.SubElement(root, "link", name="base")
    parent, place = "base", "0 0 0"
    for body in bodies:
        link = ET.SubElement(root, "link", name=body.link)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=f"0 0 {-body.centre!r}", rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=repr(body.mass))
        i = repr(body.inertia)
        ET.SubElement(inertial, "inertia", ixx=i, iyy=i, izz=i, ixy="0", ixz="0", iyz="0")
        visual = ET.SubElement(link, "visual")
        ET.SubElement(visual, "origin", xyz=f"0 0 {-0.5 * body.length}", rpy="0 0 0")
        ET.SubElement(ET.SubElement(visual, "geometry"), "cylinder", radius=repr(RADIUS_M), length=repr(body.length))
        joint = ET.SubElement(root, "joint", name=body.joint, type="prismatic" if body.slides else "continuous")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=body.link)
        ET.SubElement(joint, "origin", xyz=place, rpy="0 0 0")
        ET.SubElement(joint, "axis", xyz=SLIDE_AXIS if body.slides else AXIS)
        if body.slides:  # URDF wants limits for a slide; the model knows none
            ET.SubElement(joint, "limit", lower="-1e3", upper="1e3", effort="1e6", velocity="1e3")
        ET.SubElement(joint, "dynamics", damping=repr(body.viscous), friction=repr(body.coulomb))
        parent, place = body.link, f"0 0 {-body.length!r}"
    return root
