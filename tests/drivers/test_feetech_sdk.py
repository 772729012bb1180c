"""Feetech's own library against ours: it talks to our emulator over a pseudo-terminal, and reads what we build."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from drivers import feetech as sts
from drivers.feetech import Address
from drivers.mock.feetech_drive import new_table
from tests.support.processes import REAL_CLOCK
from tests.support.recorded_port import RecordedPort, servo_line

sdk = pytest.importorskip("scservo_sdk")
pytestmark = REAL_CLOCK


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any]]:
    monkeypatch.setattr("scservo_sdk.port_handler.LATENCY_TIMER", 300)  # a loaded machine answers late
    with servo_line("feetech", new_table(4, 2825), sdk) as (drive, port):
        yield drive, sdk.sms_sts(port)


def test_the_library_reads_and_writes_the_emulated_servo(far: tuple[Any, Any]) -> None:
    drive, handler = far
    assert handler.ping(3) == (777, sdk.COMM_SUCCESS, 0)
    assert handler.ReadPos(3) == (round(4096 / 6.283185307), sdk.COMM_SUCCESS, 0)
    drive.table[Address.PHASE] = sts.MULTI_TURN
    drive.settings = replace(drive.settings, knee_zero_rad=-3.0)
    assert handler.ReadPos(3) == (round(-2.0 * 4096 / 6.283185307), sdk.COMM_SUCCESS, 0)
    assert handler.unLockEprom(3) == (sdk.COMM_SUCCESS, 0)
    assert handler.write1ByteTxRx(3, Address.MODE, sts.PWM_MODE) == (sdk.COMM_SUCCESS, 0)
    assert handler.write1ByteTxRx(3, Address.TORQUE_ENABLE, 1) == (sdk.COMM_SUCCESS, 0)
    assert handler.write2ByteTxRx(3, Address.GOAL_TIME, handler.scs_toscs(-200, 10)) == (sdk.COMM_SUCCESS, 0)
    assert drive.torque_nm == pytest.approx(-0.2 * 2.9)
    load, result, error = handler.read2ByteTxRx(3, Address.PRESENT_LOAD)
    assert (handler.scs_tohost(load, 10), result, error) == (-200, sdk.COMM_SUCCESS, 0)
    drive.bus_v = 10.0
    error = handler.read1ByteTxRx(3, Address.PRESENT_VOLTAGE)[2]
    assert "voltage" in handler.getRxPacketError(error) and drive.table[Address.TORQUE_ENABLE] == 0


def test_its_sync_read_finds_both(far: tuple[Any, Any]) -> None:
    _, handler = far
    group = sdk.GroupSyncRead(handler, Address.MODEL, 2)
    assert group.addParam(3) and group.addParam(4)
    assert group.txRxPacket() == sdk.COMM_SUCCESS
    assert [group.getData(i, Address.MODEL, 2) for i in (3, 4)] == [777, 2825]


def test_we_build_what_it_builds_byte_for_byte() -> None:
    handler = sdk.sms_sts(port := RecordedPort())
    handler.readTx(5, 56, 2)
    handler.syncWriteTxOnly(40, 1, [9, 0], 2)
    handler.syncReadTx(56, 15, [1, 2, 7], 3)
    assert port.sent == [sts.read(5, 56, 2), sts.silent_write(9, 40, b"\0"),
                         sts.packet(sts.BROADCAST, sts.Instruction.SYNC_READ, bytes([56, 15, 1, 2, 7]))]
    assert all(handler.scs_toscs(n, 15) == sts.from_signed(n) for n in (-32767, -1, 0, 1, 32767))
