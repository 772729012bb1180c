"""A run as ROS 2 messages in an MCAP file, every sample at its own time of the wall clock.

| topic | type | holds |
| --- | --- | --- |
| /imu | sensor_msgs/msg/Imu | frame `imu_link`: x tangential, y outwards; right-handed, so z turns against q1 |
| /joint_states | sensor_msgs/msg/JointState | positions of `pivot`, where it has a Hall sensor, and `knee` |
| /joint_torques | sensor_msgs/msg/JointState | efforts of `knee`, each at the middle of the period it is the mean of |
| /joint_commands | sensor_msgs/msg/JointState | efforts asked of `knee` |
| /imu/clock_bound | std_msgs/msg/Float64 | how far the IMU's time line may be off the joints' [s]; once |

What was not measured has a covariance that begins with -1 (orientation) or is 0 (the IMU's other axes).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer

from daq import Dataset, FloatArray, Rig, load_rig, write_file
from daq.runs import IMU, read_run
from daq.timing import TimedColumns, decode, recorded_rig
from experiments.exchange.imported import needs
from experiments.exchange.reading import is_native, load_to_convert

LIBRARY = "ros2 messages by legid"
"""Not what a native run's begins with: the file is nobody's raw recording."""
JOINTS = {"q1_rad": ("/joint_states", "pivot", "position"), "q2_rad": ("/joint_states", "knee", "position"),
          "tau2_nm": ("/joint_torques", "knee", "effort"), "tau2_cmd_nm": ("/joint_commands", "knee", "effort")}
Message = tuple[int, bytes]


class Exported(NamedTuple):
    messages: int
    notes: list[str]
    """What the file does not hold or cannot know."""


def export_ros2(path: Path | str, rig_path: Path | str | None, out: Path | str) -> Exported:
    """Write the run at `path`; a native one at its devices' own rates. Raises `InputError`."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise needs("--to ros2", "rosbags", "ros") from None
    channels, start_ns, bound_s, notes = _samples(path, rig_path)
    store = get_typestore(Stores.ROS2_JAZZY)
    topics = _messages(channels, start_ns, store)
    if bound_s > 0.0:
        kind = "std_msgs/msg/Float64"
        topics["/imu/clock_bound"] = kind, [(start_ns, bytes(store.serialize_cdr(store.types[kind](bound_s), kind)))]
    held = {*JOINTS, *(IMU if "/imu" in topics else ())}
    left = sorted({name for channel in channels for name in channel.columns} - held)
    notes += [f"left out, no topic of these types holds them: {', '.join(left)}"] if left else []
    return Exported(_write(Path(out), topics, store), notes)


def _samples(path: Path | str, rig_path: Path | str | None) -> tuple[list[TimedColumns], int, float, list[str]]:
    """Channels in SI units, the wall clock at their time 0 [ns since 1970], the clocks' bound [s], what is unknown."""
    if not is_native(path):
        run: Dataset = load_to_convert(path, rig_path, None)
        notes = ["the file has no wall clock: times count from 1970"]
        return [TimedColumns(run.time_s, run.columns)], 0, run.clock_bound_s, notes
    raw = read_run(path)
    rig: Rig = recorded_rig(raw) if rig_path is None else load_rig(rig_path)
    found = decode(raw, rig)
    if not {"started_unix_ns", "started_monotonic_ns"} <= raw.facts.keys():
        notes = ["the run does not say when it was recorded: times count from 1970"]
        return found.channels, 0, found.bound_s, notes
    start_ns = int(raw.facts["started_unix_ns"]) - int(raw.facts["started_monotonic_ns"]) + found.epoch_ns
    return found.channels, start_ns, found.bound_s, []


def _messages(channels: Sequence[TimedColumns], start_ns: int, store: Any) -> dict[str, tuple[str, list[Message]]]:
    """Topic -> its type and (time, CDR) of every message."""
    types, topics = store.types, dict[str, tuple[str, list[Message]]]()

    def put(topic: str, kind: str, frame: str, time_s: FloatArray, rows: Iterable[Sequence[Any]]) -> None:
        topics[topic] = kind, []
        for t, row in zip(np.rint(time_s * 1e9).astype(np.int64).tolist(), rows):
            stamp = types["builtin_interfaces/msg/Time"](*divmod(start_ns + t, 1_000_000_000))
            message = types[kind](types["std_msgs/msg/Header"](stamp, frame), *row)
            topics[topic][1].append((start_ns + t, bytes(store.serialize_cdr(message, kind))))

    vector, upright = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    nothing, unknown, empty = np.zeros(9), np.array([-1.0] + [0.0] * 8), np.zeros(0)
    for channel in channels:
        if all(name in channel.columns for name in IMU):
            put("/imu", "sensor_msgs/msg/Imu", "imu_link", channel.time_s, (
                (upright, unknown, vector(0.0, 0.0, -w), nothing, vector(x, y, 0.0), nothing)
                for w, x, y in zip(*(channel.columns[name].tolist() for name in IMU))))
        for topic in dict.fromkeys(topic for topic, _, _ in JOINTS.values()):
            mine = {joint: channel.columns[name] for name, (where, joint, _) in JOINTS.items()
                    if where == topic and name in channel.columns}
            if mine:
                rows = np.stack(list(mine.values()), axis=1)
                put(topic, "sensor_msgs/msg/JointState", "", channel.time_s, (
                    (list(mine), row, empty, empty) if topic == "/joint_states" else (list(mine), empty, empty, row)
                    for row in rows))
    return topics


def _write(out: Path, topics: dict[str, tuple[str, list[Message]]], store: Any) -> int:
    file = BytesIO()
    writer = Writer(file, compression=CompressionType.LZ4)
    writer.start("ros2", LIBRARY)
    for topic, (kind, messages) in topics.items():
        text, _ = store.generate_msgdef(kind, ros_version=2)
        schema = writer.register_schema(kind, "ros2msg", text.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for at, data in messages:
            writer.add_message(channel, at, data, at)
    writer.finish()  # type: ignore[no-untyped-call]
    write_file(out, file.getvalue())
    return sum(len(messages) for _, messages in topics.values())
