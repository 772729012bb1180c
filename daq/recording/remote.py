"""`Remote`: a recording's line to a process that watches it. Status goes out, stop and emergency stop come in.

The line is a pair of unix sockets that keep packets whole. What goes out never waits: a watcher that is slow misses
some of it. What comes in has a thread of its own, which sends the motor's Stop itself, so that an emergency waits for
nobody. A watcher that has gone, or is silent, is one whose emergency stop does not work: the torque is off then, too,
and the run ends.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Literal, NamedTuple

import msgspec
from msgspec import Struct

from daq.recording.supervisor import Sample, Trip
from daq.recording.workers import hurry
from drivers import DeviceAbsent, DriverError, LinkLost

ROW_EVERY_NS = 40_000_000
STATUS_EVERY_NS = 200_000_000
SILENCE_S = 0.15
"""A watcher must send something at least this often [s]: one that hangs is found out, and the torque off, in 0.2 s."""
LAST_WORD_S = 1.0
ALIVE, STOP, EMERGENCY = b"alive", b"stop", b"emergency"
"""Packets of the watcher."""
PACKET_BYTES = 65536
LOST = (DeviceAbsent, LinkLost)
"""Errors that say that a device is not there; the others say that it is, and does not do what it should."""
Ending = Literal["done", "stopped", "emergency", "limit", "lost", "overload", "failed"]


class Row(NamedTuple):
    """One point of the plots; None where nothing is measured."""

    time_s: float
    """Since the recording began."""
    q1_rad: float | None
    """Angle of the pivot's Hall sensor; None if the rig has none."""
    q2_rad: float | None
    torque_nm: float | None
    torque_cmd_nm: float | None
    gyro_radps: float | None
    accel_x_mps2: float | None
    accel_y_mps2: float | None
    q1_imu_rad: float | None = None
    """Estimated from gyro and gravity, good to some degrees, where the pivot has no sensor of its own."""


class Status(Struct, tag="status"):
    """The recorder's own status while it works."""

    phase: Literal["opening", "waiting", "driving", "ending"]
    rows: list[Row] = []
    """Since the status before."""
    done_s: float = 0.0
    total_s: float = 0.0
    controller: str = ""
    """State of the drive and its faults, in words."""
    controller_age_s: float | None = None
    imu_age_s: float | None = None
    imu_samples: int = 0
    imu_gaps: int = 0
    frames_lost: int = 0
    """Telemetry missing by its sequence numbers."""
    frames_bad: int = 0
    """Frames with a wrong check sum or length."""
    late_commands: int = 0
    clock_bound_s: float | None = None
    watched: list[tuple[str, str, float | None, float]] = []
    """Key under `[limits]`, what is limited in words, its value, the limit."""


class Heard(Struct, tag="heard"):
    """The emergency stop was heard, and the motor's Stop is sent."""


class Ended(Struct, tag="ended"):
    """The recorder's last word."""

    kind: Ending
    why: str
    """One line; empty when the plan was done."""
    motor: str
    """What is known of the motor."""


class Remote:
    """The recorder's end of the line. Everything but the listening thread belongs to the recorder's main thread."""

    def __init__(self, line: socket.socket) -> None:
        self.asked = ""
        """Who wants the run to end; empty while nobody does."""
        self.emergency = False
        """The torque must be off at once, without a ramp."""
        self.silent = False
        """The torque is off because nobody watches."""
        self.kind: Ending | None = None
        """How the run ended, as far as the recorder knows."""
        self.motor = "never driven"
        self._line = line
        self._thread = threading.Thread(target=self._listen, name="remote", daemon=True)
        self._stop_motor: Callable[[], None] = lambda: None
        self._rows: list[Row] = []
        self._row_due_ns = self._status_due_ns = self._first_ns = 0
        self._status: Callable[[], Status] = lambda: Status("opening")
        self._send(Status("opening"))

    def listen(self) -> None:
        """Start the thread that hears the watcher."""
        self._thread.start()

    def attach(self, stop_motor: Callable[[], None], status: Callable[[], Status]) -> None:
        """Set the callback of an emergency, from the listening thread, and the source of the status."""
        self._stop_motor, self._status = stop_motor, status
        if self.emergency:
            self._stop()

    def hurry(self) -> None:
        """Hear the watcher ahead of other programs from now on: an emergency stop is as urgent as a command."""
        hurry(self._thread)

    def see(self, now_ns: int, sample: Sample, accel_mps2: tuple[float, float] | None, watched: Iterator[Trip],
            pivot_sensed: bool = True) -> None:
        """The rig now; costs next to nothing unless something is due. Without `pivot_sensed` the sample's q1 is the
        IMU's."""
        if now_ns < self._row_due_ns:
            return
        self._row_due_ns = now_ns + ROW_EVERY_NS
        self._first_ns = self._first_ns or now_ns
        hall, imu = (sample.q1_rad, None) if pivot_sensed else (None, sample.q1_rad)
        x, y = accel_mps2 or (None, None)
        self._rows.append(Row((now_ns - self._first_ns) * 1e-9, hall, sample.q2_rad, sample.torque_nm,
                              sample.torque_cmd_nm, sample.q1_speed_radps, x, y, imu))
        if now_ns >= self._status_due_ns:
            self._status_due_ns = now_ns + STATUS_EVERY_NS
            status = self._status()
            status.rows, self._rows = self._rows, []
            status.controller_age_s, status.imu_age_s = sample.controller_age_s, sample.imu_age_s
            status.clock_bound_s = sample.clock_bound_s
            status.watched = [(trip.limit, trip.what, trip.value, trip.bound) for trip in watched]
            self._send(status)

    def end(self, ended: Ended) -> None:
        """The last word; waits a moment for a watcher that is slow."""
        with suppress(OSError):
            select.select([], [self._line], [], LAST_WORD_S)
        self._send(ended)
        with suppress(OSError):
            self._line.shutdown(socket.SHUT_RD)  # which ends the listening thread
        self._thread.join(LAST_WORD_S)

    def _send(self, message: Status | Heard | Ended) -> None:
        with suppress(OSError):  # full: the watcher is slow; closed: the listening thread sees to it
            self._line.send(msgspec.json.encode(message), socket.MSG_DONTWAIT)

    def _listen(self) -> None:
        while True:
            ready, _, _ = select.select([self._line], [], [], SILENCE_S)
            try:
                packet = self._line.recv(PACKET_BYTES) if ready else None
            except OSError:
                packet = b""
            if packet == EMERGENCY:
                self.emergency, self.asked = True, "the emergency stop"
                self._stop()
                self._send(Heard())
            elif packet == STOP:
                self.asked = self.asked or "the dashboard"
            elif not packet and not self.asked:
                self.silent, self.asked = True, "the silence of the dashboard: its emergency stop may not work"
                self.emergency = True  # no ramp: nobody could stop it
                self._stop()
            if packet == b"":
                return

    def _stop(self) -> None:
        with suppress(DriverError):  # the link is gone: the firmware's watchdog stops the motor
            self._stop_motor()


@contextmanager
def watched_by(descriptor: int | None) -> Iterator[Remote | None]:
    """The line behind an inherited file descriptor, told at the end how it went; None where nobody watches."""
    if descriptor is None:
        yield None
        return
    with socket.socket(fileno=descriptor) as line:
        remote = Remote(line)
        remote.listen()
        try:
            yield remote
        except BaseException as error:
            kind: Ending = remote.kind or ("lost" if isinstance(error, LOST) else "failed")
            if remote.silent and kind == "emergency":
                kind = "stopped"  # by nobody's hand
            remote.end(Ended(kind, str(error) or type(error).__name__, remote.motor))
            raise
        remote.end(Ended("done", "", remote.motor))
