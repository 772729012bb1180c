"""The controller's driver: handshake, bytes it sends, and that every way out stops the motor."""

from dataclasses import replace

import numpy as np
import pytest

from drivers import DeviceAbsent, DriverError, Hello, LegController, LinkLost, Pong, State, Telemetry
from drivers.errors import DeviceBusy, DeviceFault, ProtocolMismatch
from drivers.mock import EmulatorLink, FirmwareSettings, MockRig, VirtualClock
from drivers.protocol import DriveLimits, Fault, Feature, TimedCommand, TorqueCommand, encode
from drivers.serial_link import SerialLink
from tests.support.still_plant import StillPlant

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


class Bench:
    """Controller, link, emulator on a virtual clock."""

    def __init__(self, **settings) -> None:
        self.clock = VirtualClock()
        self.rig = MockRig(StillPlant(), self.clock, firmware=FirmwareSettings(**settings))
        self.link = EmulatorLink(self.rig.firmware, self.clock)
        self.controller = LegController(self.link, self.clock.now_ns)

    def run(self, seconds: float, torque: float | None = None) -> list:
        end, out = self.clock.now_ns() + seconds * 1e9, []
        while self.clock.now_ns() < end:
            out += self.controller.poll()
            if torque is not None:
                self.controller.command(torque)
        return out

    def acting_after(self, seconds: float) -> np.ndarray:
        """Acting torque from `seconds` from now on, after half a second alone."""
        start = self.clock.now_ns() + seconds * 1e9
        self.clock.sleep(0.5)
        self.rig.advance_to(self.clock.now_ns())
        t_ns, _, acting = self.rig.firmware.record
        return np.abs(acting[t_ns > start])


@pytest.fixture
def driven() -> Bench:
    """Armed and pushing."""
    bench = Bench()
    bench.controller.open()
    bench.controller.arm(100)
    bench.run(0.1, 0.5)
    assert bench.rig.firmware.drive.state == State.ARMED
    assert bench.rig.firmware.record[2][-1] == pytest.approx(0.5, abs=1e-3)
    return bench


def test_bytes_of_the_handshake() -> None:
    link = ScriptLink(b"", HELLO)
    hello = LegController(link, link.now_ns).open(1.0)
    assert hello == Hello(1, 0x1234ABCD, 500, 50.0, 2.0, 1000)
    assert link.written == [STOP, HELLO_REQUEST]


def test_bytes_of_arming_and_of_closing() -> None:
    link = ScriptLink(HELLO)
    controller = LegController(link, link.now_ns)
    controller.open(1.0)
    controller.arm(100)
    controller.close()
    controller.close()
    assert link.written[2:] == [LIMITS_REQUEST, ARM_100, STOP]
    assert link.closed == 1


def test_no_answer_is_absence_and_stops() -> None:
    link = ScriptLink(b"\x81\x99\x00")
    with pytest.raises(DeviceAbsent, match=r"no answer within 0.5 s \(3 bytes came"):
        LegController(link, link.now_ns).open(0.5)
    assert link.written[-1] == STOP
    assert link.written.count(HELLO_REQUEST) >= 3
    assert link.closed == 1


def test_another_version_is_refused_and_stops() -> None:
    bench = Bench(version=2)
    with pytest.raises(ProtocolMismatch, match="version 2, this program version 1"):
        bench.controller.open()
    with pytest.raises(LinkLost):
        bench.link.read()


def test_another_version_during_a_run_is_refused() -> None:
    bench = Bench()
    hello = bench.controller.open()
    bench.link.read = lambda: encode(replace(hello, version=2))
    with pytest.raises(ProtocolMismatch, match="version 2, this program version 1"):
        bench.controller.poll()
    assert bench.controller.hello == hello


def test_telemetry_arrives_whole_and_stamped() -> None:
    bench = Bench()
    bench.controller.open()
    received = bench.run(1.0)
    frames = [r for r in received if isinstance(r.message, Telemetry)]
    assert len(frames) == pytest.approx(500, abs=3)
    ticks = np.array([r.message.tick_us for r in frames])
    assert (np.diff(ticks) == 2000).all()
    delay_us = np.array([r.host_ns for r in frames]) / 1e3 - ticks / (1 + 40e-6)
    assert np.ptp(delay_us) < 3000  # cable jitter, physics step
    assert bench.controller.stats.lost == bench.controller.stats.bad_crc == 0


def test_ping_brackets_the_ticks() -> None:
    bench = Bench(clock_error_ppm=0.0)
    start = bench.clock.now_ns()
    bench.controller.open()
    for _ in range(20):
        ping_id, tx_ns = bench.controller.ping()
        pongs = [r for r in bench.run(0.01) if isinstance(r.message, Pong)]
        assert [r.message.ping_id for r in pongs] == [ping_id]
        pong, rx_ns, _ = pongs[0]
        assert tx_ns < start + pong.rx_tick_us * 1000 + 1000 < start + pong.tx_tick_us * 1000 + 2000 < rx_ns + 2000
        assert rx_ns - tx_ns < 3_000_000


def leave_by_close(bench: Bench) -> None:
    bench.controller.close()


def leave_by_exception(bench: Bench) -> None:
    with pytest.raises(RuntimeError), bench.controller:
        raise RuntimeError


def leave_by_bad_command(bench: Bench) -> None:
    with pytest.raises(DriverError, match=r"2\.5 N m is beyond the firmware's limit of 2 N m"):
        bench.controller.command(2.5)


def leave_by_nan(bench: Bench) -> None:
    with pytest.raises(DriverError, match="nan"):
        bench.controller.command(float("nan"))


@pytest.mark.parametrize("leave", [leave_by_close, leave_by_exception, leave_by_bad_command, leave_by_nan])
def test_every_way_out_stops_the_motor(driven: Bench, leave) -> None:
    leave(driven)
    assert driven.acting_after(0.02).max() < 1e-6
    assert driven.rig.firmware.drive.state == State.DISARMED


def test_commands_that_lay_in_a_buffer_move_nothing(driven: Bench) -> None:
    """A hub that holds everything back for 5 s, then hands it over at once, in order."""
    held: list[bytes] = []
    write, driven.link.write = driven.link.write, held.append  # type: ignore[assignment]
    driven.run(0.03, 1.0)
    driven.clock.sleep(5.0)
    driven.rig.advance_to(driven.clock.now_ns())
    assert driven.rig.firmware.drive.latched == Fault.WATCHDOG
    driven.link.write = write
    driven.controller.clear_faults()
    driven.run(0.01)
    driven.controller.arm(100)  # before what was held back comes
    for data in held:
        driven.link.write(data)
    driven.controller.telemetry = None
    driven.run(0.05)
    assert len(held) > 10 and driven.rig.firmware.drive.late >= len(held)
    assert driven.controller.armed and driven.rig.firmware.drive.torque_nm == 0.0


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
    driven.run(0.2)  # nobody feeds the watchdog
    with pytest.raises(DeviceFault, match=r"watchdog; .*; then legid doctor --clear-faults"):
        driven.controller.arm(100)
    driven.controller.clear_faults()
    driven.run(0.05)
    driven.controller.arm(100)
    driven.run(0.05, 0.1)
    assert driven.controller.armed


@pytest.mark.parametrize("watchdog_ms", [4, 1001])
def test_watchdog_time_outside_the_protocol_is_refused(watchdog_ms: int) -> None:
    bench = Bench()
    bench.controller.open()
    with pytest.raises(ValueError, match="outside 5 to 1000 ms"):
        bench.controller.arm(watchdog_ms)


def test_a_reboot_is_seen(driven: Bench) -> None:
    boot_id = driven.controller.hello.boot_id
    driven.rig.firmware.reboot()
    driven.run(0.1)
    assert driven.controller.hello.boot_id != boot_id
    assert driven.controller.stats.reboots == 1
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
