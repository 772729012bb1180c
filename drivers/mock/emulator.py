"""The leg controller's firmware, emulated: the frames of firmware_protocol.md in, frames out, time in between.

Nothing in here knows a port or the driver's objects; `PtyServer`, `CanServer` and `EmulatorLink` carry the chunks.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.link import Codec
from drivers.mock.drive_state import DriveState
from drivers.mock.motor import Motor
from drivers.mock.plant import Segment, Snapshot
from drivers.mock.settings import FirmwareSettings
from drivers.protocol import (
    ESTOP_OPEN,
    Arm,
    ClearFaults,
    Decoder,
    DriveLimits,
    Fault,
    FaultReport,
    Feature,
    Heartbeat,
    Hello,
    HelloRequest,
    LimitsRequest,
    Message,
    Ping,
    Pong,
    Reaction,
    Stop,
    Telemetry,
    TimedCommand,
    TorqueCommand,
)

TURNAROUND_US = 20
HELLO_EVERY_US = 1_000_000
BEAT_EVERY_US = 100_000
LARGEST_VALUE = (2**31 - 1) * 1e-6
"""What a FaultReport can say; more is sent as invalid."""


class FirmwareEmulator:
    """One controller. `advance(t_ns)` brings the world up to a time before anything goes out.

    `codec` makes the framing of one boot: serial by default.
    """

    def __init__(self, settings: FirmwareSettings | None = None, seed: int = 0, t_ns: int = 0,
                 advance: Callable[[int], None] = lambda t_ns: None, lock: threading.RLock | None = None,
                 codec: Callable[[], Codec[Any]] = Decoder) -> None:
        self.settings = settings or FirmwareSettings()
        self.motor = Motor(self.settings.current_loop_s)
        self.knee_encoder_ok = self.pivot_hall_ok = self.knee_hall_ok = True
        """Set to False: the reading carries the invalid sentinel (and the knee's faults latch)."""
        self.gate_driver_ok = self.current_ok = True
        self.estop_open = False
        """The E-stop is pressed."""
        self.says: Callable[[Telemetry], Telemetry | None] = lambda truth: truth
        """What the telemetry says instead of the truth, None: nothing. The drive itself is not changed."""
        self.bus_v = self.settings.bus_v
        self.motor_degc = self.settings.ambient_degc
        self._rng = np.random.default_rng(seed)
        self._advance, self._lock = advance, lock or threading.RLock()
        self._new_codec = codec
        self._inbox: deque[tuple[int, Any]] = deque()
        self._outbox: deque[tuple[int, Any]] = deque()
        self._t_ns = self._now_ns = t_ns
        self._state = Snapshot()
        self._boot(t_ns)

    def _boot(self, t_ns: int) -> None:
        s = self.settings
        self.boot_id = int(self._rng.integers(1, 2**32))
        self.drive = DriveState(s, self._report)
        self.codec = self._new_codec()
        self._boot_ns = t_ns
        self._frames = 0
        self._mean_from = (float(t_ns), self.motor.impulse_nms)
        self._period_us = round(1e6 / s.telemetry_hz)
        self._due_ns = self._host_ns(self._period_us)
        self._hello_us, self._beat_us = HELLO_EVERY_US, BEAT_EVERY_US
        self._send(self._hello())

    # -- chunks --------------------------------------------------------------------------------------------

    def receive(self, data: Any, t_ns: int) -> None:
        """A chunk that is there now; its last byte came in at `t_ns`."""
        with self._lock:
            for message in self.codec.feed(data):
                self._obey(message, t_ns)

    def post(self, data: Any, t_ns: int) -> None:
        """A chunk under way that will be there at `t_ns`; to be posted in the order of arrival."""
        with self._lock:
            self._inbox.append((t_ns, data))

    def _take_in(self, until_ns: int) -> None:
        while self._inbox and self._inbox[0][0] <= until_ns:
            t_ns, data = self._inbox.popleft()
            self.receive(data, t_ns)

    def transmit(self, until_ns: int) -> list[tuple[int, Any]]:
        """(time, chunk) of what left the controller up to `until_ns`, in order; each is handed out once."""
        with self._lock:
            self._advance(until_ns)
            self._take_in(until_ns)
            frames = []
            while self._outbox and self._outbox[0][0] <= until_ns:
                frames.append(self._outbox.popleft())
        return frames

    def _obey(self, message: Message, t_ns: int) -> None:
        self._now_ns = t_ns
        if isinstance(message, TorqueCommand):
            self.drive.command(message.seq, message.torque_nm, t_ns)
        elif isinstance(message, TimedCommand):
            age_us = (self._frames - 1 - message.seen_seq) % 65536 * self._period_us
            self.drive.command(message.seq, message.torque_nm, t_ns, age_us * 1000)
        elif isinstance(message, Arm):
            self.drive.arm(message.watchdog_ms, t_ns, self.estop_open)
        elif isinstance(message, Stop):
            self.drive.stop()
        elif isinstance(message, ClearFaults):
            self.drive.clear(self._present())
        elif isinstance(message, HelloRequest):
            self._send(self._hello())
        elif isinstance(message, LimitsRequest):
            s = self.settings
            self._send(DriveLimits(int(Feature.TIMED_COMMANDS | Feature.ESTOP_INPUT), int(s.reaction),
                                   s.speed_limit_radps, s.position_min_rad, s.position_max_rad))
        elif isinstance(message, Ping):
            rx = self.tick_us(t_ns)
            self._outbox.append((t_ns + TURNAROUND_US * 1000,
                                 self.codec.encode(Pong(message.ping_id, rx, (rx + TURNAROUND_US) % 2**32))))

    def _send(self, message: Message, t_ns: int | None = None) -> None:
        self._outbox.append((self._t_ns if t_ns is None else t_ns, self.codec.encode(message)))

    def _hello(self) -> Hello:
        s = self.settings
        return Hello(s.version, self.boot_id, s.telemetry_hz, s.gear_ratio, s.torque_limit_nm, s.watchdog_limit_ms)

    def _report(self, fault: Fault, value: float) -> None:
        shown = value if abs(value) <= LARGEST_VALUE else math.nan
        self._send(FaultReport(self.tick_us(self._now_ns), int(fault), int(self.drive.latched), shown))

    # -- time ----------------------------------------------------------------------------------------------

    def tick_us(self, t_ns: float) -> int:
        """MCU clock at a host time."""
        return int(self.settings.first_tick_us + self._local_us(t_ns)) % 2**32

    def _local_us(self, t_ns: float) -> float:
        """MCU time since boot [us]."""
        return (t_ns - self._boot_ns) * 1e-3 * (1 + self.settings.clock_error_ppm * 1e-6)

    def _host_ns(self, local_us: float) -> float:
        return self._boot_ns + local_us * 1e3 / (1 + self.settings.clock_error_ppm * 1e-6)

    def torque_over(self, t0_ns: int, t1_ns: int) -> float:
        """Mean joint torque [N m] in the physics step that follows."""
        self._t_ns = t0_ns
        self._take_in(t0_ns)
        self._now_ns = t0_ns
        self.drive.poll(t0_ns, self.estop_open)
        shorted = self.drive.reaction == Reaction.BRAKE
        torque_nm = -self.settings.brake_nms_per_rad * self._state.q2d if shorted else self.drive.torque_nm
        return self.settings.torque_gain * self.motor.step(t0_ns, (t1_ns - t0_ns) * 1e-9, torque_nm)

    def observe(self, segment: Segment) -> None:
        """Watch the limits and send the telemetry due within the segment; both run at the telemetry's rate."""
        self._t_ns = self._now_ns = segment.t1_ns
        while self._due_ns <= segment.t1_ns:
            self._watch(segment.after)
            said = self.says(self._telemetry(segment, self._due_ns))
            if said is not None:
                self._send(said, round(self._due_ns))
            self._frames += 1
            self._due_ns = self._host_ns((self._frames + 1) * self._period_us)
        if self._local_us(segment.t1_ns) >= self._hello_us:
            self._hello_us += HELLO_EVERY_US
            self._send(self._hello())
        if self.codec.beats and self._local_us(segment.t1_ns) >= self._beat_us:
            self._beat_us += BEAT_EVERY_US
            self._send(Heartbeat(self.boot_id, int(self.drive.state), self._fault_bits()))

    def _fault_bits(self) -> int:
        return int(self.drive.latched) | (ESTOP_OPEN if self.estop_open else 0)

    def reboot(self) -> None:
        """Restart as after a brown-out: new boot id, tick and sequence from the start, torque off, nothing latched."""
        self._boot(self._t_ns)

    # -- sensors -------------------------------------------------------------------------------------------

    @property
    def record(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """(t_ns, torque commanded, torque acting) of every physics step, for tests of safety."""
        return self.motor.record

    def _telemetry(self, segment: Segment, due_ns: float) -> Telemetry:
        s = self.settings
        state = segment.at(due_ns)
        span_s = (segment.t1_ns - due_ns) * 1e-9
        impulse = self.motor.impulse_nms - span_s * self.motor.last_mean_nm
        from_ns, from_impulse = self._mean_from
        mean_nm = (impulse - from_impulse) / ((due_ns - from_ns) * 1e-9)
        self._mean_from = (due_ns, impulse)
        current = mean_nm / s.torque_constant_nm_per_a
        noise = self._rng.standard_normal(3)
        hall_step = 2 * math.pi / s.hall_counts
        return Telemetry(
            seq=self._frames % 65536,
            tick_us=(s.first_tick_us + (self._frames + 1) * self._period_us) % 2**32,
            state=int(self.drive.state), faults=self._fault_bits(),
            knee_rad=self._knee_rad(state),
            pivot_hall_rad=_quantise(state.q1 + s.hall_noise_rad * noise[0], hall_step)
            if self.pivot_hall_ok else math.nan,
            knee_hall_rad=_quantise(state.q2_motor + s.hall_noise_rad * noise[1], hall_step)
            if self.knee_hall_ok else math.nan,
            current_a=current + s.shunt_offset_a + s.current_noise_a * noise[2] if self.current_ok else math.nan,
            bus_v=self.bus_v - s.bus_resistance_ohm * abs(current), motor_degc=self.motor_degc,
            torque_cmd_nm=self.drive.torque_nm)

    def _knee_rad(self, state: Snapshot) -> float:
        """What the knee encoder reads; NaN when it is lost."""
        s = self.settings
        if not self.knee_encoder_ok:
            return math.nan
        return _quantise(state.q2_motor + s.knee_zero_rad, 2 * math.pi / s.encoder_counts)

    def _watch(self, state: Snapshot) -> None:
        """Warm the motor by one period and latch what is beyond its limit."""
        s = self.settings
        current = self.motor.last_mean_nm / s.torque_constant_nm_per_a
        final = s.ambient_degc + s.heating_degc_per_a2 * current**2
        self.motor_degc += (final - self.motor_degc) * self._period_us * 1e-6 / s.heating_time_s
        self._state = state
        self.drive.observe(self._knee_rad(state), state.q2d)
        for fault, value in self._causes():
            self.drive.trip(fault, value, self._now_ns)
        self.drive.apply()

    def _causes(self) -> list[tuple[Fault, float]]:
        """What is beyond its limit; a reading that was not had is beyond every one."""
        s = self.settings
        current = abs(self.motor.last_mean_nm) / s.torque_constant_nm_per_a if self.current_ok else math.nan
        knee = self._knee_rad(self._state)
        checks = [
            (not current <= s.current_limit_a, Fault.OVERCURRENT, current),
            (not self.motor_degc <= s.temperature_limit_degc, Fault.OVERTEMPERATURE, self.motor_degc),
            (not self.bus_v >= s.undervoltage_v, Fault.UNDERVOLTAGE, self.bus_v),
            (self.bus_v > s.overvoltage_v, Fault.OVERVOLTAGE, self.bus_v),
            (not self.knee_encoder_ok, Fault.KNEE_ENCODER, math.nan),
            (not self.knee_hall_ok, Fault.KNEE_HALL, math.nan),
            (not abs(self._state.q2d) <= s.speed_limit_radps, Fault.OVERSPEED, self._state.q2d),
            (not self.gate_driver_ok, Fault.GATE_DRIVER, math.nan),
            (knee < s.position_min_rad or knee > s.position_max_rad, Fault.POSITION_LIMIT, knee),
        ]
        return [(fault, value) for wrong, fault, value in checks if wrong]

    def _present(self) -> Fault:
        causes = Fault.ESTOP if self.estop_open else Fault(0)
        for fault, _ in self._causes():
            causes |= fault
        return causes


def _quantise(value: float, step: float) -> float:
    return math.floor(value / step + 0.5) * step
