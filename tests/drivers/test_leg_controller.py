"""The controller's driver: handshake, bytes it sends, and that every way out stops the motor."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers import DeviceAbsent, DriverError, Hello, LegController, LinkLost, Pong, State, Telemetry
from drivers.errors import DeviceBusy, DeviceFault, ProtocolMismatch
from drivers.mock import FirmwareSettings
from drivers.protocol import DriveLimits, Fault, Feature, TimedCommand, TorqueCommand, encode
from drivers.serial_link import SerialLink
from tests.support.virtual_rig import VirtualRig

STOP = bytes.fromhex("00 04 03 93 D1 00")  # firmware_protocol.md, section 9, behind a delimiter
ARM_100 = bytes.fromhex("03 02 64 03 12 65 00")
LIMITS_REQUEST = bytes.fromhex("04 08 F8 60 00")
HELLO_REQUEST = bytes.fromhex("04 05 55 B1 00")
HELLO = bytes.fromhex("03 82 01 09 CD AB 34 12 F4 01 50 C3 01 04 80 84 1E 05 E8 03 79 48 00")


TELEMETRY = Telemetry(77, 0, 1, 0, 0.0, 0.0, 0.0, 0.0, 24.0, 30.5, 0.0)


class ScriptLink:
    """A link that answers from a list and keeps what was written."""

    def __init__(self, *answers: bytes) -> None:
        self.answers = list(answers)
        self.written: list[bytes] = []
        self.closed = 0
        self.time = 0

    def now_ns(self) -> int:
        self.time += 1_000_000
        return self.time

    def read(self) -> bytes:
        return self.answers.pop(0) if self.answers else b""

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        self.closed += 1


class Bench(VirtualRig):
    """Its firmware and controller."""

    def __init__(self, **settings) -> None:
        super().__init__(firmware=FirmwareSettings(**settings))

    def acting_after(self, seconds: float) -> np.ndarray:
        """Acting torque from `seconds` from now on, after half a second alone."""
        start = self.clock.now_ns() + seconds * 1e9
        self.clock.sleep(0.5)
        self.mock.advance_to(self.clock.now_ns())
        t_ns, _, acting = self.firmware.record
        return np.abs(acting[t_ns > start])


@pytest.fixture
def opened() -> Bench:
    bench = Bench()
    bench.controller.open()
    return bench


@pytest.fixture
def driven(opened: Bench) -> Bench:
    """Armed and pushing."""
    opened.controller.arm(100)
    opened.poll_for(0.1, 0.5)
    assert opened.firmware.drive.state == State.ARMED
    assert opened.firmware.record[2][-1] == pytest.approx(0.5, abs=1e-3)
    return opened


def test_bytes_of_the_handshake_of_arming_and_of_closing() -> None:
    link = ScriptLink(b"", HELLO)
    controller = LegController(link, link.now_ns)
    assert controller.open(1.0) == Hello(1, 0x1234ABCD, 500, 50.0, 2.0, 1000)
    assert link.written == [STOP, HELLO_REQUEST]
    controller.arm(100)
    controller.close()
    controller.close()
    assert link.written[2:] == [LIMITS_REQUEST, ARM_100, STOP] and link.closed == 1


def test_no_answer_is_absence_and_stops() -> None:
    link = ScriptLink(b"\x81\x99\x00")
    with pytest.raises(DeviceAbsent, match=r"no answer within 0.5 s \(3 bytes came"):
        LegController(link, link.now_ns).open(0.5)
    assert link.written[-1] == STOP and link.written.count(HELLO_REQUEST) >= 3 and link.closed == 1


def test_another_version_is_refused_and_stops() -> None:
    bench = Bench(version=2)
    with pytest.raises(ProtocolMismatch, match="version 2, this program version 1"):
        bench.controller.open()
    with pytest.raises(LinkLost):
        bench.link.read()


def test_another_version_during_a_run_is_refused(opened: Bench) -> None:
    hello: Any = opened.controller.hello
    opened.link.read = lambda: encode(replace(hello, version=2))
    with pytest.raises(ProtocolMismatch, match="version 2, this program version 1"):
        opened.controller.poll()
    assert opened.controller.hello == hello


def test_telemetry_arrives_whole_and_stamped(opened: Bench) -> None:
    frames = [r for r in opened.poll_for(1.0) if isinstance(r.message, Telemetry)]
    assert len(frames) == pytest.approx(500, abs=3)
    ticks = np.array([r.message.tick_us for r in frames])
    assert (np.diff(ticks) == 2000).all()
    delay_us = np.array([r.host_ns for r in frames]) / 1e3 - ticks / (1 + 40e-6)
    assert np.ptp(delay_us) < 3000  # cable jitter, physics step
    assert opened.controller.stats.lost == opened.controller.stats.bad_crc == 0


def test_ping_brackets_the_ticks() -> None:
    bench = Bench(clock_error_ppm=0.0)
    start = bench.clock.now_ns()
    bench.controller.open()
    for _ in range(20):
        ping_id, tx_ns = bench.controller.ping()
        pongs = [r for r in bench.poll_for(0.01) if isinstance(r.message, Pong)]
        assert [r.message.ping_id for r in pongs] == [ping_id]
        pong, rx_ns, _ = pongs[0]
        assert tx_ns < start + pong.rx_tick_us * 1000 + 1000 < start + pong.tx_tick_us * 1000 + 2000 < rx_ns + 2000
        assert rx_ns - tx_ns < 3_000_000


def raise_within(bench: Bench) -> None:
    with bench.controller:
        raise RuntimeError


@pytest.mark.parametrize("leave, error", [
    (lambda bench: bench.controller.close(), nullcontext()), (raise_within, pytest.raises(RuntimeError)),
    (lambda bench: bench.controller.command(2.5),
     pytest.raises(DriverError, match=r"2\.5 N m is beyond the firmware's limit of 2 N m")),
    (lambda bench: bench.controller.command(float("nan")), pytest.raises(DriverError, match="nan"))])
def test_every_way_out_stops_the_motor(driven: Bench, leave: Callable[[Bench], None],
                                       error: AbstractContextManager) -> None:
    with error:
        leave(driven)
    assert driven.acting_after(0.02).max() < 1e-6
    assert driven.firmware.drive.state == State.DISARMED


def test_commands_that_lay_in_a_buffer_move_nothing(driven: Bench) -> None:
    """A hub that holds everything back for 5 s, then hands it over at once, in order."""
    held: list[bytes] = []
    write, driven.link.write = driven.link.write, held.append  # type: ignore[assignment]
    driven.poll_for(0.03, 1.0)
    driven.clock.sleep(5.0)
    driven.mock.advance_to(driven.clock.now_ns())
    drive = driven.firmware.drive
    assert drive.latched == Fault.WATCHDOG
    driven.link.write = write
    driven.controller.clear_faults()
    driven.poll_for(0.01)
    driven.controller.arm(100)  # before what was held back comes
    for data in held:
        driven.link.write(data)
    driven.controller.telemetry = None
    driven.poll_for(0.05)
    assert len(held) > 10 and drive.late >= len(held)
    assert driven.controller.armed and drive.torque_nm == 0.0


def test_firmware_that_does_not_know_timed_commands_gets_plain_ones() -> None:
    link = ScriptLink(HELLO, encode(TELEMETRY))
    controller = LegController(link, link.now_ns)
    controller.open(1.0)
    controller.poll()
    controller.command(0.25)
    link.answers.append(encode(DriveLimits(int(Feature.TIMED_COMMANDS), 0, 40.0, -1.0, 1.0)))
    controller.poll()
    controller.command(0.25)
    assert link.written[2:] == [encode(TorqueCommand(0, 0.25)), encode(TimedCommand(1, 0.25, 77))]


def test_arming_over_a_latched_fault_is_refused_by_name(driven: Bench) -> None:
    driven.poll_for(0.2)  # nobody feeds the watchdog
    with pytest.raises(DeviceFault, match=r"watchdog; .*; then legid doctor --clear-faults"):
        driven.controller.arm(100)
    driven.controller.clear_faults()
    driven.poll_for(0.05)
    driven.controller.arm(100)
    driven.poll_for(0.05, 0.1)
    assert driven.controller.armed


@pytest.mark.parametrize("watchdog_ms", [4, 1001])
def test_watchdog_time_outside_the_protocol_is_refused(opened: Bench, watchdog_ms: int) -> None:
    with pytest.raises(ValueError, match="outside 5 to 1000 ms"):
        opened.controller.arm(watchdog_ms)


def test_a_reboot_is_seen(driven: Bench) -> None:
    boot_id = driven.controller.hello.boot_id
    driven.firmware.reboot()
    driven.poll_for(0.1)
    assert driven.controller.hello.boot_id != boot_id and driven.controller.stats.reboots == 1
    assert not driven.controller.armed


@pytest.mark.parametrize("port, words", [("missing", "no such port"), ("file", "cannot be opened as a serial")])
def test_ports_that_are_none_are_said_in_words(tmp_path, port: str, words: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceAbsent, match=words) as error:
        SerialLink(str(tmp_path / port))
    assert "\n" not in str(error.value)


def test_errors_are_a_tree() -> None:
    assert all(issubclass(kind, DriverError)
               for kind in (DeviceAbsent, DeviceBusy, DeviceFault, LinkLost, ProtocolMismatch))
