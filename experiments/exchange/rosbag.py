"""ROS 1 and ROS 2 bags, by the library `rosbags`: every number of every message, as `/topic/field/field`.

Names of joints stand in place of their numbers: `/joint_states/knee/position`. A message's time is that of its header
where it has one, else the one at which it was received.

A trajectory_msgs/JointTrajectory commands points at times after its stamp, zero meaning the time of arrival
(`ros2/common_interfaces`; `ros-controls/ros2_controllers`, its joint_trajectory_controller). `/topic/knee/position`
has the command at the times of the joints' states: lines between points, the last point until the next message, which
replaces what is left. A controller that interpolates by splines differs from that between points.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from daq import FloatArray, InputError
from experiments.exchange.imported import ImportedFile, Table, needs

PARALLEL = {"position": "position", "velocity": "velocity", "effort": "effort",
            "positions": "position", "velocities": "velocity", "accelerations": "acceleration"}
"""Fields of a JointState, or of a point in a controller's state, that go with the names of joints -> what one is."""
GRID_NS = 10_000_000
"""Between commands of a bag without states."""
LONGEST = 64
"""Arrays beyond this are images and clouds, not signals."""


def read_bag(path: Path) -> ImportedFile:
    """One table a topic. `path` is a bag's folder, or its .mcap, .db3 or .bag file. Raises `InputError`, and what
    the library raises for a file that is damaged or of another kind."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise needs(path, "rosbags", "ros") from None
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    planned: dict[str, list[_Point]] = defaultdict(list)
    times: dict[str, list[int]] = defaultdict(list)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, received_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, "joint_names") and hasattr(message, "points"):
                begin = _stamp_ns(message) or received_ns
                _command(planned[connection.topic], list(_points(message, begin)), begin)
                continue
            rows[connection.topic].append(dict(_numbers(message, connection.topic)))
            times[connection.topic].append(_stamp_ns(message) or received_ns)
    for topic, some in planned.items():
        if some:
            times[topic] = _times_of(some, rows, times)
    if not times:
        raise InputError(str(path), "holds no message", "record again")
    first = min(min(stamps) for stamps in times.values())
    return ImportedFile(path.name, tuple(Table(
        _columns(rows[topic]) if topic in rows else _sampled(planned[topic], stamps, topic),
        (np.array(stamps, dtype=np.int64) - first).astype(np.float64) * 1e-9) for topic, stamps in times.items()))


class _Point(NamedTuple):
    at_ns: int
    values: Mapping[str, float]
    """/joint/position and so on -> number."""


def _points(message: Any, begin_ns: int) -> Iterator[_Point]:
    """Points of a trajectory that begins at `begin_ns`, in its order."""
    for point in message.points:
        after = int(point.time_from_start.sec) * 1_000_000_000 + int(point.time_from_start.nanosec)
        yield _Point(begin_ns + after, {
            f"/{joint}/{kind}": float(number) for kind, numbers in (
                ("position", point.positions), ("velocity", point.velocities), ("effort", point.effort))
            for joint, number in zip(message.joint_names, numbers)})


def _command(so_far: list[_Point], points: list[_Point], begin_ns: int) -> None:
    """Put `points` of a message from `begin_ns` behind those that it does not replace."""
    so_far[:] = [point for point in so_far if point.at_ns < begin_ns]
    if so_far and points:
        so_far.append(_Point(begin_ns - 1, so_far[-1].values))
    so_far += points


def _times_of(points: list[_Point], rows: Mapping[str, list[dict[str, float]]], times: Mapping[str, list[int]]
              ) -> list[int]:
    """Times [ns] of the messages that hold the joints' measured positions, after the first point; else of a grid."""
    first, last = points[0].at_ns, points[-1].at_ns
    joints = tuple(name for name in points[0].values if name.endswith("/position"))
    states = next((topic for topic, some in rows.items() if some and any(
        name.endswith(joints) for name in some[-1])), None) if joints else None
    found = times[states] if states is not None else list(range(first, last + 1, GRID_NS))
    return [t for t in found if t >= first] or [first]


def _sampled(points: list[_Point], at_ns: list[int], topic: str) -> dict[str, FloatArray]:
    """The command at each of `at_ns`: lines between points, the last one's values after it."""
    first, names = points[0].at_ns, dict.fromkeys(name for point in points for name in point.values)
    known = np.array([point.at_ns - first for point in points], dtype=np.float64)
    wanted = np.array(at_ns, dtype=np.int64) - first
    columns = {}
    for name in names:
        values = np.array([point.values.get(name, np.nan) for point in points])
        there = np.isfinite(values)
        if there.any():
            columns[f"{topic}{name}"] = np.interp(wanted, known[there], values[there])
    return columns


def _columns(rows: list[dict[str, float]]) -> dict[str, FloatArray]:
    """Those of one topic; NaN where a message lacks one."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def _stamp_ns(message: Any) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _numbers(value: Any, prefix: str, names: Any = None) -> Iterator[tuple[str, float]]:
    """(`prefix`/field, number) of a message; `names` are the joints of the message that it is part of."""
    if isinstance(value, bool | int | float | np.number):
        yield prefix, float(value)
    elif is_dataclass(value):
        own = getattr(value, "name", None)
        names = own if isinstance(own, list) else getattr(value, "joint_names", names)
        for item in fields(value):
            inner = getattr(value, item.name)
            if item.name.startswith("__") or item.name == "header":
                continue
            if isinstance(names, list) and item.name in PARALLEL:
                for joint, number in zip(names, inner):
                    yield f"{prefix}/{joint}/{PARALLEL[item.name]}", float(number)
            else:
                yield from _numbers(inner, f"{prefix}/{item.name}", names)
    elif isinstance(value, np.ndarray | list) and len(value) <= LONGEST and "covariance" not in prefix:
        for k, inner in enumerate(value):
            yield from _numbers(inner, f"{prefix}[{k}]")
