"""The emulated controller on a real pseudo-terminal: pyserial, threads and the machine's own clock."""

import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise

import pytest

from drivers import LegController, LinkLost, Lsm9ds1, State, Telemetry
from drivers.errors import DeviceBusy
from drivers.mock import MockRig, PtyServer
from drivers.serial_link import SerialLink
from tests.support.leg_on_a_link import PATIENCE_S, drive, ping, poll_until, settle
from tests.support.processes import REAL_CLOCK
from tests.support.still_plant import StillPlant

pytestmark = REAL_CLOCK


@pytest.fixture
def rig() -> MockRig:
    return MockRig(StillPlant())


@pytest.fixture
def server(rig: MockRig) -> Iterator[PtyServer]:
    with PtyServer(rig.firmware, rig.clock) as server:
        yield server


def test_handshake_telemetry_ping_and_torque_through_pyserial(rig: MockRig, server: PtyServer) -> None:
    with LegController(SerialLink(server.path), rig.clock.now_ns) as controller:
        drive(controller, rig)
        ping(controller, rig)
        controller.command(0.5)
        frames = [m for m, *_ in poll_until(controller, lambda r: len(r) >= 100) if isinstance(m, Telemetry)]
        assert all((b.seq - a.seq) % 65536 == 1 for a, b in pairwise(frames))
        assert controller.stats.bad_crc == controller.stats.bad_length == controller.stats.lost == 0
    settle(lambda: rig.firmware.drive.state in (State.DISARMED, State.FAULT))
    assert rig.firmware.drive.torque_nm == 0.0


class Busy:
    """A device that is long over its turn, as on a machine that has other work."""

    def __init__(self) -> None:
        self.heard, self.entered, self.go_on = b"", threading.Event(), threading.Event()

    def receive(self, data: bytes, t_ns: int) -> None:
        self.heard += data

    def post(self, data: bytes, t_ns: int) -> None:
        raise NotImplementedError

    def transmit(self, until_ns: int) -> list[tuple[int, bytes]]:
        self.entered.set()
        self.go_on.wait(PATIENCE_S)
        return []


def test_what_was_sent_before_the_plug_was_pulled_arrives() -> None:
    device = Busy()
    server = PtyServer(device)
    link = SerialLink(server.path)
    assert device.entered.wait(PATIENCE_S)
    link.write(b"stop")
    link.close()
    pulled = threading.Thread(target=server.close)
    pulled.start()
    while server._running:
        time.sleep(0.001)
    device.go_on.set()
    pulled.join()
    assert device.heard == b"stop"


def test_a_host_that_goes_on_writing_does_not_keep_the_plug_in() -> None:
    device = Busy()
    device.go_on.set()
    server = PtyServer(device)
    link, over = SerialLink(server.path), threading.Event()

    def write() -> None:
        with suppress(LinkLost):
            while not over.wait(0.001):
                link.write(b"torque")

    host = threading.Thread(target=write)
    host.start()
    pulled = threading.Thread(target=server.close, daemon=True)
    pulled.start()
    pulled.join(PATIENCE_S)
    out = not pulled.is_alive()
    over.set()
    host.join()
    link.close()
    assert out


def test_a_pty_says_that_it_has_no_low_latency_mode_is_busy_while_in_use_and_lost_once_closed(server: PtyServer
                                                                                              ) -> None:
    link = SerialLink(server.path)
    assert link.low_latency is False and link.latency_timer_ms is None
    with pytest.raises(DeviceBusy, match="another program holds the port"):
        SerialLink(server.path)
    link.close()
    link.close()
    for use in (link.read, lambda: link.write(b"\0")):
        with pytest.raises(LinkLost):
            use()


def test_a_port_can_be_opened_again_and_old_bytes_are_gone(server: PtyServer) -> None:
    for _ in range(2):
        with LegController(SerialLink(server.path)) as controller:
            controller.open()
            time.sleep(0.05)
            assert controller.stats.bad_length == 0


def test_unplugged_mid_run_is_link_lost(rig: MockRig) -> None:
    server = PtyServer(rig.firmware, rig.clock)
    controller = LegController(SerialLink(server.path))
    controller.open()
    server.close()
    with pytest.raises(LinkLost, match=r"connection is gone.*check cable"):
        poll_until(controller, lambda r: False)
    with pytest.raises(LinkLost):
        controller.command(0.1)
    controller.close()


def test_both_devices_share_one_time_line(rig: MockRig, server: PtyServer) -> None:
    imu = Lsm9ds1(rig.imu, now_ns=rig.clock.now_ns, sleep=rig.clock.sleep)
    with LegController(SerialLink(server.path)) as controller:
        controller.open()
        imu.open()
        samples, start = 0, time.monotonic()
        while time.monotonic() - start < 0.3:
            samples += len(imu.drain().raw)
            controller.poll()
        assert samples > 10
        assert rig.t_ns <= rig.clock.now_ns() + 1_000_000
