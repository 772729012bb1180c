"""`PolledDrive`: what every drive has in common that answers requests and keeps no time of its own.

A sample was taken between the request and its reply. `tick_us` of its telemetry is the middle of the two by the host's
clock, and `Received.asked_ns` the request, so that half of the round trip bounds the error. Nothing that comes late is
taken for the answer to a later request: after a request without an answer the line is first read empty.
"""

from __future__ import annotations

import math
import random
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Generic, NamedTuple, TypeVar

from drivers.closing import LinkHolder
from drivers.drive import Capabilities, LinkStats, Received, Wiring
from drivers.errors import DeviceFault, DriverError
from drivers.fault_remedy import fault_remedy
from drivers.link import Link
from drivers.protocol import (
    WATCHDOG_MS_MAX,
    WATCHDOG_MS_MIN,
    DriveLimits,
    Fault,
    FaultReport,
    Hello,
    State,
    Telemetry,
    describe_faults,
)

Chunk = TypeVar("Chunk")
ANSWER_NS = 20_000_000
"""An answer that takes longer is lost."""
CATCH_UP = 3
"""Requests that a poll that came late makes up for, at most."""
ASK_AGAIN_NS = 100_000_000
"""Time between requests while a drive is being identified."""


class Reading(NamedTuple):
    """One answer, in the joint's units and signs."""

    driving: bool
    """The power stage follows torque commands."""
    faults: int
    """Bits of `Fault` that the drive has now."""
    knee_rad: float
    current_a: float
    torque_cmd_nm: float
    """What the drive says that it was asked for."""
    bus_v: float
    motor_degc: float
    knee_again_rad: float = math.nan
    """Angle by a second sensor."""
    code: float = math.nan
    """The maker's number of what is wrong."""
    taken_ns: int | None = None
    """Host time at which angle and current were there, where more was asked for with them [ns]."""


class PolledDrive(LinkHolder, Generic[Chunk]):
    """A `Drive`; what differs from one to the next is below "the drive's own"."""

    capabilities = Capabilities(polled=True, clock="none", current="instant", knee_twice=False, hip=False)

    def __init__(self, link: Link[Chunk], wiring: Wiring, now_ns: Callable[[], int] = time.monotonic_ns,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self.hello: Hello | None = None
        self.telemetry: Telemetry | None = None
        self.limits: DriveLimits | None = None
        self.words = self.refusal = ""
        self.wiring = wiring
        self._link, self._now_ns, self._sleep = link, now_ns, sleep
        self._lock = threading.RLock()
        self._enabled = self._unsure = False
        self._latched = 0
        self._bad = self._unknown = self._lost = self._reboots = 0
        self._period_ns = round(1e9 / wiring.rate_hz)
        self._asked_ns = self._due_ns = self._cleared_ns = 0
        self._request = -1
        self._command_seq = 0
        self._boot_id = random.getrandbits(32)
        self._set_up()

    def _set_up(self) -> None:
        """Its own state as it is before anybody has answered."""

    # -- the drive's own -----------------------------------------------------------------------------------

    @abstractmethod
    def _identify(self, timeout_s: float) -> Hello:
        """Stop the motor, find out who is there and what it limits. See `Drive.open`."""

    @abstractmethod
    def _ask(self) -> None:
        """Write the request for one sample."""

    @abstractmethod
    def _hear(self, chunk: Chunk) -> Reading | None:
        """The reading, once the answer to the last request is complete."""

    @abstractmethod
    def _enable(self, watchdog_ms: int) -> None:
        """Have the power stage follow torque commands, torque zero."""

    @abstractmethod
    def _turn(self, torque_nm: float) -> None:
        """Write a torque of the joint [N m]; feeds the watchdog."""

    @abstractmethod
    def _halt(self) -> None:
        """Write what takes the torque off in every state."""

    @abstractmethod
    def _forget(self) -> None:
        """Write what has faults forgotten."""

    def _attend(self) -> None:
        """What is due by the clock."""

    # -- units ---------------------------------------------------------------------------------------------

    def joint_rad(self, turns: float) -> float:
        """Angle of the joint [rad] from what the drive counts [turns]."""
        return turns * 2.0 * math.pi / self.wiring.turns

    def drive_nm(self, torque_nm: float) -> float:
        """Torque at the drive [N m] from that at the joint: the power is the same."""
        return torque_nm / self.wiring.turns

    def joint_nm(self, torque_nm: float) -> float:
        """The inverse of `drive_nm`."""
        return torque_nm * self.wiring.turns

    def signed(self, current_a: float) -> float:
        """A current [A], positive where it turns the joint forward."""
        return math.copysign(1.0, self.wiring.turns) * current_a

    # -- Drive ---------------------------------------------------------------------------------------------

    def open(self, timeout_s: float = 2.0) -> Hello:
        try:
            self.hello = self._identify(timeout_s)
            return self.hello
        except BaseException:
            self.close()
            raise

    def _greet_again(self, host_ns: int) -> list[Received]:
        """The hello of a drive that has started anew, by the number of its boot; none before it was greeted at all."""
        if self.hello is None:
            return []
        self.hello = replace(self.hello, boot_id=self._boot_id)
        return [Received(self.hello, host_ns)]

    def poll(self) -> list[Received]:
        self._attend()
        if not self._asked_ns and not self._begin():
            return []
        chunk = self._link.read()
        host_ns = self._now_ns()
        reading = self._hear(chunk)
        if reading is None:
            if host_ns - self._asked_ns > ANSWER_NS:
                self._lost += 1
                self._asked_ns, self._unsure = 0, True
            return []
        asked_ns, self._asked_ns = self._asked_ns, 0
        if asked_ns <= self._cleared_ns:
            return []  # of before the faults were forgotten
        return self._received(reading, asked_ns, host_ns)

    def _begin(self) -> bool:
        """Ask for the next sample when it is due; False where it is not yet."""
        now = self._now_ns()
        if now < self._due_ns:
            self._sleep((self._due_ns - now) * 1e-9)
            now = self._now_ns()
            if now < self._due_ns:
                return False
        if self._unsure:
            self._link.read()  # an answer that came too late is nobody's
            self._unsure = False
            now = self._now_ns()
        self._due_ns = max(self._due_ns + self._period_ns, now - CATCH_UP * self._period_ns)
        self._request = (self._request + 1) % 65536
        with self._lock:
            self._asked_ns = self._now_ns()
            self._ask()
        return True

    def _received(self, reading: Reading, asked_ns: int, host_ns: int) -> list[Received]:
        host_ns = reading.taken_ns or host_ns
        tick_us = (asked_ns + host_ns) // 2000 % 2**32
        out: list[Received] = []
        with self._lock:
            fresh = reading.faults & ~self._latched
            if reading.faults:
                self._latched |= reading.faults
                self._enabled = False
            for fault in Fault:
                if fresh & fault:
                    report = FaultReport(tick_us, int(fault), self._latched, reading.code)
                    out.append(Received(report, host_ns))
            state = State.FAULT if self._latched else State.ARMED if reading.driving and self._enabled else \
                State.DISARMED
        self.telemetry = Telemetry(
            seq=self._request, tick_us=tick_us, state=int(state), faults=self._latched, knee_rad=reading.knee_rad,
            pivot_hall_rad=math.nan, knee_hall_rad=reading.knee_again_rad, current_a=reading.current_a,
            bus_v=reading.bus_v, motor_degc=reading.motor_degc, torque_cmd_nm=reading.torque_cmd_nm)
        out.append(Received(self.telemetry, host_ns, asked_ns))
        return out

    def arm(self, watchdog_ms: int) -> None:
        longest = self.hello.watchdog_ms if self.hello else WATCHDOG_MS_MAX
        if not WATCHDOG_MS_MIN <= watchdog_ms <= longest:
            raise ValueError(f"watchdog of {watchdog_ms} ms is outside {WATCHDOG_MS_MIN} to {longest} ms")
        if self._latched:
            self.stop()
            raise DeviceFault(f"drive has latched: {describe_faults(self._latched)}{self._said()}; "
                              f"{fault_remedy(self._latched)}")
        if self.refusal:
            self.stop()
            raise DeviceFault(self.refusal)
        with self._lock:
            self._enable(watchdog_ms)
            self._enabled = True

    def command(self, torque_nm: float) -> int:
        limit = self.hello.torque_limit_nm if self.hello else 0.0
        if not math.isfinite(torque_nm) or abs(torque_nm) > limit:
            self.stop()
            raise DriverError(f"drive: torque of {torque_nm:g} N m is beyond its limit of {limit:g} N m; motor stopped")
        with self._lock:
            seq, self._command_seq = self._command_seq, (self._command_seq + 1) % 65536
            if self._enabled:  # never behind a stop or a fault
                self._turn(torque_nm)
        return seq

    def ping(self) -> None:
        return None

    def stop(self) -> None:
        with self._lock:
            self._enabled = False
            self._halt()

    def clear_faults(self) -> None:
        with self._lock:
            self.stop()
            self._forget()
            self._latched, self.words, self._cleared_ns = 0, "", self._now_ns()
        self.telemetry = None

    @property
    def stats(self) -> LinkStats:
        return LinkStats(self._bad, 0, self._unknown, self._lost, self._reboots)

    def _said(self) -> str:
        return f" ({self.words})" if self.words else ""

    def _write(self, chunk: Chunk) -> None:
        with self._lock:
            self._link.write(chunk)

    def _answer(self, request: Callable[[], None], take: Callable[[Chunk], Any], timeout_s: float) -> Any:
        """What `take` makes of what comes back, asked for again until then; None where nothing does in time."""
        deadline, ask_at = self._now_ns() + round(timeout_s * 1e9), 0
        while (now := self._now_ns()) < deadline:
            if now >= ask_at:
                request()
                ask_at = now + ASK_AGAIN_NS
            found = take(self._link.read())
            if found is not None:
                return found
        return None
