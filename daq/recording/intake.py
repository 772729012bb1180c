"""Pull, stamp, write: what comes in from the two devices, and what the supervisor sees of it."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.recording.tick_watch import TickWatch
from daq.rig import Calibration
from daq.si_units import imu_columns, joint_torque, knee_angle
from drivers import (
    Drive,
    DriverError,
    FaultReport,
    Hello,
    Lsm9ds1,
    Pong,
    Received,
    Telemetry,
    describe_faults,
    hello_of,
    lsm9ds1_registers,
)

SPEED_WINDOW_US = 20_000
TRIPS_KEPT_NS = 10_000_000_000
IMPOSSIBLE_TRIP_NS = 1_000_000
"""A round trip is shorter than nothing by the ticks' rounding at most, not by this much."""
_KEPT = 64
WAITS_KEPT = 50
FRESH = 2048
"""More than two seconds of the fastest telemetry: who is that late has stopped long ago."""
GRAVITY_S = 0.5
"""Time in which gravity draws the angle that the gyro adds up."""
NEAR_GRAVITY = 0.1
"""Within this share of gravity the accelerometer shows which way is down."""


class Batch(NamedTuple):
    """IMU samples that nobody has looked through yet."""

    raw: NDArray[np.int16]
    """(n, 6) LSB"""
    turned_rad: float
    """What the gyro adds up to since the recording began."""
    host_ns: int
    gap: bool


class Sink(Protocol):
    """Destination of messages: a `RunWriter`, or one behind a thread."""

    def add(self, topic: str, host_ns: int, *values: float, sequence: int = 0) -> None: ...
    def event(self, host_ns: int, kind: str, text: str) -> None: ...
    def config(self, host_ns: int, kind: str, text: str) -> None: ...


class ControllerIntake:
    """Telemetry and clock probes of the leg controller. `poll` belongs to one thread, `ping` may be another's.

    A drive that is polled keeps no time: each of its samples is a clock probe of its own.
    """

    def __init__(self, controller: Drive, sink: Sink, calibration: Calibration,
                 now_ns: Callable[[], int]) -> None:
        self.hello = hello_of(controller)
        """Its value when the recording began."""
        self.boot_id = self.first_boot_id = self.hello.boot_id
        self.heard_ns = now_ns()
        """Host time of the last telemetry. Heartbeats and answers do not count: they say nothing of the leg."""
        self.telemetry: Telemetry | None = None
        """The newest of this recording."""
        self.fresh: deque[tuple[Telemetry, int]] = deque(maxlen=FRESH)
        """Telemetry with its host time [ns] that nobody has looked through yet, oldest first."""
        self._controller, self._sink, self._calibration = controller, sink, calibration
        self._lock = threading.Lock()
        self._pings: dict[int, int] = {}
        self._trips: deque[tuple[int, int]] = deque()
        self._shortest_ns: int | None = None
        self._polled = controller.capabilities.polled
        self._waits: deque[int] = deque(maxlen=WAITS_KEPT)
        self._knee: deque[tuple[int, float]] = deque(maxlen=_KEPT)
        self._ticks = TickWatch(self.hello.telemetry_hz)
        self.clock_faults = 0
        """Events of the controller's clock."""

    def poll(self) -> None:
        """One read of the link, everything in it stamped and written. Raises `LinkLost`."""
        for received in self._controller.poll():
            message = received.message
            if isinstance(message, Telemetry):
                self.heard_ns = received.host_ns
                self._on_telemetry(message, received.host_ns)
                if received.asked_ns is not None:
                    self._on_answer(message, received.asked_ns, received.host_ns)
            elif isinstance(message, Pong):
                self._on_pong(message, received)
            elif isinstance(message, Hello):
                self._on_hello(message, received.host_ns)
            elif isinstance(message, FaultReport):
                what = f"{describe_faults(message.fault)}, value {message.value:g}"
                self._sink.event(received.host_ns, "fault", what)

    def ping(self) -> None:
        """Send a clock probe. The lock is held meanwhile, so that the answer cannot overtake its entry."""
        with self._lock:
            sent = self._controller.ping()
            if sent is None:
                return
            ping_id, host_tx_ns = sent
            self._pings[ping_id] = host_tx_ns
            for old in [k for k, sent in self._pings.items() if host_tx_ns - sent > TRIPS_KEPT_NS]:
                del self._pings[old]

    def clock_bound_s(self) -> float | None:
        """Half of the shortest round trip of the last ten seconds [s]; None before the first answer.

        Infinite where an answer's ticks precede its question's: such a clock gives no bound. For a polled drive: half
        of the median wait for the last answers.
        """
        with self._lock:
            if self._polled:
                return 0.5e-9 * sorted(self._waits)[len(self._waits) // 2] if self._waits else None
        if self._shortest_ns is None:
            return None
        return 0.5e-9 * self._shortest_ns if self._shortest_ns > -IMPOSSIBLE_TRIP_NS else math.inf

    def knee(self) -> tuple[float, float | None] | None:
        """(angle [rad], speed [rad/s]) from the newest telemetry, the speed over the last 20 ms; None before any."""
        with self._lock:
            recent = list(self._knee)
        if not recent:
            return None
        (tick, angle), speed = recent[-1], None
        for old_tick, old_angle in reversed(recent):
            elapsed = (tick - old_tick) % 2**32
            if elapsed >= SPEED_WINDOW_US:
                speed = (angle - old_angle) / (elapsed * 1e-6)
                break
        return angle, speed

    def torque_nm(self) -> float | None:
        """Measured knee torque [N m]; None before any telemetry."""
        if self.telemetry is None:
            return None
        return joint_torque(self.telemetry.current_a, self._calibration)

    def _on_telemetry(self, t: Telemetry, host_ns: int) -> None:
        self.telemetry = t
        if not self._polled:
            self._clock_event(self._ticks.frame(t, host_ns), host_ns)
        self.fresh.append((t, host_ns))
        with self._lock:
            self._knee.append((t.tick_us, knee_angle(t.knee_rad, self._calibration)))
        self._sink.add("/leg/telemetry", host_ns, host_ns, t.knee_rad, t.pivot_hall_rad, t.knee_hall_rad,
                       t.current_a, t.bus_v, t.motor_degc, t.torque_cmd_nm, t.tick_us, self.boot_id, t.seq,
                       t.faults, t.state, sequence=t.seq)

    def _on_answer(self, t: Telemetry, asked_ns: int, host_ns: int) -> None:
        """A sample taken between these two times, whose tick is the middle."""
        with self._lock:
            self._waits.append(host_ns - asked_ns)
        self._sink.add("/leg/clock", host_ns, asked_ns, host_ns, t.tick_us, t.tick_us, self.boot_id, t.seq,
                       sequence=t.seq)

    def _on_pong(self, pong: Pong, received: Received) -> None:
        host_rx_ns = received.host_ns
        with self._lock:
            host_tx_ns = self._pings.pop(pong.ping_id, None)
            if host_tx_ns is None:
                return
            turnaround_ns = (pong.tx_tick_us - pong.rx_tick_us) % 2**32 * 1000
            self._trips.append((host_rx_ns, host_rx_ns - host_tx_ns - turnaround_ns))
            while host_rx_ns - self._trips[0][0] > TRIPS_KEPT_NS:
                self._trips.popleft()
            self._shortest_ns = min(trip for _, trip in self._trips)
        self._clock_event(self._ticks.probe(host_tx_ns, host_rx_ns, pong.rx_tick_us, pong.tx_tick_us), host_rx_ns)
        self._sink.add("/leg/clock", host_rx_ns, host_tx_ns, host_rx_ns, pong.rx_tick_us, pong.tx_tick_us,
                       self.boot_id, pong.ping_id, sequence=pong.ping_id)

    def _clock_event(self, what: str, host_ns: int) -> None:
        if what:
            self.clock_faults += 1
            self._sink.event(host_ns, "clock", what)

    def _on_hello(self, hello: Hello, host_ns: int) -> None:
        if hello.boot_id == self.boot_id:
            return
        self.boot_id = hello.boot_id
        self._ticks.restart()
        with self._lock:
            self._knee.clear()
            self._pings.clear()
        self._sink.event(host_ns, "reboot", f"leg controller restarted, boot {hello.boot_id}")


class ImuIntake:
    """Samples of the IMU. `drain` belongs to one thread."""

    def __init__(self, imu: Lsm9ds1, sink: Sink, calibration: Calibration, now_ns: Callable[[], int],
                 slow_hz: float = 0.0) -> None:
        self.heard_ns = now_ns()
        """Host time of the last drain that brought a sample."""
        self.gyro_radps = math.nan
        """Newest pivot speed [rad/s]; NaN before any sample."""
        self.accel_mps2 = (math.nan, math.nan)
        """Newest acceleration of the IMU [m/s2], tangential and along the link; NaN before any sample."""
        self.samples = self.gaps = 0
        self.fresh: deque[Batch] = deque(maxlen=FRESH)
        self.turned_rad = 0.0
        """What the gyro adds up to since the recording began [rad]."""
        self.pivot_rad = math.nan
        """q1 by gyro and gravity [rad]: good to some degrees, for a rig whose pivot has no sensor of its own."""
        self.gravity_mps2 = 0.0
        """Mean size of the acceleration so far [m/s2]."""
        self.measured_hz = math.nan
        """Samples a second since the recording began; NaN before two drains, or behind a gap."""
        self._first_ns = self._before = 0
        self._imu, self._sink, self._calibration = imu, sink, calibration
        self._now_ns, self._slow_every_ns, self._slow_due_ns = now_ns, 1e9 / slow_hz if slow_hz else math.inf, 0

    def drain(self) -> None:
        """Everything in the FIFO, stamped and written. Raises `DriverError` when the chip has gone."""
        self._drain()
        if self._slow_every_ns < math.inf and self._now_ns() >= self._slow_due_ns:
            self._slow_due_ns = self._now_ns() + round(self._slow_every_ns)
            with suppress(DriverError):  # the FIFO says whether the chip is there; a temperature is no reason to stop
                self._read_slow()

    def _read_slow(self) -> None:
        """Temperature, and the field where there is a magnetometer."""
        field = self._imu.magnetometer.read() if self._imu.magnetometer else None
        temperature, now = self._imu.temperature(), self._now_ns()
        counts = (0, 0, 0) if field is None else field.raw.tolist()
        self._sink.add("/imu/slow", now, now, temperature, *counts, int(field is not None))

    def _drain(self) -> None:
        batch = self._imu.drain()
        gap = batch.gap_before and self.samples > 0  # what the FIFO lost before the first sample belongs to no record
        if gap:
            self.gaps += 1
            self._sink.event(batch.t_before_ns, "imu gap", batch.reason)
        if not len(batch.raw):
            return
        for i, counts in enumerate(batch.raw.tolist()):
            index = batch.first_index + i
            self._sink.add("/imu", batch.t_before_ns, batch.t_before_ns, batch.t_after_ns, index, *counts,
                           int(gap and i == 0), sequence=index % 2**32)
        self.heard_ns = batch.t_after_ns
        self._see(batch.raw, gap)
        self.fresh.append(Batch(batch.raw, self.turned_rad, batch.t_after_ns, gap))

    def _see(self, raw: NDArray[np.int16], gap: bool) -> None:
        """Keep what the commanding thread asks for."""
        if not self.samples:
            self._first_ns = self.heard_ns
            self._before = len(raw)
        self.samples += len(raw)
        counted, seconds = self.samples - self._before, (self.heard_ns - self._first_ns) * 1e-9
        self.measured_hz = math.nan if self.gaps or not seconds else counted / seconds
        columns = imu_columns(raw, self._imu.scale, self._calibration)
        period_s = 1.0 / self._imu.config.rate_hz
        for gyro, x, y in zip(*(columns[name].tolist() for name in ("gyro_radps", "accel_x_mps2", "accel_y_mps2"))):
            self.turned_rad += gyro * period_s
            self._lean(gyro, x, y, period_s)
        self.gyro_radps, self.accel_mps2 = gyro, (x, y)
        accel = raw[:, 3:] * self._imu.scale[1] - np.asarray(self._calibration.accel_bias_mps2)
        size = float(np.linalg.norm(accel @ np.asarray(self._calibration.accel_matrix).T, axis=1).sum())
        self.gravity_mps2 += (size - len(raw) * self.gravity_mps2) / self.samples

    def _lean(self, gyro: float, x: float, y: float, period_s: float) -> None:
        """Gravity's direction, a_x = g sin(q1), a_y = -g cos(q1), draws the gyro's angle where the leg is calm."""
        down, calm = math.atan2(x, -y), abs(math.hypot(x, y) / lsm9ds1_registers.STANDARD_GRAVITY - 1.0) < NEAR_GRAVITY
        if math.isnan(self.pivot_rad):
            self.pivot_rad = down
            return
        self.pivot_rad += gyro * period_s
        if calm:
            away = math.remainder(down - self.pivot_rad, math.tau)
            self.pivot_rad += away * period_s / GRAVITY_S
