"""The drive's state machine of firmware_protocol.md: arming, watchdog, latched faults, derating, reactions.

It counts in whole micro-units where firmware/leg_core.c does, so that both come to the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.mock.settings import FirmwareSettings
from drivers.protocol import WATCHDOG_MS_MIN, Fault, Reaction, State

OF_MOTION = Fault.OVERSPEED | Fault.POSITION_LIMIT
SOUND = OF_MOTION | Fault.WATCHDOG | Fault.COMMAND_LIMIT
"""Faults behind which the drive's own sensors are sound: it may brake or hold."""


class DriveState:
    """DISARMED, ARMED, FAULT. `report(fault, value)` is called once for every fault that latches."""

    def __init__(self, settings: FirmwareSettings, report: Callable[[Fault, float], None]) -> None:
        self.state = State.DISARMED
        self.latched = Fault(0)
        self.torque_nm = 0.0
        """Torque after derating."""
        self.reaction = Reaction.LIMP
        """To the faults that are latched; LIMP but in FAULT."""
        self.late = 0
        """Commands ignored for their sequence number or their age."""
        self._settings = settings
        self._report = report
        self._values: dict[Fault, float] = {}
        self._stopped = False
        self._seq: int | None = None
        self._timed = False
        self._asked_nm = 0.0
        self._knee_urad = self._speed_uradps = self._held_urad = 0
        self._watchdog_ns = 0
        self._fed_ns = self._held_from_ns = 0

    def arm(self, watchdog_ms: int, t_ns: int, estop_open: bool = False) -> None:
        """DISARMED to ARMED; with a fault latched it is refused and reported, otherwise ignored."""
        if self.latched:
            for fault, value in self._values.items():
                self._report(fault, value)
        elif (self.state == State.DISARMED and WATCHDOG_MS_MIN <= watchdog_ms <= self._settings.watchdog_limit_ms
              and not estop_open):
            self.state, self.torque_nm, self._asked_nm = State.ARMED, 0.0, 0.0
            self._seq, self._timed = None, False
            self._watchdog_ns, self._fed_ns = watchdog_ms * 1_000_000, t_ns

    def command(self, seq: int, torque_nm: float, t_ns: int, age_ns: int | None = None) -> None:
        """A torque command: acts and feeds the watchdog only when ARMED, new, in time, and within the limit.

        `age_ns` is how old the telemetry is that a TimedCommand answers; None for a TorqueCommand.
        """
        if self.state != State.ARMED:
            return
        behind = self._seq is not None and not 0 < (seq - self._seq) % 65536 < 32768
        if behind or (age_ns or 0) >= self._watchdog_ns or (self._timed and age_ns is None):
            self.late += 1
            return
        if abs(torque_nm) > self._settings.torque_limit_nm:
            self.trip(Fault.COMMAND_LIMIT, torque_nm, t_ns)
            return
        self._seq, self._timed, self._asked_nm, self._fed_ns = seq, age_ns is not None, torque_nm, t_ns
        self.torque_nm = self._derated(torque_nm)

    def stop(self) -> None:
        """Torque zero from any state; a latched fault is acknowledged, not cleared."""
        self.reaction, self.torque_nm, self._asked_nm = Reaction.LIMP, 0.0, 0.0
        self._stopped = True
        if self.state == State.ARMED:
            self.state = State.DISARMED

    def clear(self, present: Fault) -> None:
        """FAULT to DISARMED after a Stop, unless a cause is still there."""
        if self.state == State.FAULT and self._stopped and not present:
            self.state, self.latched = State.DISARMED, Fault(0)
            self._values.clear()

    def trip(self, fault: Fault, value: float = math.nan, t_ns: int = 0) -> None:
        """Latch a fault: torque zero, or the reaction, whatever the state. The first value is kept, reported once."""
        if fault in self._values:
            return
        sound = bool(fault & SOUND) and not (fault & OF_MOTION and math.isnan(value))
        acts = self.state == State.ARMED or self.reaction != Reaction.LIMP
        reaction = self._settings.reaction if sound and acts else Reaction.LIMP
        if self.reaction == Reaction.LIMP or reaction != Reaction.HOLD:
            self.torque_nm, self._held_urad, self._held_from_ns = 0.0, self._knee_urad, t_ns
        self.state, self.reaction, self._stopped, self._asked_nm = State.FAULT, reaction, False, 0.0
        self.latched |= fault
        self._values[fault] = value
        self._report(fault, value)

    def poll(self, t_ns: int, estop_open: bool) -> None:
        """Apply events that are due by the clock: E-stop, watchdog, the end of holding."""
        if estop_open:
            self.trip(Fault.ESTOP, t_ns=t_ns)
        self.check_watchdog(t_ns)
        if self.reaction == Reaction.HOLD and t_ns - self._held_from_ns >= self._settings.hold_ms * 1_000_000:
            self.reaction, self.torque_nm = Reaction.LIMP, 0.0

    def check_watchdog(self, t_ns: int) -> None:
        """Trips when ARMED and not fed for the time given at Arm."""
        silent_ns = t_ns - self._fed_ns
        if self.state == State.ARMED and silent_ns >= self._watchdog_ns:
            self.trip(Fault.WATCHDOG, silent_ns * 1e-6, t_ns)

    def observe(self, knee_rad: float, speed_radps: float) -> None:
        """A sample's knee angle and speed, for what comes after it."""
        if not (math.isnan(knee_rad) or math.isnan(speed_radps)):
            self._knee_urad, self._speed_uradps = round(knee_rad * 1e6), round(speed_radps * 1e6)

    def apply(self) -> None:
        """The torque by the newest sample, once its limits have been checked."""
        if self.state == State.ARMED:
            self.torque_nm = self._derated(self._asked_nm)
        elif self.reaction == Reaction.HOLD:
            self.torque_nm = self._hold_torque()

    def _derated(self, torque_nm: float) -> float:
        """Less where it speeds up towards a limit of speed, or leads towards one of position."""
        s = self._settings
        raw = round(torque_nm * 1e6)
        speed = -self._speed_uradps if raw < 0 else self._speed_uradps
        if speed > 0:
            limit, begins = round(s.speed_limit_radps * 1e6), round(s.speed_derate_radps * 1e6)
            raw = _shrunk(raw, limit - speed, limit - begins)
        before = (self._knee_urad - round(s.position_min_rad * 1e6) if raw < 0
                  else round(s.position_max_rad * 1e6) - self._knee_urad)
        return _shrunk(raw, before, round(s.position_derate_rad * 1e6)) / 1e6

    def _hold_torque(self) -> float:
        s = self._settings
        stiffness, damping = round(s.hold_stiffness_nm_per_rad * 1e3), round(s.hold_damping_nms_per_rad * 1e3)
        spring = stiffness * (self._knee_urad - self._held_urad) + damping * self._speed_uradps
        torque = min(abs(spring) // 1000, round(s.hold_torque_nm * 1e6))
        return (-torque if spring > 0 else torque) / 1e6


def _shrunk(raw: int, before: int, over: int) -> int:
    """What of a torque is left `before` a limit, where it begins to shrink at `over`; rounded towards zero."""
    if before >= over:
        return raw
    size = max(abs(raw) * before // over, 0)
    return -size if raw < 0 else size
