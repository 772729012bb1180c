"""A model as MJCF (MuJoCo) or URDF. Planar, in the plane of x and z, z up; angle 0 hangs, q grows towards x."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace

from experiments.models.bodies import Body, bodies_of
from experiments.models.schema import Model

AXIS = "0 -1 0"
SLIDE_AXIS = "1 0 0"
STEP_S = 0.0005
RADIUS_M = 0.01
KINDS = ("mjcf", "urdf")


def export_model(model: Model, kind: str, where: str) -> tuple[str, list[str]]:
    """(XML text, what of the model it does not hold or holds otherwise). Raises `InputError`."""
    bodies = bodies_of(model, where)
    notes = _notes(model, bodies, kind)
    bodies = [_passive(body) for body in bodies]
    root = _mjcf(model, bodies) if kind == "mjcf" else _urdf(bodies)
    words = ["Written by legid from an identified model. Base parameters kept exactly: "
             + ", ".join(f"{p.name} = {p.value:.9g} {p.unit}" for p in model.parameters) + ".",
             "Masses and centres are one choice of many that move alike about a fixed pivot (models/bodies.py).",
             *(note[0].upper() + note[1:] + "." for note in notes)]
    root.insert(0, ET.Comment(" " + "\n       ".join(words).replace("--", "- -") + " "))
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n", notes


def _notes(model: Model, bodies: Sequence[Body], kind: str) -> list[str]:
    notes = []
    if any(b.coulomb for b in bodies):
        notes.append("Coulomb friction is frictionloss, which holds a resting joint fast; legid rounds its sign off "
                     f"over {model.mechanism.friction_velocity_radps:g} rad/s instead" if kind == "mjcf" else
                     "Coulomb friction is the attribute friction, which every simulator takes in its own way")
    notes += [f"{what} of {b.joint} is {value:g}, a fit's error: written as 0"
              for b in bodies for what, value in (("viscous friction", b.viscous), ("Coulomb friction", b.coulomb),
                                                  ("rotor inertia", b.rotor)) if value < 0]
    if kind == "urdf":
        notes += [f"URDF has no rotor inertia: {b.rotor:g} kg m^2 at {b.joint} is left out"
                  for b in bodies if b.rotor > 0]
        notes += [f"URDF has no torque offset: {b.offset:g} N m at {b.joint} is left out" for b in bodies if b.offset]
        notes.append(f"URDF has no gravity: set {model.mechanism.gravity_mps2:g} m/s2 along -z")
    if model.effects:
        notes.append("the model's effects are left out: " + ", ".join(effect.name for effect in model.effects))
    return notes


def _passive(body: Body) -> Body:
    """Without the negative frictions that a fit may give and no simulator takes."""
    return replace(body, viscous=max(body.viscous, 0.0), coulomb=max(body.coulomb, 0.0), rotor=max(body.rotor, 0.0))


def _mjcf(model: Model, bodies: Sequence[Body]) -> ET.Element:
    s = model.mechanism
    root = ET.Element("mujoco", model=s.model)
    ET.SubElement(root, "compiler", angle="radian")
    option = ET.SubElement(root, "option", timestep=repr(STEP_S), gravity=f"0 0 {-s.gravity_mps2!r}", integrator="RK4")
    ET.SubElement(option, "flag", contact="disable")
    parent: ET.Element = ET.SubElement(root, "worldbody")
    place, first = "0 0 0", None
    for body in bodies:
        parent = ET.SubElement(parent, "body", name=body.link, pos=place)
        ET.SubElement(parent, "joint", name=body.joint, type="slide" if body.slides else "hinge",
                      axis=SLIDE_AXIS if body.slides else AXIS, damping=repr(body.viscous),
                      frictionloss=repr(body.coulomb), armature=repr(body.rotor))
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
        ET.SubElement(first, "site", name="imu", pos=f"0 0 {-s.lever_arm_m!r}", xyaxes="1 0 0 0 0 -1")
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
