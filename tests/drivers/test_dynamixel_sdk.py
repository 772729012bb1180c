"""ROBOTIS' own library against ours: it talks to our emulator over a pseudo-terminal, and reads what we build."""

from collections.abc import Iterator
from typing import Any

import pytest

from drivers import dynamixel as dxl
from drivers.dynamixel import Address
from drivers.mock.dynamixel_drive import new_table
from tests.support.processes import REAL_CLOCK
from tests.support.recorded_port import RecordedPort, servo_line

sdk = pytest.importorskip("dynamixel_sdk")
pytestmark = REAL_CLOCK


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any, Any]]:
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 300)  # a loaded machine answers late
    with servo_line("dynamixel", new_table(4, 1200), sdk) as (drive, port):
        yield drive, port, sdk.PacketHandler(2.0)


def test_the_library_reads_and_writes_the_emulated_drive(far: tuple[Any, Any, Any]) -> None:
    drive, port, handler = far
    assert handler.ping(port, 3) == (1040, sdk.COMM_SUCCESS, 0)
    assert handler.read4ByteTxRx(port, 3, Address.PRESENT_POSITION) == (round(4096 / 6.283185307), sdk.COMM_SUCCESS, 0)
    assert handler.write1ByteTxRx(port, 3, Address.TORQUE_ENABLE, 1) == (sdk.COMM_SUCCESS, 0)
    assert handler.write2ByteTxRx(port, 3, Address.GOAL_CURRENT, 100) == (sdk.COMM_SUCCESS, 0)
    assert drive.table[Address.TORQUE_ENABLE] == 1 and drive.torque_nm > 0.0
    result, error = handler.write2ByteTxRx(port, 3, Address.GOAL_CURRENT, 5000)
    assert result == sdk.COMM_SUCCESS and "limit" in handler.getRxPacketError(error)
    result, error = handler.write1ByteTxRx(port, 3, Address.OPERATING_MODE, 3)
    assert result == sdk.COMM_SUCCESS and "not available" in handler.getRxPacketError(error)
    drive.table[Address.HARDWARE_ERROR_STATUS] = 0x20
    assert handler.read1ByteTxRx(port, 3, Address.HARDWARE_ERROR_STATUS) == (0x20, sdk.COMM_SUCCESS, dxl.ALERT)
    assert handler.reboot(port, 3)[0] == sdk.COMM_SUCCESS and drive.table[Address.TORQUE_ENABLE] == 0


def test_its_sync_read_finds_both_and_its_broadcast_ping_all(far: tuple[Any, Any, Any]) -> None:
    _, port, handler = far
    group = sdk.GroupSyncRead(port, handler, Address.MODEL_NUMBER, 2)
    assert group.addParam(3) and group.addParam(4)
    assert group.txRxPacket() == sdk.COMM_SUCCESS
    assert [group.getData(i, Address.MODEL_NUMBER, 2) for i in (3, 4)] == [1040, 1200]
    found, result = handler.broadcastPing(port)
    assert result == sdk.COMM_SUCCESS and {i: tuple(v) for i, v in found.items()} == {3: (1040, 45), 4: (1200, 45)}


def test_we_build_what_it_builds_byte_for_byte() -> None:
    port, handler = RecordedPort(), sdk.PacketHandler(2.0)
    handler.readTx(port, 5, 132, 4)
    handler.syncWriteTxOnly(port, 116, 4, [9, 1, 2, 3, 4], 5)
    handler.syncReadTx(port, 126, 10, [1, 2, 7], 3, False)
    assert port.sent == [dxl.read(5, 132, 4), dxl.silent_write(9, 116, b"\1\2\3\4"),
                         dxl.packet(dxl.BROADCAST, dxl.Instruction.SYNC_READ, bytes([126, 0, 10, 0, 1, 2, 7]))]


@pytest.mark.parametrize("data", [b"\xff\xff\xfd\x00", b"\x00\xff\xff\xfd", b"\xff\xff\xfd\xfd"])
def test_stuffing_is_the_librarys(far: tuple[Any, Any, Any], data: bytes) -> None:
    """What it stuffs, and what it reads of ours. (Version 4.1 stuffs and then sends the packet as it was.)"""
    drive, port, handler = far
    made = dxl.silent_write(9, 116, data)
    plain = [*made[:5], 12, 0, 0x83, 116, 0, 4, 0, 9, *data, 0, 0]
    assert bytes(handler.addStuffing(plain))[:-2] == made[:-2]
    drive.others[4][116:120] = data
    value, result, _ = handler.read4ByteTxRx(port, 4, 116)
    assert (value, result) == (int.from_bytes(data, "little"), sdk.COMM_SUCCESS)
