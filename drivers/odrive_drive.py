"""ODrive (S1, Pro, Micro) as a drive: CANSimple of firmware 0.6 in torque mode.

Telemetry is asked for by remote frames. The axis watchdog is a setting of the drive that CANSimple cannot read, so it
is proven at every arming: the axis enters closed loop at zero torque and is not fed until it disarms with
WATCHDOG_TIMER_EXPIRED. Polling goes on meanwhile, so a watchdog that polling feeds is refused.
"""

from __future__ import annotations

import math

from drivers.can_frame import NODE_BITS, ONE_MESSAGE, Frames
from drivers.cansimple import (
    CLOSED_LOOP,
    IDLE,
    PASSTHROUGH,
    TORQUE_CONTROL,
    Msg,
    OdriveError,
    error_names,
    message,
    request,
    values_of,
)
from drivers.drive import Capabilities, Lack, Received, Wiring
from drivers.errors import DeviceAbsent, DeviceFault, ProtocolMismatch
from drivers.link import Link
from drivers.polling import PolledDrive, Reading
from drivers.protocol import VERSION, Fault, Hello

RATE_HZ = 250.0
FIRMWARE = (0, 6)
SAMPLE = (Msg.GET_ENCODER_ESTIMATES, Msg.GET_IQ, Msg.GET_TORQUES, Msg.GET_ERROR)
"""Asked for at every sample; the first two are what is measured."""
SLOW = (Msg.GET_BUS_VOLTAGE_CURRENT, Msg.GET_TEMPERATURE)
SLOW_EVERY = 8
"""Samples between two readings of supply and temperature."""
QUIET_S = 0.06
BEAT_NS = 500_000_000
"""A heartbeat that is older says nothing; it comes every 100 ms."""
MARGIN = 1.5
"""Factor of the limits that are written to the drive over those of the rig file, which act first."""
PROOF_NS = 60_000_000
"""How much later than its time the watchdog may be seen to have acted."""
FEEDS = 0.75
"""The watchdog's time must be this share of watchdog_ms at least: three of the recorder's four feeds in it."""
_OF = OdriveError
FAULTS = {
    _OF.MISSING_ESTIMATE: Fault.KNEE_ENCODER, _OF.SPINOUT_DETECTED: Fault.KNEE_ENCODER,
    _OF.DRV_FAULT: Fault.GATE_DRIVER, _OF.DC_BUS_OVER_VOLTAGE: Fault.OVERVOLTAGE,
    _OF.DC_BUS_OVER_REGEN_CURRENT: Fault.OVERVOLTAGE, _OF.DC_BUS_UNDER_VOLTAGE: Fault.UNDERVOLTAGE,
    _OF.DC_BUS_OVER_CURRENT: Fault.OVERCURRENT, _OF.CURRENT_LIMIT_VIOLATION: Fault.OVERCURRENT,
    _OF.MOTOR_OVER_TEMP: Fault.OVERTEMPERATURE, _OF.INVERTER_OVER_TEMP: Fault.OVERTEMPERATURE,
    _OF.THERMISTOR_DISCONNECTED: Fault.OVERTEMPERATURE, _OF.VELOCITY_LIMIT_VIOLATION: Fault.OVERSPEED,
    _OF.POSITION_LIMIT_VIOLATION: Fault.POSITION_LIMIT, _OF.WATCHDOG_TIMER_EXPIRED: Fault.WATCHDOG,
    _OF.ESTOP_REQUESTED: Fault.ESTOP,
}
"""Any other error is INTERNAL."""
LACKS = (
    Lack("its commands carry no number", "its axis watchdog, proven at every arming, ends the last one"),
    Lack("it has no clock", "the host times each sample by request and answer"),
    Lack("it reads the knee by one sensor", "its own errors MISSING_ESTIMATE and SPINOUT_DETECTED, and [limits] "
                                            "unchecked names encoder_s"),
    Lack("it reads no pivot", "the IMU, or an absolute sensor on the I2C bus"),
    Lack("its limits cannot be read over CAN", "those of torque and speed are written to it as it is armed"),
    Lack("legid does not see an E-stop input", "a hard-wired stop that takes the supply away; record asks for it"),
)


class OdriveDrive(PolledDrive[Frames]):
    """One axis, by its node."""

    capabilities = Capabilities(polled=True, clock="none", current="instant", knee_twice=False, hip=False,
                                arming_s=2.5, lacks=LACKS)

    def _set_up(self) -> None:
        self._where = f"ODrive node {self.wiring.node}"
        self._version = ""
        self._found: dict[Msg, tuple[float, ...]] = {}
        self._slow = {Msg.GET_BUS_VOLTAGE_CURRENT: (math.nan, math.nan), Msg.GET_TEMPERATURE: (math.nan, math.nan)}
        self._axis, self._beat_ns, self._taken_ns = 0, 0, 0
        self._phase = "off"
        """off, proving (closed loop, not fed), arming (closed loop again, zero torque), on."""
        self._watchdog_ns = self._phase_ns = 0

    # -- identify ------------------------------------------------------------------------------------------

    def _identify(self, timeout_s: float) -> Hello:
        self._halt()
        version = self._answer(lambda: self._write((request(self.wiring.node, Msg.GET_VERSION),)),
                               lambda frames: self._sort(frames).get(Msg.GET_VERSION), timeout_s)
        if version is None:
            raise DeviceAbsent(f"{self._where}: no answer within {timeout_s:g} s; check [devices.controller] node "
                               "against axis0.config.can.node_id, supply, wiring, termination and bit rate")
        *_, major, minor, revision, _ = map(int, version)
        self._version = f"{major}.{minor}.{revision}"
        if (major, minor) != FIRMWARE:
            raise ProtocolMismatch(f"{self._where}: firmware {self._version}, this program speaks CANSimple of 0.6; "
                                   "flash it: odrivetool dfu")
        self._need_quiet()
        found: dict[Msg, tuple[float, ...]] = {}
        wanted = {*SAMPLE, *SLOW}

        def take(frames: Frames) -> bool | None:
            found.update(self._sort(frames))
            return True if wanted <= set(found) else None

        ask = tuple(request(self.wiring.node, msg) for msg in (*SAMPLE, *SLOW))
        if self._answer(lambda: self._write(ask), take, timeout_s) is None:
            lacking = ", ".join(sorted(msg.name for msg in wanted - set(found)))
            raise ProtocolMismatch(f"{self._where}: firmware {self._version} does not answer {lacking}; flash a newer "
                                   "0.6: odrivetool dfu")
        self._latched = self._faults(found)
        return Hello(VERSION, self._boot_id, round(self.wiring.rate_hz), self.wiring.gear_ratio,
                     self.wiring.torque_limit_nm, 1000)

    def _need_quiet(self) -> None:
        """Raises `DeviceFault` if cyclic messages are on: they would pass for answers, but with unknown times."""
        self._link.read()
        end, heard = self._now_ns() + round(QUIET_S * 1e9), set()
        while self._now_ns() < end:
            heard |= set(self._sort(self._link.read())) & set(SAMPLE)
        if heard:
            names = ", ".join(sorted(msg.name for msg in heard))
            raise DeviceFault(f"{self._where}: sends {names} unasked; set axis0.config.can.encoder_msg_rate_ms, "
                              "iq_msg_rate_ms, torques_msg_rate_ms and error_msg_rate_ms to 0, save_configuration()")

    # -- a sample ------------------------------------------------------------------------------------------

    def _ask(self) -> None:
        self._found, self._taken_ns = {}, 0
        wanted = SAMPLE if self._request % SLOW_EVERY else (*SAMPLE, *SLOW)
        self._write(tuple(request(self.wiring.node, msg) for msg in wanted))

    def _hear(self, chunk: Frames) -> Reading | None:
        found = self._found
        found.update(self._sort(chunk))
        if not self._taken_ns and Msg.GET_ENCODER_ESTIMATES in found and Msg.GET_IQ in found:
            self._taken_ns = self._now_ns()
        if not all(msg in found for msg in SAMPLE):
            return None
        driving = self._axis == CLOSED_LOOP and self._now_ns() - self._beat_ns < BEAT_NS
        fet, motor = self._slow[Msg.GET_TEMPERATURE]
        return Reading(
            driving=driving and self._phase == "on", faults=self._faults(found), knee_rad=self.joint_rad(
                found[Msg.GET_ENCODER_ESTIMATES][0]), current_a=self.signed(found[Msg.GET_IQ][1]),
            torque_cmd_nm=self.joint_nm(found[Msg.GET_TORQUES][0]) if driving else 0.0,
            bus_v=self._slow[Msg.GET_BUS_VOLTAGE_CURRENT][0], motor_degc=fet if math.isnan(motor) else max(fet, motor),
            code=float(int(found[Msg.GET_ERROR][0]) | int(found[Msg.GET_ERROR][1])), taken_ns=self._taken_ns)

    def _sort(self, frames: Frames) -> dict[Msg, tuple[float, ...]]:
        """Messages of this node; heartbeats, supply and temperature are kept."""
        found: dict[Msg, tuple[float, ...]] = {}
        for frame in frames:
            if frame.can_id >> NODE_BITS != self.wiring.node or frame.remote:
                continue
            told = values_of(frame)
            if told is None:
                self._unknown += 1
                continue
            msg, values = told
            if msg == Msg.HEARTBEAT:
                self._axis, self._beat_ns = int(values[1]), self._now_ns()
            elif msg in self._slow:
                self._slow[msg] = (values[0], values[1])
            found[msg] = values
        return found

    def _faults(self, found: dict[Msg, tuple[float, ...]]) -> int:
        active, reason = (int(value) for value in found[Msg.GET_ERROR])
        bits = active | reason
        self.words = f"ODrive firmware {self._version}" + (f", {error_names(bits)}" if bits else "")
        if self._phase in ("proving", "arming"):
            bits &= ~OdriveError.WATCHDOG_TIMER_EXPIRED
        faults = Fault(0)
        for error, fault in FAULTS.items():
            faults |= fault if bits & error else Fault(0)
        return int(faults | (Fault.INTERNAL if bits & ~sum(FAULTS) else Fault(0)))

    def _received(self, reading: Reading, asked_ns: int, host_ns: int) -> list[Received]:
        self._advance(int(reading.code), host_ns)
        return super()._received(reading, asked_ns, host_ns)

    # -- torque --------------------------------------------------------------------------------------------

    def _enable(self, watchdog_ms: int) -> None:
        self._watchdog_ns = watchdog_ms * 1_000_000
        self._phase, self._phase_ns = "proving", self._now_ns()
        w = self.wiring
        speed = MARGIN * w.speed_limit_radps * abs(w.turns) / (2.0 * math.pi)
        current = MARGIN * w.torque_limit_nm / w.torque_constant_nm_per_a
        self._write((message(w.node, Msg.CLEAR_ERRORS, 0), message(w.node, Msg.SET_LIMITS, speed, current),
                     message(w.node, Msg.SET_CONTROLLER_MODE, TORQUE_CONTROL, PASSTHROUGH)))
        self._close_loop()

    def _close_loop(self) -> None:
        self._axis = 0  # what an older heartbeat said is of before
        self._write((message(self.wiring.node, Msg.SET_INPUT_TORQUE, 0.0),
                     message(self.wiring.node, Msg.SET_AXIS_STATE, CLOSED_LOOP)))

    def _advance(self, errors: int, now: int) -> None:
        """The next step of arming, when the drive says that this one is done."""
        with self._lock:
            waited, expired = now - self._phase_ns, errors & OdriveError.WATCHDOG_TIMER_EXPIRED
            if self._phase == "proving":
                if expired and waited < FEEDS * self._watchdog_ns:
                    self._refuse(f"acted after {waited * 1e-6:.0f} ms")
                elif expired:
                    self._phase, self._phase_ns = "arming", now
                    self._write((message(self.wiring.node, Msg.CLEAR_ERRORS, 0),))
                    self._close_loop()
                elif waited > self._watchdog_ns + max(PROOF_NS, self._watchdog_ns // 4):
                    self._refuse("did not act in time")
            elif self._phase == "arming" and not errors and self._axis == CLOSED_LOOP:
                self._phase = "on"

    def _refuse(self, how: str) -> None:
        wanted = self._watchdog_ns * 1e-9
        self.stop()
        raise DeviceFault(f"{self._where}: its watchdog {how}, [devices.controller] watchdog_ms is {wanted * 1e3:.0f}; "
                          f"in odrivetool: odrv0.axis0.config.watchdog_timeout = {wanted:g}, enable_watchdog = True, "
                          "then save_configuration()")

    def _turn(self, torque_nm: float) -> None:
        if self._phase == "proving":
            return  # fed, it would prove nothing
        asked = self.drive_nm(torque_nm) if self._phase == "on" else 0.0
        self._write((message(self.wiring.node, Msg.SET_INPUT_TORQUE, asked),))

    def _halt(self) -> None:
        self._phase = "off"
        self._write((message(self.wiring.node, Msg.SET_INPUT_TORQUE, 0.0),
                     message(self.wiring.node, Msg.SET_AXIS_STATE, IDLE)))

    def _forget(self) -> None:
        self._write((message(self.wiring.node, Msg.CLEAR_ERRORS, 0),))


def find_nodes(link: Link[Frames], wiring: Wiring) -> list[int]:
    """Nodes whose version answers, every one asked; each is asked for IDLE."""
    found = set()
    for node in range(2 ** (11 - NODE_BITS) - 1):
        link.write((request(node, Msg.GET_VERSION),))
        for frame in link.read():
            version = frame.can_id & ONE_MESSAGE == Msg.GET_VERSION and len(frame.data) == 8
            if version and frame.data[4:6] == bytes(FIRMWARE):
                found.add(frame.can_id >> NODE_BITS)
    for node in found:
        link.write((message(node, Msg.SET_AXIS_STATE, IDLE),))
    return sorted(found)


def open_link(wiring: Wiring) -> Link[Frames]:
    """The CAN bus. Raises a `DriverError`."""
    if wiring.can is None:
        raise DeviceAbsent("ODrive: is on a CAN bus; name it under [devices.controller]: can = {interface = "
                           '"socketcan", channel = "can0"}')
    from drivers.can_link import CanLink  # python-can takes a while to load

    return CanLink(wiring.node, **wiring.can)


attach = OdriveDrive
"""The ODrive behind a link, not yet greeted."""
