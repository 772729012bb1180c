"""A sketch of the mechanism in one pose of the record: links, angles with their sense, motors, IMUs, gravity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from daq import FloatArray
from estimator.model import ImuPlace, Mechanism, parent_of
from experiments.reports.figures import BLUE, GREEN, GREY, INK, ORANGE, blank_figure, to_svg
from experiments.reports.html import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARC, MARGIN = 0.32, 0.55
"""Radius of an angle's arc and the room around the links, in lengths of a link."""


def sketch_pictures(mechanism: Mechanism, poses: FloatArray, time_s: FloatArray, run: str) -> list[Picture]:
    """The mechanism where `poses` (n_samples, n) [rad] are furthest from zero; none where there is none to draw.

    `time_s` (n_samples,) [s] from any start. Hanging straight, as most runs begin, links and labels would overlap.
    """
    known = np.flatnonzero(np.isfinite(poses).all(axis=1))
    if mechanism.length_unit != "rad" or not known.size:
        return []
    k = known[np.argmax(np.sum(poses[known] ** 2, axis=1))]
    pose, when = poses[k], f"{time_s[k] - time_s[0]:.1f} s into run {run}"
    motors = [f"joint {j + 1}" for j in mechanism.actuated]
    angles = ", ".join(f"q{j + 1} = {x:.2f} rad" for j, x in enumerate(pose))
    caption = (f"The mechanism {when}: {angles}. Arrows show the sense in which an angle grows; a torque is positive "
               f"in the same sense. q1 counts from {'upright' if _up(mechanism) > 0.0 else 'hanging'}, the others from "
               f"the link before. Filled joints have a motor ({', '.join(motors) if motors else 'none'}). All "
               "links are drawn with the same length"
               + ("; x and y are the axes of an IMU." if _imus(mechanism) else "."))
    return [Picture(draw_mechanism(mechanism, pose), caption)]


def joint_places(mechanism: Mechanism, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 2) where each link begins and where it ends, x to the right and y up, each link of length 1."""
    theta = mechanism.from_zero(mechanism.transform @ pose)
    along = np.stack([np.sin(theta), _up(mechanism) * np.cos(theta)], axis=1)
    begin = np.zeros_like(along)
    for link in range(mechanism.n):
        parent = parent_of(mechanism, link)
        begin[link] = 0.0 if parent is None else begin[parent] + along[parent]
    return begin, begin + along


def _up(mechanism: Mechanism) -> float:
    """1 where an angle of zero points up, -1 where it hangs."""
    return 1.0 if mechanism.gravity < 0.0 else -1.0


def draw_mechanism(mechanism: Mechanism, pose: FloatArray) -> str:
    """The sketch as an `<svg>` element; `pose` (n,) [rad]."""
    begin, end = joint_places(mechanism, pose)
    with blank_figure(f"sketch {mechanism.name} {mechanism.n}", 3.0) as figure:
        axes = figure.add_subplot()
        for link in range(mechanism.n):
            _draw_link(axes, mechanism, link, begin, end)
        points = np.concatenate([begin, end])
        low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
        axes.annotate("g", (high[0], low[1] + 0.2), (high[0], low[1] + 0.8), color=GREY, ha="center",
                      arrowprops={"arrowstyle": "->", "color": GREY})
        axes.set_xlim(low[0], high[0] + 0.2)
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
        axes.axis("off")
        return to_svg(figure)


def _draw_link(axes: Axes, mechanism: Mechanism, link: int, begin: FloatArray, end: FloatArray) -> None:
    start, along = begin[link], end[link] - begin[link]
    parent, imus = parent_of(mechanism, link), _imus(mechanism)
    axes.plot(*zip(start, end[link]), color=BLUE, linewidth=4.0, solid_capstyle="round", zorder=2)
    side = 1 if along[0] >= 0.0 else -1  # away from the vertical, where the arc is
    at = 0.2 if any(place.link == link for place in imus) else 0.6  # which has a label of its own
    axes.annotate(f"link {link + 1}", tuple(start + at * along), xytext=(7 * side, 3), textcoords="offset points",
                  fontsize=9.0, ha="left" if side > 0 else "right")
    driven = link in mechanism.actuated
    axes.plot(*start, "o", color=BLUE, markerfacecolor=ORANGE if driven else "white", markersize=8.0, zorder=4)
    up = _up(mechanism)
    before = np.array([0.0, up]) if parent is None else end[parent] - begin[parent]
    axes.plot(*zip(start, start + 0.7 * before), color=GREY, linewidth=1.0, linestyle="--", zorder=1)
    if parent is None:
        axes.plot([start[0] - 0.2, start[0] + 0.2], [start[1]] * 2, color=INK, linewidth=3.0, zorder=1)
    for number, place in enumerate(imus, 1):
        if place.link == link:
            _draw_imu(axes, start + 0.55 * along, along, up, "IMU" if len(imus) == 1 else f"IMU {number}")
    if mechanism.transform[link, link] <= 0.0 or mechanism.exchanged:  # its angle is that of no single joint
        return
    first = float(np.arctan2(before[1], before[0]))
    turn = float(np.arctan2(before[0] * along[1] - before[1] * along[0], before @ along))
    arc = first + np.linspace(0.0, turn if abs(turn) > 0.15 else 0.15 * (-up), 30)
    if turn * up > 0.0:  # the arrow shows the sense in which the angle grows
        arc = arc[::-1]
    line = start[:, None] + ARC * np.stack([np.cos(arc), np.sin(arc)])
    axes.plot(*line[:, :-3], color=GREEN, linewidth=1.4, zorder=3)
    axes.annotate("", tuple(line[:, -1]), tuple(line[:, -4]), arrowprops={"arrowstyle": "->", "color": GREEN})
    axes.annotate(f"q{link + 1}", tuple(start + 1.7 * (line[:, len(arc) // 2] - start)), color=GREEN, ha="center",
                  va="center", fontsize=9.0)


def _draw_imu(axes: Axes, at: FloatArray, along: FloatArray, up: float, label: str) -> None:
    """Its x axis points the way in which it moves as the angle grows, its y axis along the link."""
    axes.plot(*at, "s", color=ORANGE, markersize=7.0, zorder=5)
    side = 1 if along[0] >= 0.0 else -1  # as of the link's label: on the other side is the arc
    for axis, name, aside in ((-up * np.array([-along[1], along[0]]), "x", 0.0), (along, "y", -0.14 * side)):
        tip, letter = at + 0.3 * axis, at + 0.38 * axis + np.array([aside, 0.0])
        axes.annotate("", tuple(tip), tuple(at), arrowprops={"arrowstyle": "->", "color": ORANGE}, zorder=5)
        axes.annotate(name, tuple(letter), color=ORANGE, ha="center", va="center", fontsize=9.0)
    axes.annotate(label, tuple(at), xytext=(10 * side, -12), textcoords="offset points", color=ORANGE,
                  ha="left" if side > 0 else "right", fontsize=9.0)


def _imus(mechanism: Mechanism) -> tuple[ImuPlace, ...]:
    """IMUs whose place is known."""
    return tuple(place for place in mechanism.imus if place.lever_arm > 0.0)
