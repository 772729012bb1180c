"""Logs of drives on CAN, written by python-can itself, read by their published protocols."""

import struct
from pathlib import Path

import can
import numpy as np
import pytest
from numpy.testing import assert_allclose

from daq import Column, InputError
from experiments.exchange import apply_map, read_imported
from experiments.exchange.can_log import read_can_log, registers

T = np.arange(0.0, 2.0, 0.01)
TURNS = 0.1 * np.sin(3.0 * T)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_an_odrive_s_angle_and_current_become_a_run(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"bus{suffix}"
    with can.Logger(path) as log:
        for t, turns in zip(T, TURNS):
            sent = (0.0, 0x09, (turns, 0.0)), (0.001, 0x14, (9.0, 2.0 * turns)), (0.002, 1, (0.0, 0.0))
            for late, command, values in sent:
                log.on_message_received(can.Message(timestamp=1.7e9 + t + late, arbitration_id=3 << 5 | command,
                                                    is_extended_id=False, data=struct.pack("<ff", *values)))
    imported = read_imported(path)
    assert imported.names == ["odrive3/pos_estimate [turn]", "odrive3/vel_estimate [turn/s]", "odrive3/Iq_setpoint [A]",
                             "odrive3/Iq_measured [A]"]
    run = apply_map(imported, {"q1_rad": Column(name="odrive3/pos_estimate [turn]", unit="turn"),
                              "tau1_nm": Column(name="odrive3/Iq_measured [A]", unit="A", scale=0.08, delay=0.001)})
    assert run.rate_hz == pytest.approx(100.0, rel=0.01)
    at = run.time_s  # the log's first message is the angle's
    assert_allclose(run["q1_rad"], 0.2 * np.pi * np.sin(3.0 * at), atol=2e-4)
    assert_allclose(run["tau1_nm"], 0.016 * np.sin(3.0 * at), atol=2e-5)


def test_a_moteus_reply_of_every_kind() -> None:
    """Mode as int8, then position, speed and torque as int16, position as int32, torque as float, a NaN, padding."""
    frame = bytes([0x21, 0x00, 0x0A, 0x27, 0x01]) + struct.pack("<hhh", 2500, -400, 150)
    frame += bytes([0x29, 0x01]) + struct.pack("<i", 12345) + bytes([0x2C, 0x01, 0x03]) + struct.pack("<f", -1.25)
    frame += bytes([0x25, 0x01]) + struct.pack("<h", -32768) + bytes([0x50, 0x50])
    found = list(registers(frame))
    assert found[:6] == [(0, 10.0), (1, 0.25), (2, -0.1), (3, 1.5), (1, pytest.approx(0.12345)), (3, -1.25)]
    assert found[6][0] == 1 and np.isnan(found[6][1]) and len(found) == 7
    assert list(registers(bytes([0x01, 0x00, 0x0A]))) == []  # a command, not a reply
    assert list(registers(frame[:9])) == [(0, 10.0)]  # cut off


def test_a_moteus_on_the_bus(tmp_path: Path) -> None:
    with can.Logger(tmp_path / "bus.log") as log:
        for t, turns in zip(T, TURNS):
            data = bytes([0x26, 0x01]) + struct.pack("<hh", round(turns / 1e-4), 0) + bytes([0x50, 0x50])
            log.on_message_received(can.Message(timestamp=1.7e9 + t, arbitration_id=0x100, is_extended_id=False,
                                                is_fd=True, data=data))
    imported = read_can_log(tmp_path / "bus.log")
    values = imported.table_of("moteus1/position [turn]").columns["moteus1/position [turn]"]
    assert_allclose(values, TURNS, atol=0.51e-4)


def test_logs_of_others(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(1436509052.249713) vcan0 044#2A366C2BBA\n")
    (tmp_path / "b.log").write_text("(14x) vcan0 044#2A\n")
    with pytest.raises(InputError, match="no message of an ODrive or a moteus"):
        read_imported(tmp_path / "a.log")
    with pytest.raises(InputError, match="cannot be read as a CAN log"):
        read_imported(tmp_path / "b.log")
