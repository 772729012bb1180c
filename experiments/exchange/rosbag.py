"""ROS 1 and ROS 2 bags, by the library `rosbags`: every number of every message, as `/topic/field/field`.

Names of joints stand in place of their numbers: `/joint_states/knee/position`. A message's time is that of its header
where it has one, else the one at which it was received.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daq import InputError
from experiments.exchange.imported import ImportedFile, Table

SUFFIXES = (".mcap", ".db3", ".bag")
PARALLEL = ("position", "velocity", "effort")
"""Fields of sensor_msgs/JointState that go with its names."""
LONGEST = 64
"""Arrays beyond this are images and clouds, not signals."""


def read_bag(path: Path) -> ImportedFile:
    """One table a topic. `path` is a bag's folder, or its .mcap, .db3 or .bag file. Raises `InputError`, and what
    the library raises for a file that is damaged or of another kind."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(str(path), "needs the package rosbags", 'install it: pip install "legid[ros]"') from None
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    times: dict[str, list[int]] = defaultdict(list)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, received_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            rows[connection.topic].append(dict(_numbers(message, connection.topic)))
            times[connection.topic].append(_stamp_ns(message) or received_ns)
    if not times:
        raise InputError(str(path), "holds no message", "record again")
    first = min(min(stamps) for stamps in times.values())
    return ImportedFile(path.name, tuple(_table(rows[topic], times[topic], first) for topic in rows),
                   {"started_unix_ns": str(first)})


def _table(rows: list[dict[str, float]], stamps: list[int], first: int) -> Table:
    time_s = (np.array(stamps, dtype=np.int64) - first).astype(np.float64) * 1e-9
    names = list(dict.fromkeys(name for row in rows for name in row))
    return Table({name: np.array([row.get(name, np.nan) for row in rows]) for name in names}, time_s)


def _stamp_ns(message: Any) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _numbers(value: Any, prefix: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float | np.number):
        yield prefix, float(value)
    elif is_dataclass(value):
        names = getattr(value, "name", None)
        for item in fields(value):
            inner = getattr(value, item.name)
            if item.name.startswith("__") or item.name == "header":
                continue
            if isinstance(names, list) and item.name in PARALLEL:
                for joint, number in zip(names, inner):
                    yield f"{prefix}/{joint}/{item.name}", float(number)
            else:
                yield from _numbers(inner, f"{prefix}/{item.name}")
    elif isinstance(value, np.ndarray | list) and len(value) <= LONGEST and "covariance" not in prefix:
        for k, inner in enumerate(value):
            yield from _numbers(inner, f"{prefix}[{k}]")
