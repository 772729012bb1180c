"""Bags of ROS 2 by the library `rosbags`."""

from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

BEGIN_NS = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)


def made(kind: str, *fields: Any) -> Any:
    """A message, or a part of one: `sensor_msgs/JointState` and its fields."""
    return STORE.types[kind.replace("/", "/msg/")](*fields)


def header(time_s: float, frame: str = "") -> Any:
    """The header of a message of that second of the bag."""
    return made("std_msgs/Header", made("builtin_interfaces/Time", *divmod(at_ns(time_s), 10**9)), frame)


def at_ns(time_s: float) -> int:
    return BEGIN_NS + round(time_s * 1e9)


class Bag(Writer):
    """A bag to be written; a topic begins with its first message."""

    def __init__(self, folder: Path, plugin: StoragePlugin = StoragePlugin.MCAP) -> None:
        super().__init__(folder, version=9, storage_plugin=plugin)
        self.topics: dict[str, Any] = {}

    def put(self, topic: str, time_s: float, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self.topics:
            self.topics[topic] = self.add_connection(topic, kind, typestore=STORE)
        self.write(self.topics[topic], at_ns(time_s), STORE.serialize_cdr(message, kind))
