"""`read_robot`: a serial planar chain of a URDF or MJCF file as body values for a rig file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq import ASSUMED, FloatArray, InputError, comment, read_bytes

SHARE = 0.05
"""Standard deviation that is written for a value of the file, which gives none, as a share of it."""
OFF_LINE = 0.02
"""Distance of a centre of mass from the line between joints, as a share of its length, that is mentioned."""
MOST_BYTES, MOST_LINKS = 10_000_000, 64
PLANAR = "give a serial chain of hinges with parallel axes, each with its <inertial>, without rpy, quat or euler"


@dataclass(frozen=True)
class Link:
    """One link and the hinge that carries it, in the link's own frame."""

    name: str
    at: FloatArray
    """(3,) its hinge, in the frame of the link before [m]"""
    axis: FloatArray
    """(3,)"""
    centre: FloatArray
    """(3,) of mass, from the hinge [m]"""
    mass: float
    inertia: FloatArray
    """(3, 3) about the centre of mass [kg m^2]"""
    driven: bool


def read_robot(path: Path) -> list[Link]:
    """Links from the base outwards. Raises `InputError` naming the file and the element."""
    try:
        data = read_bytes(path, MOST_BYTES)
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "give a URDF or MJCF file") from None
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(str(path), "declares entities", "give a plain URDF or MJCF file")
    try:
        root = ET.fromstring(data.decode("utf-8-sig"))  # of no other encoding: what it declares was looked for above
        links = {"robot": _urdf, "mujoco": _mjcf}[root.tag](root, str(path))
    except ET.ParseError as error:
        raise InputError(str(path), f"is not XML: {error}", "give a URDF or MJCF file; run xacro first") from None
    except KeyError:
        raise InputError(str(path), f"begins with <{root.tag}>", "give a URDF or MJCF file; run xacro first") from None
    except UnicodeDecodeError:
        raise InputError(str(path), "is not UTF-8 text", "save it as UTF-8") from None
    except ValueError as error:
        raise InputError(str(path), f"has an element that is no number: {error}", "correct it") from None
    if not 0 < len(links) <= MOST_LINKS:
        raise InputError(str(path), f"has more than {MOST_LINKS} hinges" if links else "has no hinge", PLANAR)
    for link in links:
        if abs(abs(float(link.axis @ links[0].axis)) - 1.0) > 1e-3:
            raise InputError(str(path), f"turns {link.name} about another axis than {links[0].name}", PLANAR)
    return links


def prior_table(links: list[Link], source: str) -> str:
    """The table [prior] of a rig file, with what it leaves out as comments."""
    source = comment(source)
    lines = ["", f"[prior]                          # of {source}; {ASSUMED}: standard deviations are {SHARE:.0%}"]
    across = np.eye(3) - np.outer(links[0].axis, links[0].axis)
    for i, link in enumerate(links, 1):
        name = comment(link.name)
        centre = across @ link.centre
        end = across @ links[i].at if i < len(links) else centre
        length = float(np.linalg.norm(end))
        along = end / length if length > 0.0 else end
        lc = float(centre @ along)
        values = {"m": link.mass, "lc": lc, "I": float(link.axis @ link.inertia @ link.axis)}
        values |= {"l": length} if i < len(links) else {}
        for kind, value in values.items():
            lines.append(f"{kind}{i} = [{value:.6g}, {SHARE * abs(value):.2g}]" if value else
                         f"# {kind}{i} is 0 in the file: give it with its standard deviation")
        off = float(np.linalg.norm(centre - lc * along))
        if off > OFF_LINE * max(length, 1e-9):
            lines.append(f"# the centre of mass of {name} is {off:.3g} m off the line between its joints, which "
                         "is left out")
        if length and abs(float(along[2]) + 1.0) > 1e-3:
            lines.append(f"# where the file's angles are zero, {name} points along {np.round(along, 3).tolist()}, "
                         "not down: add that angle as offset under [columns]")
    return "\n".join(lines) + "\n"


def _vector(element: ET.Element | None, key: str, default: str = "0 0 0") -> FloatArray:
    text = default if element is None else element.get(key, default)
    return np.array([float(x) for x in text.split()])


def _urdf(root: ET.Element, where: str) -> list[Link]:
    bodies = {link.get("name", ""): link for link in root.findall("link")}
    joints = root.findall("joint")
    children = {_named(joint, "child") for joint in joints}
    base = next((name for name in bodies if name not in children), "")
    driven = {joint.get("name") for joint in root.findall("transmission/joint")}
    found: list[Link] = []
    seen = {base}
    while len(found) <= MOST_LINKS and (own := [joint for joint in joints if _named(joint, "parent") == base]):
        joint, base = own[0], _named(own[0], "child")
        inertial = bodies[base].find("inertial") if base in bodies else None
        mass, tensor = (None if inertial is None else inertial.find(tag) for tag in ("mass", "inertia"))
        turned = any(_vector(e, "rpy").any() for e in (joint.find("origin"), None if inertial is None else
                                                       inertial.find("origin")))
        hinge = joint.get("type") in ("revolute", "continuous")
        if base in seen:
            raise InputError(where, f"joint {joint.get('name')} leads back to {base}", PLANAR)
        seen.add(base)
        if len(own) > 1 or turned or not hinge or mass is None or tensor is None or inertial is None:
            raise InputError(where, f"joint {joint.get('name')} or its link {base} is none that can be read", PLANAR)
        i = {key: float(tensor.get(key, "0")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")}
        matrix = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]],
                           [i["ixz"], i["iyz"], i["izz"]]])
        found.append(Link(base, _vector(joint.find("origin"), "xyz"),
                          _unit(_vector(joint.find("axis"), "xyz", "1 0 0")),
                          _vector(inertial.find("origin"), "xyz"), float(mass.get("value", "0")), matrix,
                          joint.get("name") in driven))
    return found


def _named(joint: ET.Element, tag: str) -> str:
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _mjcf(root: ET.Element, where: str) -> list[Link]:
    driven = {motor.get("joint") for motor in root.findall("actuator/*")}
    parent, found = root.find("worldbody"), list[Link]()
    while parent is not None and len(found) <= MOST_LINKS and (own := parent.findall("body")):
        body = own[0]
        joints, inertial = body.findall("joint"), body.find("inertial")
        turned = any(key in e.attrib for e in (body, inertial) if e is not None
                     for key in ("quat", "euler", "axisangle", "xyaxes", "zaxis", "fullinertia"))
        if (len(own) > 1 or len(joints) != 1 or joints[0].get("type", "hinge") != "hinge" or inertial is None or turned
                or _vector(joints[0], "pos").any()):
            raise InputError(where, f"body {body.get('name')} is none that can be read", PLANAR)
        found.append(Link(body.get("name", ""), _vector(body, "pos"), _unit(_vector(joints[0], "axis", "0 0 1")),
                          _vector(inertial, "pos"), float(inertial.get("mass", "0")),
                          np.diag(_vector(inertial, "diaginertia")), joints[0].get("name") in driven))
        parent = body
    return found


def _unit(axis: FloatArray) -> FloatArray:
    size = float(np.linalg.norm(axis))
    if not size > 0.0:
        raise ValueError("an axis of no length")
    return axis / size
