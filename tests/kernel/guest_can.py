"""In the guest: the leg controller on the kernel's SocketCAN, vcan and slcan. Collected by tests/kernel/uml.py only."""

import errno
import fcntl
import os
import subprocess
import termios
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from typing import Any

import can
import pytest

from drivers import DeviceAbsent, LegController, LinkLost, State, Telemetry
from drivers.can_codec import CanCodec
from drivers.can_frame import CanFrame
from drivers.can_link import CanLink
from drivers.mock import CanServer, FirmwareSettings, MockRig
from tests.support.leg_on_a_link import PATIENCE_S, drive, is_stopped, ping, poll_until, settle
from tests.support.slcan_adapter import SlcanAdapter
from tests.support.still_plant import StillPlant

VCAN: dict[str, Any] = {"interface": "socketcan", "channel": "vcan0"}
NODE = 3


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


@contextmanager
def vcan_down() -> Iterator[None]:
    ip("link", "set", "vcan0", "down")
    try:
        yield
    finally:
        ip("link", "set", "vcan0", "up")


def raw(can_id: int, data: bytes = b"\0", **kind) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **kind)


@pytest.fixture
def rig() -> MockRig:
    # A slow telemetry: a system call costs 50 us in here, and the physics its own.
    return MockRig(StillPlant(), firmware=FirmwareSettings(telemetry_hz=100), codec=lambda: CanCodec(NODE))


@pytest.fixture
def server(rig: MockRig) -> Iterator[CanServer]:
    server = CanServer(rig.firmware, can.Bus(**VCAN), rig.clock)
    yield server
    with suppress(can.CanError):  # the interface was taken from it, as the test wanted
        server.close()


def connect() -> LegController:
    return LegController(CanLink(NODE, **VCAN), codec=CanCodec(NODE))


def test_the_whole_way_from_handshake_to_stop(rig: MockRig, server: CanServer) -> None:
    with connect() as controller:
        drive(controller, rig)
        ping(controller, rig)
        assert controller.stats.bad_crc == controller.stats.bad_length == controller.stats.unknown == 0
    is_stopped(rig)


def test_the_kernel_filters_other_nodes(rig: MockRig, server: CanServer) -> None:
    link = CanLink(NODE, **VCAN)
    with can.Bus(**VCAN) as other:
        for can_id in (NODE + 1 << 5 | 12, NODE << 5 | 12):
            other.send(raw(can_id))
        frames: list[CanFrame] = []
        deadline = time.monotonic() + PATIENCE_S
        while not any(f.data == b"\0" for f in frames) and time.monotonic() < deadline:
            frames += link.read()
    assert {f.can_id >> 5 for f in frames} == {NODE}
    link.close()


def test_interface_down_is_said_with_the_remedy_and_the_drive_falls_to_its_watchdog(rig: MockRig,
                                                                                    server: CanServer) -> None:
    controller = connect()
    controller.open(PATIENCE_S)
    controller.arm(200)
    controller.command(0.5)
    poll_until(controller, lambda r: controller.armed)
    with vcan_down():
        with pytest.raises(LinkLost, match="interface is down; bring it up: ip link set vcan0 up"):
            poll_until(controller, lambda r: False)
        with pytest.raises(LinkLost, match="is down"):
            controller.command(0.5)
        controller.close()
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            rig.firmware.transmit(rig.clock.now_ns())  # whoever served the bus was cut off with it
            time.sleep(0.01)
        assert rig.firmware.drive.torque_nm == 0.0 and rig.firmware.drive.state == State.FAULT


def test_an_interface_removed_is_gone(rig: MockRig, server: CanServer) -> None:
    controller = connect()
    controller.open(PATIENCE_S)
    ip("link", "del", "vcan0")
    try:
        with pytest.raises(LinkLost, match="is gone; plug the adapter in again"):
            poll_until(controller, lambda r: False)
        with pytest.raises(LinkLost, match="is gone"):
            controller.command(0.0)
        controller.close()
        with pytest.raises(DeviceAbsent, match="no such interface"):
            CanLink(NODE, **VCAN)
    finally:
        ip("link", "add", "vcan0", "type", "vcan")
        ip("link", "set", "vcan0", "up")


def test_a_flood_loses_frames_in_silence_and_the_codec_counts_them() -> None:
    link, codec, got = CanLink(NODE, **VCAN), CanCodec(NODE), list[Any]()
    with can.Bus(**VCAN) as other:
        for numbers in (range(1500), (1500, 1501)):
            for seq in numbers:
                for frame in codec.encode(Telemetry(seq, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 24.0, 25.0, 0.0)):
                    other.send(raw(frame.can_id, frame.data))
            while chunk := link.read():
                got += codec.feed(chunk)
    seqs = [m.seq for m in got]
    assert 10 < len(seqs) < 1500 and seqs == sorted(set(seqs)) and seqs[-1] == 1501
    assert codec.lost == 1502 - len(seqs) - seqs[0]
    link.close()


def test_error_frames_bus_off_ends_the_link_others_are_counted() -> None:
    link = CanLink(NODE, **VCAN)
    with can.Bus(**VCAN) as other:
        other.send(can.Message(arbitration_id=0x04, is_error_frame=True, data=bytes(8)))
        other.send(raw(NODE << 5 | 16, bytes(6)))
        assert link.read() == (CanFrame(NODE << 5 | 16, bytes(6)),)
        assert link.errors == 1
        other.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        with pytest.raises(LinkLost, match="bus-off"):
            link.read()
    link.close()


def test_the_kernels_stamp_is_of_the_arrival() -> None:
    with can.Bus(**VCAN) as a, can.Bus(**VCAN) as b:
        before = time.time()
        a.send(raw(1))
        sent = time.time()
        time.sleep(0.2)
        message = b.recv(PATIENCE_S)
        assert before - 0.02 < message.timestamp < sent + 0.02


def test_slcan_carries_frames_and_says_bus_off() -> None:
    with closing(SlcanAdapter()) as adapter:
        fcntl.ioctl(adapter.slave, termios.TIOCSETD, (17).to_bytes(4, "little"))  # N_SLCAN
        name = "slcan0" if os.path.exists("/sys/class/net/slcan0") else "can0"
        ip("link", "set", name, "up")
        link = CanLink(NODE, interface="socketcan", channel=name)
        link.write((CanFrame(NODE << 5, b""),))  # Stop
        deadline = time.monotonic() + PATIENCE_S
        settle(lambda: "t0600\r" in adapter.heard)
        adapter.say("t0706CDAB34120120\r")  # the Heartbeat of section 10
        frames: tuple[CanFrame, ...] = ()
        while not frames and time.monotonic() < deadline:
            frames = link.read()
        (beat,) = CanCodec(NODE).feed(frames)
        assert vars(beat) == {"boot_id": 0x1234ABCD, "faults": 1, "state": 2}
        adapter.say("sb255255\r")
        with pytest.raises(LinkLost, match="bus-off"):
            while time.monotonic() < deadline:
                link.read()
        link.close()


def test_sending_without_a_reader_ends_in_words_not_in_a_hang() -> None:
    link = CanLink(NODE, **VCAN)
    with vcan_down(), pytest.raises(LinkLost) as caught:
        link.write((CanFrame(NODE << 5, b""),))
    link.close()
    cause = caught.value.__cause__
    assert "\n" not in str(caught.value) and isinstance(cause, can.CanError) and cause.error_code == errno.ENETDOWN
