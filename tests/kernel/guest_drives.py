"""In the guest: bought drives on the kernel's SocketCAN, CAN FD and classic on one bus. Collected by uml.py only."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from drivers import DeviceAbsent, Drive, Telemetry, Wiring, open_drive
from drivers.mock import CanServer, MockRig, drive_facts, drive_maker
from tests.support.drive_bench import telemetry
from tests.support.leg_on_a_link import PATIENCE_S, settle
from tests.support.still_plant import StillPlant

VCAN: dict[str, Any] = {"interface": "socketcan", "channel": "vcan0"}
WATCHDOG_MS = 500


class Served:
    """A drive's emulator on vcan0."""

    def __init__(self, kind: str) -> None:
        # A slow rate: a system call costs 50 us in here.
        self.wiring = Wiring(can=VCAN, node=drive_facts(kind).node, rate_hz=50.0, gear_ratio=50.0, turns=50.0,
                             watchdog_ms=WATCHDOG_MS)
        self.rig = MockRig(StillPlant(), make=drive_maker(kind, self.wiring))
        self.far: Any = self.rig.drive
        self.server = CanServer(self.rig.drive, can.Bus(**VCAN, fd=kind == "moteus"), self.rig.clock)


def serve(kind: str) -> Iterator[Served]:
    served = Served(kind)
    yield served
    served.server.close()


@pytest.fixture
def moteus() -> Iterator[Served]:
    yield from serve("moteus")


@pytest.fixture
def odrive() -> Iterator[Served]:
    yield from serve("odrive")


def drive_until(drive: Drive, torque_nm: float, wanted: Callable[[], bool]) -> list[Telemetry]:
    """Poll and command until then; what came."""
    out, deadline = [], time.monotonic() + PATIENCE_S
    while not wanted():
        assert time.monotonic() < deadline, "it did not come"
        out += telemetry(drive.poll())
        drive.command(torque_nm)
    return out


def torque_of(drive: Drive) -> float:
    return drive.telemetry.torque_cmd_nm if drive.telemetry else 0.0


def test_a_moteus_is_driven_over_can_fd_and_its_watchdog_ends_the_torque(moteus: Served) -> None:
    with can.Bus(**VCAN, fd=True) as tap, open_drive("moteus", moteus.wiring) as drive:
        assert drive.open(PATIENCE_S).torque_limit_nm > 0.0
        assert drive.limits is not None
        drive.arm(WATCHDOG_MS)
        seen = drive_until(drive, 0.5, lambda: drive.armed and torque_of(drive) > 0.49)
        assert seen and drive.stats.bad_crc == drive.stats.unknown == 0
        frames = list(iter(lambda: tap.recv(0), None))
        assert all(frame.is_fd for frame in frames) and max(len(frame.data) for frame in frames) > 8
        settle(lambda: drive.poll() is not None and moteus.far.torque_nm == 0.0)  # asking does not feed it
        assert moteus.far.mode == 11
    assert moteus.far.mode in (0, 11)


def test_a_moteus_and_an_odrive_on_one_bus_hear_their_own_frames_only(moteus: Served, odrive: Served) -> None:
    with open_drive("moteus", moteus.wiring) as first, open_drive("odrive", odrive.wiring) as second:
        first.open(PATIENCE_S)
        second.open(PATIENCE_S)
        second.arm(WATCHDOG_MS)
        drive_until(second, 0.25, lambda: second.armed and torque_of(second) > 0.24)
        assert moteus.far.torque_nm == 0.0
        first.arm(WATCHDOG_MS)
        drive_until(first, -0.5, lambda: first.armed and torque_of(first) < -0.49)
        assert first.stats.bad_crc == second.stats.bad_crc == first.stats.unknown == second.stats.unknown == 0


def test_a_moteus_that_is_not_there_is_said_with_what_to_check(moteus: Served) -> None:
    wiring = Wiring(can=VCAN, node=9, gear_ratio=50.0, turns=50.0)
    with pytest.raises(DeviceAbsent, match=r"moteus 9: no answer .*check \[devices.controller\] node"):
        open_drive("moteus", wiring).open(1.0)
