"""The firmware emulator against section 8 of firmware_protocol.md, frame by frame."""

import math

import numpy as np
import pytest

from drivers import FaultReport, Hello, Message, Pong, State, Telemetry
from drivers.mock import FirmwareSettings, MockRig, VirtualClock
from drivers.mock.emulator import FirmwareEmulator
from drivers.mock.plant import Segment, Snapshot
from drivers.protocol import Arm, ClearFaults, Decoder, Fault, HelloRequest, Ping, Stop, TorqueCommand, encode
from tests.support.still_plant import StillPlant, StillState

MS = 1_000_000


class Bench:
    """An emulator on a still leg; time is passed by hand."""

    def __init__(self, state: StillState | None = None, **settings) -> None:
        self.clock = VirtualClock(0)
        self.plant = StillPlant(state or StillState())
        self.rig = MockRig(self.plant, self.clock, firmware=FirmwareSettings(**settings))
        self.firmware = self.rig.firmware
        self.decoder = Decoder()

    def send(self, *messages: Message) -> None:
        for message in messages:
            self.firmware.receive(encode(message), self.clock.now_ns())

    def run(self, ms: float) -> list[Message]:
        self.clock.advance(round(ms * MS))
        return self.decoder.feed(b"".join(frame for _, frame in self.firmware.transmit(self.clock.now_ns())))

    def telemetry(self, ms: float = 10) -> Telemetry:
        return [m for m in self.run(ms) if isinstance(m, Telemetry)][-1]

    @property
    def state(self) -> State:
        return self.firmware.drive.state

    @property
    def torque(self) -> float:
        return self.firmware.drive.torque_nm


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def armed(bench: Bench) -> Bench:
    bench.send(Arm(50), TorqueCommand(0, 0.5))
    bench.run(10)
    assert bench.state == State.ARMED
    return bench


def test_cold_start_says_hello_first_and_is_disarmed_and_a_reboot_starts_anew(bench: Bench) -> None:
    boots = []
    for _ in range(2):
        first, second, *_ = bench.run(10)
        assert isinstance(first, Hello) and isinstance(second, Telemetry)
        assert (second.seq, second.state, second.faults, second.torque_cmd_nm) == (0, State.DISARMED, 0, 0.0)
        boots.append(first.boot_id)
        bench.send(Arm(50), TorqueCommand(0, 0.5))
        assert bench.torque == 0.5
        bench.run(10)
        bench.firmware.reboot()
    assert 0 not in boots and boots[0] != boots[1]


def test_torque_stays_zero_while_disarmed_and_no_arm_outside_its_range_is_obeyed(bench: Bench) -> None:
    for seq in range(20):
        bench.send(Arm(0), Arm(4), Arm(1001), TorqueCommand(seq, 1.0), Ping(seq), HelloRequest())
        assert bench.telemetry().torque_cmd_nm == 0.0 and bench.state == State.DISARMED
    _, commanded, acting = bench.firmware.record
    assert not commanded.any() and not acting.any()


def test_armed_obeys_with_the_current_loops_lag(bench: Bench) -> None:
    bench.send(Arm(50), TorqueCommand(0, 0.5))
    bench.run(10)
    t_ns, commanded, acting = bench.firmware.record
    assert (commanded == 0.5).all()
    edges = (t_ns + 500_000) * 1e-9
    tau, a, b = 1e-3, edges - 5e-4, edges
    mean = 0.5 - 0.5 * tau * (np.exp(-a / tau) - np.exp(-b / tau)) / 5e-4  # closed form of a first-order lag
    assert acting == pytest.approx(mean, abs=1e-12)


def test_current_is_the_mean_of_what_acted() -> None:
    bench = Bench(current_noise_a=0.0, torque_constant_nm_per_a=2.0, shunt_offset_a=0.25, clock_error_ppm=0.0)
    bench.send(Arm(50), TorqueCommand(0, 0.5))
    frames = [m for m in bench.run(20) if isinstance(m, Telemetry)]
    acting = bench.firmware.record[2].reshape(-1, 4).mean(axis=1)  # 2 ms of telemetry are 4 physics steps
    assert [m.current_a for m in frames] == pytest.approx(acting / 2.0 + 0.25, abs=1e-6)


def test_watchdog_expires_latches_and_stops(armed: Bench) -> None:
    reports = [m for m in armed.run(45) if isinstance(m, FaultReport)]
    assert [(m.fault, m.latched, m.value) for m in reports] == [(Fault.WATCHDOG, Fault.WATCHDOG, 50.0)]
    assert (armed.state, armed.torque) == (State.FAULT, 0.0)
    t_ns, _, acting = armed.firmware.record
    assert acting[t_ns < 49.5 * MS][-1] == pytest.approx(0.5, abs=1e-3)
    assert armed.telemetry(30).faults == Fault.WATCHDOG
    assert abs(armed.firmware.record[2][-1]) < 1e-9


@pytest.mark.parametrize("message", [Ping(1), HelloRequest(), Arm(50), ClearFaults(), TorqueCommand(0, 0.5), None],
                         ids=lambda m: type(m).__name__)
def test_nothing_but_a_whole_new_torque_command_feeds_the_watchdog(armed: Bench, message: Message | None) -> None:
    """The torque command repeats a sequence number already obeyed; the last frames are new ones, but broken."""
    for seq in range(1, 7):
        frame = bytearray(encode(message or TorqueCommand(seq, 0.5)))
        frame[4] ^= 0 if message else 0x40
        armed.firmware.receive(bytes(frame), armed.clock.now_ns())
        armed.run(10)
    assert armed.state == State.FAULT


def test_new_commands_keep_it_armed_over_the_sequence_wrap(bench: Bench) -> None:
    bench.send(Arm(50))
    for k in range(30):
        bench.send(TorqueCommand((65520 + k) % 65536, 0.1))
        bench.run(10)
    assert (bench.state, bench.torque) == (State.ARMED, 0.1)


def test_late_commands_are_ignored_and_stop_disarms_at_once(armed: Bench) -> None:
    armed.send(TorqueCommand(10, 0.3), TorqueCommand(9, -0.3))
    assert armed.torque == 0.3
    armed.send(Stop())
    assert (armed.state, armed.torque) == (State.DISARMED, 0.0)
    armed.send(TorqueCommand(11, 0.5))
    assert armed.torque == 0.0


def test_faults_leave_only_through_stop_and_clear_and_a_refused_arm_is_reported_again(armed: Bench) -> None:
    armed.run(60)
    refused: list[tuple[Message, ...]] = [(Arm(50),), (ClearFaults(),), (TorqueCommand(5, 0.5),),
                                          (Arm(50), TorqueCommand(6, 0.5))]
    for messages in refused:
        armed.send(*messages)
        reports = [m.fault for m in armed.run(5) if isinstance(m, FaultReport)]
        assert reports == [Fault.WATCHDOG] * (Arm(50) in messages)
        assert (armed.state, armed.torque) == (State.FAULT, 0.0)
    armed.send(Stop())
    assert armed.telemetry().faults == Fault.WATCHDOG
    armed.send(ClearFaults())
    assert (armed.state, armed.telemetry().faults) == (State.DISARMED, 0)
    armed.send(Arm(50), TorqueCommand(0, 0.2))
    assert (armed.state, armed.torque) == (State.ARMED, 0.2)


def test_a_second_fault_needs_a_second_stop(armed: Bench) -> None:
    armed.run(60)
    armed.send(Stop())
    armed.firmware.drive.trip(Fault.GATE_DRIVER)
    armed.send(ClearFaults())
    assert armed.state == State.FAULT
    armed.send(Stop(), ClearFaults())
    assert armed.state == State.DISARMED


def test_sensors_lost_carry_nan_and_the_knees_latch(armed: Bench) -> None:
    armed.firmware.pivot_hall_ok = False
    seen = armed.telemetry()
    assert math.isnan(seen.pivot_hall_rad) and seen.state == State.ARMED
    armed.firmware.knee_encoder_ok = False
    seen = armed.telemetry()
    assert math.isnan(seen.knee_rad) and (seen.state, seen.faults) == (State.FAULT, Fault.KNEE_ENCODER)


def test_angles_are_quantised_and_offset() -> None:
    bench = Bench(StillState(q1=0.3, q2=-0.7), encoder_counts=4096, knee_zero_rad=0.1)
    frames = [m for m in bench.run(1000) if isinstance(m, Telemetry)]
    step = 2 * math.pi / 4096
    assert {m.knee_rad for m in frames} == {round(round(-0.6 / step) * step, 6)}
    hall = np.array([m.pivot_hall_rad for m in frames])
    counts = hall / (2 * math.pi / 1024)
    assert hall.mean() == pytest.approx(0.3, abs=1e-3) and len(set(hall)) > 1
    assert np.abs(counts - np.rint(counts)).max() < 1e-3


def test_the_knee_encoder_sits_on_the_motor(bench: Bench) -> None:
    bench.plant.state = Snapshot(0.0, 0.5, 0.0, 0.0, 0.0, 0.52)  # type: ignore[assignment]
    assert bench.telemetry().knee_rad == pytest.approx(0.52, abs=4e-4)


def test_tick_runs_at_its_own_rate_and_wraps() -> None:
    bench = Bench(first_tick_us=2**32 - 500_000, clock_error_ppm=1000.0)
    frames = [m for m in bench.run(1000) if isinstance(m, Telemetry)]
    ticks = np.array([m.tick_us for m in frames], np.int64)
    assert (np.diff(ticks) % 2**32 == 2000).all()
    assert (np.diff(ticks) < 0).sum() == 1
    assert bench.firmware.tick_us(1_000_000_000) == 501_000
    bench.send(Ping(7))
    pong = next(m for m in bench.run(1) if isinstance(m, Pong))
    assert (pong.ping_id, pong.rx_tick_us, pong.tx_tick_us) == (7, 501_000, 501_020)


def test_noise_on_the_wire_is_survived(armed: Bench) -> None:
    armed.firmware.receive(np.random.default_rng(1).bytes(5000) + b"\0", armed.clock.now_ns())
    armed.send(TorqueCommand(1, 0.25))
    assert armed.torque == 0.25


def test_emulator_stands_alone() -> None:
    firmware = FirmwareEmulator()
    assert firmware.torque_over(0, 500_000) == 0.0
    firmware.observe(Segment(0, 500_000, Snapshot(), Snapshot()))
    assert [type(m) for m in Decoder().feed(firmware.transmit(0)[0][1])] == [Hello]
