"""An ODrive axis, emulated: CANSimple of firmware 0.6, its states, its errors, its axis watchdog.

Written from the published protocol page and DBC, not from its code.
"""

from __future__ import annotations

import math

from drivers.can_frame import NODE_BITS, CanFrame, Frames
from drivers.cansimple import (
    CLOSED_LOOP,
    IDLE,
    TORQUE_CONTROL,
    Msg,
    OdriveError,
    message,
    values_of,
)
from drivers.mock.bench_drive import BenchDrive, DriveFacts

FACTS = DriveFacts(node=0, rate_hz=250.0, serial=False)
BEAT_NS = 100_000_000
ASKED = (Msg.GET_VERSION, Msg.GET_ERROR, Msg.GET_ENCODER_ESTIMATES, Msg.GET_IQ, Msg.GET_TEMPERATURE,
         Msg.GET_BUS_VOLTAGE_CURRENT, Msg.GET_TORQUES)


class MockOdrive(BenchDrive):
    """One axis, by the node `wiring.node`."""

    def _set_up(self) -> None:
        self.watchdog_s, self.watchdog_on = self.wiring.watchdog_ms * 1e-3, True
        """axis0.config.watchdog_timeout and enable_watchdog."""
        self.polling_feeds = False
        """A watchdog that every frame feeds, as none should."""
        self.version = (2, 5, 2, 0, 0, 6, 10, 0)
        self.deaf: set[Msg] = set()
        """Messages that this firmware does not answer."""
        self.cyclic: dict[Msg, int] = {}
        """Period [ns] of each cyclic message."""
        self.driver_ok = True
        self.axis, self.active, self.reason = IDLE, OdriveError(0), OdriveError(0)
        self._asked_nm, self._mode = 0.0, 0
        self._limits = (math.inf, math.inf)
        self._fed_ns = self._t_ns
        self._beat_ns = self._t_ns + BEAT_NS
        self._due: dict[Msg, int] = {}

    def _obey(self, data: Frames, t_ns: int) -> None:
        for frame in data:
            if frame.can_id >> NODE_BITS != self.wiring.node or frame.extended:
                continue
            if self.polling_feeds:
                self._fed_ns = t_ns
            if frame.remote:
                self._answer(frame, t_ns)
            else:
                self._command(frame, t_ns)

    def _answer(self, frame: CanFrame, t_ns: int) -> None:
        number = frame.can_id & (2**NODE_BITS - 1)
        if number in ASKED and number not in self.deaf:
            self._send((self._say(Msg(number)),), t_ns)

    def _say(self, msg: Msg) -> CanFrame:
        s = self.settings
        per_nm = abs(self.wiring.turns) / s.torque_constant_nm_per_a
        torque = self.torque_nm
        values: dict[Msg, tuple[float, ...]] = {
            Msg.GET_VERSION: self.version,
            Msg.HEARTBEAT: (int(self.active), self.axis, 0, 0),
            Msg.GET_ERROR: (int(self.active), int(self.reason)),
            Msg.GET_ENCODER_ESTIMATES: (self.turns, self.turns_per_s),
            Msg.GET_IQ: (torque * per_nm, self.current_a),
            Msg.GET_TEMPERATURE: (s.ambient_degc + 5.0, self.degc),
            Msg.GET_BUS_VOLTAGE_CURRENT: (self.volts, 0.0),
            Msg.GET_TORQUES: (torque, self.current_a / per_nm),
        }
        return message(self.wiring.node, msg, *values[msg])

    def _command(self, frame: CanFrame, t_ns: int) -> None:
        told = values_of(frame)
        if told is None:
            return
        msg, values = told
        if msg == Msg.SET_INPUT_TORQUE and math.isfinite(values[0]):
            self._asked_nm, self._fed_ns = values[0], t_ns
        elif msg == Msg.SET_AXIS_STATE:
            self._fed_ns = t_ns
            if values[0] == IDLE:
                self.axis = IDLE
            elif values[0] == CLOSED_LOOP and not self.active and not self._causes():
                self.axis, self.reason = CLOSED_LOOP, OdriveError(0)
        elif msg == Msg.SET_CONTROLLER_MODE:
            self._mode = int(values[0])
        elif msg == Msg.SET_LIMITS:
            self._limits = (values[0], values[1])
        elif msg == Msg.CLEAR_ERRORS:
            self.active, self.reason = self._causes(), OdriveError(0)
        self._act()

    def _act(self) -> None:
        on = self.axis == CLOSED_LOOP and self._mode == TORQUE_CONTROL
        most = self._limits[1] * self.settings.torque_constant_nm_per_a / abs(self.wiring.turns)
        self.torque_nm = max(-most, min(most, self._asked_nm)) if on else 0.0

    def _check(self, t_ns: int) -> None:
        causes = self._causes()
        if self.watchdog_on and self.axis == CLOSED_LOOP and t_ns - self._fed_ns >= self.watchdog_s * 1e9:
            causes |= OdriveError.WATCHDOG_TIMER_EXPIRED
        if causes and self.axis == CLOSED_LOOP:
            self.axis, self.active, self.reason = IDLE, self.active | causes, self.reason | causes
        self._act()
        if t_ns >= self._beat_ns:
            self._beat_ns += BEAT_NS
            self._send((self._say(Msg.HEARTBEAT),), t_ns)
        for msg, every_ns in self.cyclic.items():
            if t_ns >= self._due.get(msg, 0):
                self._due[msg] = t_ns + every_ns
                self._send((self._say(msg),), t_ns)

    def _causes(self) -> OdriveError:
        s = self.settings
        checks = ((not self.driver_ok, OdriveError.DRV_FAULT), (not self.encoder_ok, OdriveError.MISSING_ESTIMATE),
                  (self.bus_v > s.overvoltage_v, OdriveError.DC_BUS_OVER_VOLTAGE),
                  (self.bus_v < s.undervoltage_v, OdriveError.DC_BUS_UNDER_VOLTAGE),
                  (self.degc > s.temperature_limit_degc, OdriveError.MOTOR_OVER_TEMP),
                  (abs(self.turns_per_s) > self._limits[0], OdriveError.VELOCITY_LIMIT_VIOLATION))
        found = OdriveError(0)
        for wrong, error in checks:
            found |= error if wrong else OdriveError(0)
        return found

    def power_cycle(self) -> None:
        super().power_cycle()
        self.axis, self.active, self.reason, self._mode, self._asked_nm = IDLE, OdriveError(0), OdriveError(0), 0, 0.0


emulate = MockOdrive
"""The ODrive at the end of a wiring."""
