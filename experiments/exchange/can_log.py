"""Logs of a CAN bus with ODrive or moteus on it, of any kind that python-can reads (candump .log, .asc, .blf, .trc).

ODrive, classic CAN, identifier = node << 5 | command, little endian (its page "CAN Protocol"):

| command | holds |
| --- | --- |
| 0x09 Get_Encoder_Estimates | position [turn], speed [turn/s], float32 each |
| 0x14 Get_Iq | current asked for, measured [A], float32 each |
| 0x1C Get_Torques | torque asked for, estimated [N m], float32 each |

moteus, CAN-FD, replies of registers (its page "Protocol"): identifier source << 8 | destination; a frame is a row of
`0x20 | type << 2 | count`, where a count of 0 stands in the next byte, the first register, and the values: int8, int16,
int32 or float32. Registers: 1 position [turn], 2 speed [turn/s], 3 torque [N m], 4 current [A].
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from daq import InputError, open_regular
from experiments.exchange.imported import ImportedFile, Table

SUFFIXES = (".asc", ".blf", ".trc")
ODRIVE = {0x09: ("pos_estimate [turn]", "vel_estimate [turn/s]"), 0x14: ("Iq_setpoint [A]", "Iq_measured [A]"),
          0x1C: ("torque_target [N m]", "torque_estimate [N m]")}
MOTEUS = {1: "position [turn]", 2: "velocity [turn/s]", 3: "torque [N m]", 4: "q_current [A]"}
RESOLUTION = {1: (1e-2, 1e-4, 1e-5), 2: (1e-1, 2.5e-4, 1e-5), 3: (0.5, 1e-2, 1e-3), 4: (1.0, 0.1, 1e-3)}
"""Register -> what one count of an int8, int16, int32 is worth."""
KINDS = ((1, "<b"), (2, "<h"), (4, "<i"), (4, "<f"))
REPLY, NOP = 0x20, 0x50


def is_candump(path: Path) -> bool:
    """A text that begins as `candump -l` writes: (time) interface identifier#data."""
    try:
        with open_regular(path) as file:
            head = file.readline(200)
    except (OSError, InputError):
        return False
    return head.startswith(b"(") and b"#" in head and b")" in head


def read_can_log(path: Path) -> ImportedFile:
    """One table a node and message, `odrive0/pos_estimate [turn]`, times from the log's first. Raises `InputError`,
    and what python-can raises for a damaged line."""
    import can

    tables: dict[tuple[str, int], list[tuple[float, tuple[float, ...]]]] = defaultdict(list)
    readers = {".asc": can.ASCReader, ".blf": can.BLFReader, ".trc": can.TRCReader}  # can.LogReader runs plug-ins, too
    with readers.get(path.suffix.lower(), can.CanutilsLogReader)(path) as log:
        for message in log:
            if message.is_error_frame or message.is_remote_frame:
                continue
            for key, values in _decoded(message.arbitration_id, bytes(message.data), bool(message.is_fd)):
                tables[key].append((message.timestamp, values))
    if not tables:
        raise InputError(str(path), "holds no message of an ODrive or a moteus with an angle, a current or a torque",
                         "log the bus while the drive reports")
    first = min(rows[0][0] for rows in tables.values())
    return ImportedFile(path.name, tuple(
        _table(node, kind, rows, first) for (node, kind), rows in sorted(tables.items())))


def _table(node: str, kind: int, rows: list[tuple[float, tuple[float, ...]]], first: float) -> Table:
    names = ODRIVE[kind] if node.startswith("odrive") else (MOTEUS[kind],)
    values = np.array([numbers for _, numbers in rows], dtype=np.float64)
    return Table({f"{node}/{name}": values[:, k] for k, name in enumerate(names)},
                 np.array([t for t, _ in rows]) - first)


def _decoded(identifier: int, data: bytes, fd: bool) -> Iterator[tuple[tuple[str, int], tuple[float, ...]]]:
    """(node, command or register) and its values."""
    if not fd and identifier < 0x800 and identifier & 0x1F in ODRIVE and len(data) == 8:
        yield (f"odrive{identifier >> 5}", identifier & 0x1F), struct.unpack("<ff", data)
    elif fd:
        for register, value in registers(data):
            if register in MOTEUS:
                yield (f"moteus{identifier >> 8 & 0x7F}", register), (value,)


def registers(data: bytes) -> Iterator[tuple[int, float]]:
    """(register, value in its unit) of the replies in a moteus frame; what is no reply ends it."""
    at = 0
    while at + 2 <= len(data) and data[at] & 0xF0 == REPLY:
        size, code = KINDS[data[at] >> 2 & 3]
        count = data[at] & 3
        at += 1
        if count == 0:
            count = data[at]
            at += 1
        if at >= len(data) or at + 1 + count * size > len(data):
            return
        register = data[at]
        at += 1
        for k in range(count):
            (raw,) = struct.unpack_from(code, data, at)
            at += size
            yield register + k, _value(register + k, raw, code)
        while at < len(data) and data[at] == NOP:
            at += 1


def _value(register: int, raw: float, code: str) -> float:
    """In the register's unit; the smallest integer says that there is none."""
    if code == "<f" or register not in RESOLUTION:
        return float(raw)
    k = ("<b", "<h", "<i").index(code)
    return float("nan") if raw == -(1 << (8 << k) - 1) else raw * RESOLUTION[register][k]
