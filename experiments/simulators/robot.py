"""`read_robot`: a serial planar chain of a URDF or MJCF file, as MuJoCo compiles it.

MuJoCo resolves rpy, quaternions, defaults, included files and the inertias of shapes. All vectors are in the world's
frame where all joints are at zero. A body without a joint is a part of the one that carries it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from daq import FloatArray, InputError, input_errors, read_bytes
from experiments.bounded_child import Bounds, answer_of_child, ended_early
from experiments.simulators.mujoco_runs import require_mujoco

MOST_BYTES, MOST_BODIES, MOST_INCLUDES = 10_000_000, 1000, 8
MOST_MEMORY, MOST_S = 700 << 20, 6.0
"""The child that compiles it may take so many bytes, and so much time of a processor [s]."""
PLANAR = "give a serial chain of hinges with parallel axes, whose links have masses"
LARGEST = 1e9
"""Of any length, mass and inertia, in SI units."""
NO_MASS = 1e-9
"""Mass below which a link has none [kg]."""


@dataclass(frozen=True)
class Link:
    """One link and the hinge that carries it."""

    name: str
    at: FloatArray
    """(3,) its hinge, from the hinge before, of the first from the world's origin [m]"""
    axis: FloatArray
    """(3,)"""
    centre: FloatArray
    """(3,) of mass, from the hinge [m]"""
    mass: float
    inertia: FloatArray
    """(3, 3) about the centre of mass [kg m^2]"""
    driven: bool
    joint: str = ""
    viscous: float = 0.0
    """[N m s/rad]"""
    coulomb: float = 0.0
    """[N m]"""
    armature: float = 0.0
    """[kg m^2]"""
    stiffness: float = 0.0
    """[N m/rad]"""
    rest_rad: float = 0.0
    """Angle at which the spring rests."""


def read_robot(path: Path) -> list[Link]:
    """Links from the base outwards, by a child process: shapes, textures and copies of a few bytes' description can
    fill the memory. Raises `InputError` naming the file and the body, or where MuJoCo is absent."""
    require_mujoco()
    data = answer_of_child(lambda: [msgspec.json.encode(_read(path), enc_hook=np.ndarray.tolist)],
                           Bounds(str(path), "a URDF or MJCF file", MOST_MEMORY, MOST_S))
    try:
        return msgspec.json.decode(bytes(data), type=list[Link], dec_hook=lambda _, numbers: np.array(numbers))
    except msgspec.MsgspecError:
        raise ended_early(str(path)) from None


def _read(path: Path) -> list[Link]:
    root = _parsed(path)
    if root.tag not in ("robot", "mujoco"):
        raise InputError(str(path), f"begins with <{root.tag}>", "give a URDF or MJCF file; run xacro first")
    _check_files(root, path, path.resolve().parent)
    bodies = sum(1 for element in root.iter() if element.tag in ("link", "body"))
    if bodies > MOST_BODIES:
        raise InputError(str(path), f"has {bodies} bodies, {MOST_BODIES} are read", PLANAR)
    model = _compiled(root, path)
    names = [joint.get("name") for joint in root.findall("transmission/joint")] if root.tag == "robot" else []
    links = _links(model, names, str(path))
    for link in links:
        numbers = (*link.at, *link.axis, *link.centre, link.mass, *link.inertia.ravel(), link.viscous, link.coulomb,
                   link.armature, link.stiffness, link.rest_rad)
        if not (np.abs(numbers) < LARGEST).all():
            raise InputError(str(path), f"gives body {link.name} a number that no leg has", "correct the file")
    return links


def _parsed(path: Path) -> ET.Element:
    with input_errors(path, "give a URDF or MJCF file"):
        data = read_bytes(path, MOST_BYTES)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(str(path), "declares entities", "give a plain URDF or MJCF file")
    try:
        return ET.fromstring(data)
    except ET.ParseError as error:
        raise InputError(str(path), f"is not XML: {error}", "give a URDF or MJCF file; run xacro first") from None


def _check_files(root: ET.Element, path: Path, folder: Path, depth: int = 0) -> None:
    """Raise `InputError` where an MJCF file or one that it includes names a file outside its folder, or no file."""
    if root.tag != "mujoco" and not depth:
        return  # the shapes of a URDF are left out
    if depth > MOST_INCLUDES:
        raise InputError(str(path), f"includes files {depth} levels deep", "give one file")
    named = [(e, value) for e in root.iter() for key, value in e.attrib.items() if key.startswith("file")]
    for element, name in named:
        homes = [folder, *(folder / value for e in root.iter("compiler") for key, value in e.attrib.items()
                           if key.endswith("dir"))]
        places = [place for home in homes if (place := home / name).exists()]
        for place in places:
            if not place.resolve().is_relative_to(folder):
                raise InputError(str(path), f"names {name!r}, which is outside its folder", "copy it into the folder")
            if not place.is_file():
                raise InputError(str(path), f"names {name!r}, which is no regular file", "give a file on a disk")
        if element.tag == "include" and places:
            _check_files(_parsed(places[0]), path, folder, depth + 1)


def _compiled(root: ET.Element, path: Path) -> Any:
    """MuJoCo's model of the file, of a URDF without its shapes: their meshes may lie elsewhere."""
    import mujoco

    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    try:
        if root.tag == "mujoco" and path.suffix == ".xml":  # its meshes and included files are in its folder
            return mujoco.MjSpec.from_file(str(path)).compile()
        return mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode")).compile()
    except ValueError as error:
        told = " ".join(str(error).split())
        raise InputError(str(path), f"MuJoCo cannot read it: {told}", "correct the file") from None


def _links(model: Any, names: list[str | None], where: str) -> list[Link]:
    """The chain of moving bodies of a compiled model."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    driven = {int(model.actuator_trnid[i, 0]) for i in range(model.nu)
              if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT}
    driven |= {j for j in range(model.njnt) if model.joint(j).name in names}
    if not model.njnt:
        raise InputError(where, "has no hinge", PLANAR)
    carried = _carried(model)
    links: list[Link] = []
    before, last = np.zeros(3), 0
    for j in range(model.njnt):
        body, joint = int(model.jnt_bodyid[j]), model.joint(j)
        name = model.body(body).name
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
            raise InputError(where, f"joint {joint.name or j + 1} of body {name} is no hinge", PLANAR)
        if carried[int(model.body_parentid[body])] != last or model.body_jntnum[body] != 1:
            raise InputError(where, f"body {name} branches off, or has two joints: the chain is not serial", PLANAR)
        mass, centre, inertia = _together(data, model, [b for b in range(model.nbody) if carried[b] == body])
        if mass < NO_MASS:
            raise InputError(where, f"body {name} has no mass", PLANAR)
        anchor, axis = data.xanchor[j].copy(), data.xaxis[j].copy()
        links.append(Link(
            name, anchor - before, axis, centre - anchor, mass, inertia, j in driven, joint.name,
            float(joint.damping[0]), float(joint.frictionloss[0]), float(joint.armature[0]),
            float(np.ravel(joint.stiffness)[0]), float(model.qpos_spring[model.jnt_qposadr[j]])))
        before, last = anchor, body
        if abs(abs(float(axis @ links[0].axis)) - 1.0) > 1e-3:
            raise InputError(where, f"turns {name} about another axis than {links[0].name}", PLANAR)
    return links


def _carried(model: Any) -> list[int]:
    """(B,) the body with a joint that each moves with; 0 for the world."""
    out = [0] * model.nbody
    for body in range(1, model.nbody):
        out[body] = body if model.body_jntnum[body] else out[int(model.body_parentid[body])]
    return out


def _together(data: Any, model: Any, bodies: list[int]) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre and inertia about it of bodies that move as one."""
    mass = float(sum(model.body_mass[b] for b in bodies))
    if mass < NO_MASS:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centre = sum(model.body_mass[b] * data.xipos[b] for b in bodies) / mass
    inertia = np.zeros((3, 3))
    for b in bodies:
        turn, off = data.ximat[b].reshape(3, 3), data.xipos[b] - centre
        inertia += turn @ np.diag(model.body_inertia[b]) @ turn.T
        inertia += model.body_mass[b] * (off @ off * np.eye(3) - np.outer(off, off))
    return mass, np.asarray(centre), inertia
