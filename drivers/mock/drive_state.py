"""The drive's state machine of firmware_protocol.md: arming, watchdog, latched faults."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.protocol import WATCHDOG_MS_MIN, Fault, State


class DriveState:
    """DISARMED, ARMED, FAULT. `report(fault, value)` is called once for every fault that latches."""

    def __init__(self, torque_limit_nm: float, watchdog_limit_ms: int,
                 report: Callable[[Fault, float], None]) -> None:
        self.state = State.DISARMED
        self.latched = Fault(0)
        self.torque_nm = 0.0
        self._limit_nm, self._watchdog_limit_ms = torque_limit_nm, watchdog_limit_ms
        self._report = report
        self._values: dict[Fault, float] = {}
        self._stopped = False
        self._seq: int | None = None
        self._watchdog_ns = 0
        self._fed_ns = 0

    def arm(self, watchdog_ms: int, t_ns: int) -> None:
        """DISARMED to ARMED; with a fault latched it is refused and reported, otherwise ignored."""
        if self.latched:
            for fault, value in self._values.items():
                self._report(fault, value)
        elif self.state == State.DISARMED and WATCHDOG_MS_MIN <= watchdog_ms <= self._watchdog_limit_ms:
            self.state, self.torque_nm, self._seq = State.ARMED, 0.0, None
            self._watchdog_ns, self._fed_ns = watchdog_ms * 1_000_000, t_ns

    def command(self, seq: int, torque_nm: float, t_ns: int) -> None:
        """A torque command: acts and feeds the watchdog only when ARMED, new, and within the limit."""
        if self.state != State.ARMED:
            return
        if self._seq is not None and not 0 < (seq - self._seq) % 65536 < 32768:
            return
        if abs(torque_nm) > self._limit_nm:
            self.trip(Fault.COMMAND_LIMIT, torque_nm)
            return
        self._seq, self.torque_nm, self._fed_ns = seq, torque_nm, t_ns

    def stop(self) -> None:
        """Torque zero from any state; a latched fault is acknowledged, not cleared."""
        self.torque_nm = 0.0
        self._stopped = True
        if self.state == State.ARMED:
            self.state = State.DISARMED

    def clear(self, present: Fault) -> None:
        """FAULT to DISARMED after a Stop, unless a cause is still there."""
        if self.state == State.FAULT and self._stopped and not present:
            self.state, self.latched = State.DISARMED, Fault(0)
            self._values.clear()

    def trip(self, fault: Fault, value: float = math.nan) -> None:
        """Latch a fault: torque zero, whatever the state. The first value is kept and reported once."""
        if fault in self._values:
            return
        self.state, self.torque_nm, self._stopped = State.FAULT, 0.0, False
        self.latched |= fault
        self._values[fault] = value
        self._report(fault, value)

    def check_watchdog(self, t_ns: int) -> None:
        """Trips when ARMED and not fed for the time given at Arm."""
        silent_ns = t_ns - self._fed_ns
        if self.state == State.ARMED and silent_ns >= self._watchdog_ns:
            self.trip(Fault.WATCHDOG, silent_ns * 1e-6)
