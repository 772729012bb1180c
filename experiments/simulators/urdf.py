"""Bodies as URDF, with what ROS 2 and Gazebo read of a joint: `dynamics`, a spring, a transmission."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

from daq import Limits
from experiments.simulators.mjcf import AXIS, RADIUS_M, SLIDE_AXIS, comment_of
from experiments.simulators.parts import JointParts, Parts


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint that a rig file gives [SI]."""

    angle: float
    """Of the angle's magnitude."""
    speed: float
    torque: float
    """Of the motor; of a passive joint 0."""
    stop_radps2: float
    """Deceleration of a joint whose torque is cut."""


def limits_of(rig: Limits, parts: Parts) -> list[JointLimits]:
    """Limits of each joint, the pivot first."""
    angles, speeds = (rig.q1_rad, rig.q2_rad), (rig.q1_speed_radps, rig.speed_radps)
    return [JointLimits(angle, speed, rig.torque_nm if joint.driven else 0.0, rig.stop_radps2)
            for joint, angle, speed in zip(parts.joints, angles, speeds)]


def urdf_notes(parts: Parts, limited: bool = False) -> list[str]:
    """Notes on what the file does not hold of the model."""
    notes = list(parts.notes)
    if not limited:
        notes.append("no joint has a limit: --rig gives those of its [limits], and a safety controller")
    if any(joint.coulomb for joint in parts.joints):
        notes.append("Coulomb friction is the attribute friction, which every simulator takes in its own way")
    notes += [f"URDF has no rotor inertia: {joint.armature:g} kg m^2 at {joint.name} is left out"
              for joint in parts.joints if joint.armature > 0]
    notes += [f"URDF has no torque offset: {joint.offset:g} N m at {joint.name} is left out"
              for joint in parts.joints if joint.offset]
    notes.append(f"URDF has no gravity: set {parts.model.mechanism.gravity_mps2:g} m/s2 along -z")
    held = {"joint_stiffness", "rotor_inertia", "torque_offset"}
    if any(joint.stiffness > 0.0 for joint in parts.joints):
        notes.append("the joint's spring is in <gazebo>, which Gazebo alone reads")
    else:
        held.discard("joint_stiffness")
    lost = [effect.name for effect in parts.model.effects if effect.name not in held]
    lost += ["structure"] if parts.model.structure else []
    if lost:
        notes.append("URDF cannot hold these effects of the model, they are left out: " + ", ".join(lost)
                     + "; --to mujoco holds them")
    return notes


def urdf_of(parts: Parts, notes: list[str], limits: Sequence[JointLimits] = ()) -> str:
    """XML text of the model; with `limits`, of joints that turn within them."""
    root = ET.Element("robot", name="legid")
    root.append(ET.Comment(comment_of(parts.model, notes)))
    ET.SubElement(root, "link", name="base")
    parent, place = "base", "0 0 0"
    for body, joint, limit in zip_longest(parts.bodies, parts.joints, limits):
        link = ET.SubElement(root, "link", name=body.link)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=f"0 0 {-body.centre!r}", rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=repr(body.mass))
        i = repr(body.inertia)
        ET.SubElement(inertial, "inertia", ixx=i, iyy=i, izz=i, ixy="0", ixz="0", iyz="0")
        visual = ET.SubElement(link, "visual")
        ET.SubElement(visual, "origin", xyz=f"0 0 {-0.5 * body.length}", rpy="0 0 0")
        ET.SubElement(ET.SubElement(visual, "geometry"), "cylinder", radius=repr(RADIUS_M), length=repr(body.length))
        found = ET.SubElement(root, "joint", name=joint.name, type=_type(body.slides, limit is not None))
        ET.SubElement(found, "parent", link=parent)
        ET.SubElement(found, "child", link=body.link)
        ET.SubElement(found, "origin", xyz=place, rpy="0 0 0")
        ET.SubElement(found, "axis", xyz=SLIDE_AXIS if body.slides else AXIS)
        if body.slides:  # URDF wants limits for a slide; the model knows none
            ET.SubElement(found, "limit", lower="-1e3", upper="1e3", effort="1e6", velocity="1e3")
        elif limit is not None:
            _limit(found, limit)
        ET.SubElement(found, "dynamics", damping=repr(joint.viscous), friction=repr(joint.coulomb))
        parent, place = body.link, f"0 0 {-body.length!r}"
    for joint in parts.joints:
        _further(root, joint, parts.model.gear_ratio)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _type(slides: bool, limited: bool) -> str:
    if slides:
        return "prismatic"
    return "revolute" if limited else "continuous"


def _limit(element: ET.Element, limit: JointLimits) -> None:
    """The joint's limits, and a safety controller that keeps them.

    It bounds the speed by k_position times the distance to an angle's limit, so the joint decelerates by k_position
    times the speed: k_position is stop_radps2 over the speed's limit. It bounds the torque by k_velocity times what is
    left of the speed: k_velocity is the torque's limit over the speed's, so a joint at rest has all of it.
    """
    ET.SubElement(element, "limit", lower=repr(-limit.angle), upper=repr(limit.angle), effort=repr(limit.torque),
                  velocity=repr(limit.speed))
    if limit.torque:
        ET.SubElement(element, "safety_controller", soft_lower_limit=repr(-limit.angle),
                      soft_upper_limit=repr(limit.angle), k_position=f"{limit.stop_radps2 / limit.speed:.9g}",
                      k_velocity=f"{limit.torque / limit.speed:.9g}")


def _further(root: ET.Element, joint: JointParts, gear_ratio: float) -> None:
    """The joint's transmission, and its spring for Gazebo."""
    if joint.driven:
        transmission = ET.SubElement(root, "transmission", name=f"{joint.name}_transmission")
        ET.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        interface = "hardware_interface/EffortJointInterface"
        for kind, name in (("joint", joint.name), ("actuator", f"{joint.name}_motor")):
            end = ET.SubElement(transmission, kind, name=name)
            ET.SubElement(end, "hardwareInterface").text = interface
            if kind == "actuator":
                ET.SubElement(end, "mechanicalReduction").text = repr(gear_ratio)
    if joint.stiffness > 0.0:
        gazebo = ET.SubElement(root, "gazebo", reference=joint.name)
        ET.SubElement(gazebo, "springStiffness").text = repr(joint.stiffness)
        ET.SubElement(gazebo, "springReference").text = repr(joint.preload / joint.stiffness)
