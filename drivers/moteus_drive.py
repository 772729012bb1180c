"""mjbots moteus as a drive: registers over CAN FD, through SocketCAN, any interface of python-can, or an fdcanusb.

Torque mode is position mode without gains: kp, kd and the integrator's limit at zero, a feedforward torque, and the
time for which the command holds. When that has passed the firmware goes to mode 11, where `servo.timeout_mode` says
what it does; legid arms only where that is 0, which takes the torque off. Only a command that writes the mode feeds
this watchdog, so polling does not. Sources: docs/protocol/can.md, docs/protocol/registers.md,
docs/reference/configuration.md and docs/guides/control-modes.md of github.com/mjbots/moteus.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress

from drivers.can_frame import CanFrame, Frames, padded
from drivers.drive import Capabilities, Lack, Received, Wiring
from drivers.errors import DeviceAbsent, ProtocolMismatch
from drivers.fdcanusb_link import FdcanusbLink
from drivers.link import Link
from drivers.multiplex import (
    NOP,
    READ_ERROR,
    REPLY,
    STREAM_TO_CLIENT,
    STREAM_TO_SERVER,
    Kind,
    Register,
    parse,
    poll_stream,
    read,
    scaled,
    stream,
    write,
)
from drivers.polling import PolledDrive, Reading
from drivers.protocol import VERSION, DriveLimits, Fault, Hello, Reaction
from drivers.transport import open_port

HOST = 0
REPLY_WANTED = 0x8000
MAP_VERSION = 5
RATE_HZ = 500.0
NODES_TRIED = 16
"""Nodes that are looked for."""
STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11
TENTH = {Kind.INT16: 0.1}
FAULTS = {32: Fault.KNEE_ENCODER, 33: Fault.GATE_DRIVER, 34: Fault.OVERVOLTAGE, 35: Fault.KNEE_ENCODER,
          36: Fault.INTERNAL, 37: Fault.INTERNAL, 38: Fault.OVERTEMPERATURE, 39: Fault.POSITION_LIMIT,
          40: Fault.UNDERVOLTAGE, 41: Fault.INTERNAL, 42: Fault.KNEE_ENCODER, 43: Fault.KNEE_ENCODER,
          44: Fault.GATE_DRIVER, 46: Fault.INTERNAL, 48: Fault.POSITION_LIMIT}
"""Faults by moteus' fault codes; any other is INTERNAL."""
NAMES = {32: "calibration", 33: "motor driver", 34: "over voltage", 35: "encoder", 36: "motor not configured",
         37: "pwm cycle overrun", 38: "over temperature", 39: "outside limit", 40: "under voltage",
         41: "config changed", 42: "theta invalid", 43: "position invalid", 44: "driver enable", 46: "timing violation",
         48: "invalid limits",
         96: "limited by servo.max_velocity", 97: "limited by servo.max_power_W", 98: "limited by the supply",
         99: "limited by servo.max_current_A", 100: "limited by servo.fault_temperature",
         101: "limited by servo.motor_fault_temperature", 102: "limited by the maximum torque",
         103: "limited by servopos"}
SETTINGS = ("servo.timeout_mode", "servo.max_current_A", "servo.max_velocity", "servopos.position_min",
            "servopos.position_max", "servo.enable_motor_temperature")
"""Names of its configuration, read by `conf get`."""
CONSOLE_BYTES = 48
SETTING_S = 0.3
QUERY = (read(Kind.INT8, Register.MODE) + read(Kind.F32, Register.POSITION, 4) +
         read(Kind.INT16, Register.MOTOR_TEMPERATURE) + read(Kind.INT16, Register.VOLTAGE, 2) +
         read(Kind.INT8, Register.FAULT) + read(Kind.F32, Register.CONTROL_TORQUE) +
         read(Kind.INT32, Register.MILLISECONDS))
ANSWERED = {Register.MODE, Register.POSITION, Register.Q_CURRENT, Register.MOTOR_TEMPERATURE, Register.VOLTAGE,
            Register.TEMPERATURE, Register.FAULT, Register.CONTROL_TORQUE}
"""What an answer to QUERY must hold; the counter is not in every firmware."""
WHOLE = (Register.MODE, Register.FAULT, Register.MILLISECONDS)
IDENTIFIED = (Register.MODE, Register.FAULT, Register.FIRMWARE_VERSION, Register.REGISTER_MAP_VERSION)
STOP = write(Kind.INT8, Register.MODE, [STOPPED])
IDENTITY = (read(Kind.INT8, Register.MODE) + read(Kind.INT8, Register.FAULT) + STOP +
            read(Kind.INT32, Register.MODEL, 3))
"""The state is read before the motor is stopped: stopping clears what a timeout or a fault left."""
CLOCK_SHARE, CLOCK_MS, CLOCK_SPAN_MS = 0.05, 3.0, 100.0
"""How far the counter may be off the host's clock over so long: 0.25 % a step of its trim, and its own steps."""
LACKS = (
    Lack("its commands carry no number", "each holds for watchdog_ms only"),
    Lack("its counter shows milliseconds", "the host times each sample by request and answer"),
    Lack("it reads the knee by one sensor", "its own encoder fault 35, and [limits] unchecked names encoder_s"),
    Lack("it reads no pivot", "the IMU, or an absolute sensor on the I2C bus"),
    Lack("it has no E-stop input", "a hard-wired stop that takes the supply away; record asks for it"),
)


class MoteusDrive(PolledDrive[Frames]):
    """One moteus, by the identifier that `id.id` gives it."""

    capabilities = Capabilities(polled=True, clock="counter", current="instant", knee_twice=False, hip=False,
                                lacks=LACKS)

    def _set_up(self) -> None:
        self.settings: dict[str, float] = {}
        """What `conf get` said; NaN where the firmware does not know the setting."""
        self._where = f"moteus {self.wiring.node}"
        self._timeout_s = 0.1
        self._found: dict[int, float] = {}
        self._counted: deque[tuple[float, int]] = deque()
        self._version = ""

    # -- identify ------------------------------------------------------------------------------------------

    def _identify(self, timeout_s: float) -> Hello:
        found = self._answer(lambda: self._post(IDENTITY, True), self._identity, timeout_s)
        if found is None:
            raise DeviceAbsent(f"{self._where}: no answer within {timeout_s:g} s; check [devices.controller] node "
                               "against id.id, supply, wiring, termination, and 1 Mbit/s with 5 Mbit/s for data")
        number = int(found[Register.FIRMWARE_VERSION])
        self._version = f"{number >> 16}.{number >> 8 & 255}.{number & 255}"
        version = int(found[Register.REGISTER_MAP_VERSION])
        if version != MAP_VERSION:
            raise ProtocolMismatch(f"{self._where}: firmware {self._version} has register map {version}, this program "
                                   f"knows {MAP_VERSION}; flash matching firmware: moteus_tool --flash")
        self._latched = self._faults(int(found[Register.MODE]), int(found[Register.FAULT]))
        self.settings = self._read_settings()
        mode = self.settings["servo.timeout_mode"]
        if mode != 0.0:
            said = "cannot be read" if math.isnan(mode) else f"is {mode:g}"
            self.refusal = f"{self._where}: servo.timeout_mode {said}, so a lost host might not take the torque off; " \
                           "in tview: conf set servo.timeout_mode 0, then conf write"
        most = self.settings["servo.max_current_A"] * self.wiring.torque_constant_nm_per_a
        self.limits = self._own_limits()
        return Hello(VERSION, self._boot_id, round(self.wiring.rate_hz), self.wiring.gear_ratio,
                     most if math.isfinite(most) else self.wiring.torque_limit_nm, 1000)

    def _identity(self, frames: Frames) -> dict[int, float] | None:
        found = self._registers(frames)
        whole = all(math.isfinite(found.get(register, math.nan)) for register in IDENTIFIED)
        return found if whole else None

    def _read_settings(self) -> dict[str, float]:
        """The settings on which safety rests, over the console."""
        self._answer(lambda: self._post(poll_stream(CONSOLE_BYTES), True), lambda f: not self._text(f) or None,
                     SETTING_S)  # what is left there of somebody else's
        return {name: self._read_setting(name) for name in SETTINGS}

    def _read_setting(self, name: str) -> float:
        said = b""

        def ask() -> None:
            self._post(stream(STREAM_TO_SERVER, f"conf get {name}\n".encode()), False)
            self._post(poll_stream(CONSOLE_BYTES), True)

        def take(frames: Frames) -> bytes | None:
            nonlocal said
            text = self._text(frames)
            said += text
            if b"\n" in said:
                return said
            if frames:
                self._post(poll_stream(CONSOLE_BYTES), True)
            return None

        line = (self._answer(ask, take, SETTING_S) or b"").split(b"\n")[0].strip()
        with suppress(ValueError):
            return float(line)
        return math.nan

    def _own_limits(self) -> DriveLimits:
        low, high = (self.joint_rad(self.settings[f"servopos.position_{end}"]) for end in ("min", "max"))
        low, high = (low, high) if not low > high else (high, low)
        mode = self.settings["servo.timeout_mode"]
        reaction = {0.0: Reaction.LIMP, 15.0: Reaction.BRAKE}.get(mode, Reaction.HOLD)
        return DriveLimits(0, int(reaction), abs(self.joint_rad(self.settings["servo.max_velocity"])), low, high)

    # -- a sample ------------------------------------------------------------------------------------------

    def _ask(self) -> None:
        self._found = {}
        self._post(QUERY, True)

    def _hear(self, chunk: Frames) -> Reading | None:
        self._found |= self._registers(chunk)
        found = self._found
        if not found.keys() >= ANSWERED:
            return None
        if not all(math.isfinite(found[register]) for register in WHOLE if register in found):
            self._bad, self._found = self._bad + 1, {}
            return None
        mode, code = int(found[Register.MODE]), int(found[Register.FAULT])
        faults = self._faults(mode, code)
        board, motor = found[Register.TEMPERATURE], found[Register.MOTOR_TEMPERATURE]
        thermistor = self.settings.get("servo.enable_motor_temperature") == 1.0
        return Reading(
            driving=mode == POSITION, faults=faults, knee_rad=self.joint_rad(found[Register.POSITION]),
            current_a=self.signed(found[Register.Q_CURRENT]),
            torque_cmd_nm=self.joint_nm(found[Register.CONTROL_TORQUE]) if mode == POSITION else 0.0,
            bus_v=found[Register.VOLTAGE],
            motor_degc=max(board, motor) if thermistor and not math.isnan(motor) else board, code=code)

    def _received(self, reading: Reading, asked_ns: int, host_ns: int) -> list[Received]:
        """Nothing where the firmware's counter stands still: then the reading is an old one."""
        counter, middle_ms = self._found.get(Register.MILLISECONDS), (asked_ns + host_ns) * 0.5e-6
        if counter is None:
            return super()._received(reading, asked_ns, host_ns)
        out: list[Received] = []
        if self._counted:
            then_ms, then = self._counted[0]
            passed, counted = middle_ms - then_ms, (int(counter) - then) % 2**32
            allowed = CLOCK_MS + CLOCK_SHARE * passed + (host_ns - asked_ns) * 1e-6
            if counted > 2**31 or counted - passed > allowed:
                out = self._reboot(host_ns)
            elif passed - counted > allowed:
                self._bad += 1
                return []
        self._counted.append((middle_ms, int(counter)))
        while self._counted[-1][0] - self._counted[0][0] > CLOCK_SPAN_MS:
            self._counted.popleft()
        return out + super()._received(reading, asked_ns, host_ns)

    def _reboot(self, host_ns: int) -> list[Received]:
        self._reboots += 1
        self._boot_id = (self._boot_id + 1) % 2**32
        self._counted.clear()
        self.stop()  # a command of ours may have reached it before it was known
        return self._greet_again(host_ns)

    def _faults(self, mode: int, code: int) -> int:
        if self._latched and mode not in (FAULT, TIMEOUT):
            return 0  # stopping has cleared it there; the words stay until it is acknowledged here
        name = NAMES.get(code, "")
        self.words = f"moteus firmware {self._version}"
        if mode == FAULT:
            self.words += f", fault {code} {name}".rstrip()
            return int(FAULTS.get(code, Fault.INTERNAL))
        if mode == TIMEOUT:
            self.words += ", mode 11: no command came in time"
            return int(Fault.WATCHDOG)
        self.words += f", {name}" if code else ""
        return 0

    # -- torque --------------------------------------------------------------------------------------------

    def _enable(self, watchdog_ms: int) -> None:
        self._timeout_s = watchdog_ms * 1e-3
        self._turn(0.0)

    def _turn(self, torque_nm: float) -> None:
        most = abs(self.drive_nm(self.hello.torque_limit_nm if self.hello else 0.0))
        self._post(write(Kind.INT8, Register.MODE, [POSITION]) + write(
            Kind.F32, Register.COMMAND_POSITION,
            [math.nan, 0.0, self.drive_nm(torque_nm), 0.0, 0.0, most, math.nan, self._timeout_s]) +
            write(Kind.F32, Register.ILIMIT_SCALE, [0.0]), False)

    def _halt(self) -> None:
        self._post(STOP, False)

    def _forget(self) -> None:
        """Stopping has cleared mode 1 and mode 11; a cause that is still there comes back with the next arming."""

    # -- frames --------------------------------------------------------------------------------------------

    def _post(self, data: bytes, answer: bool) -> None:
        identifier = (REPLY_WANTED if answer else 0) | HOST << 8 | self.wiring.node
        self._write((CanFrame(identifier, padded(data, NOP), identifier > 0x7FF, True),))

    def _mine(self, frames: Frames) -> list[bytes]:
        return [frame.data for frame in frames if frame.can_id == self.wiring.node << 8 | HOST]

    def _registers(self, frames: Frames) -> dict[int, float]:
        """Values by register, in units."""
        found: dict[int, float] = {}
        for data in self._mine(frames):
            try:
                for part in parse(data):
                    if part.op == REPLY:
                        tenths = part.kind == Kind.INT16  # of volts and degrees
                        for k, value in enumerate(part.values):
                            found[part.start + k] = scaled(value, part.kind, TENTH) if tenths else value
                    elif part.op == READ_ERROR:
                        self._unknown += 1
            except ValueError:
                self._bad += 1
        return found

    def _text(self, frames: Frames) -> bytes:
        text = b""
        for data in self._mine(frames):
            with suppress(ValueError):
                text += b"".join(part.data for part in parse(data) if part.op == STREAM_TO_CLIENT)
        return text


def find_nodes(link: Link[Frames], wiring: Wiring) -> list[int]:
    """Identifiers of the moteus that answer, up to NODES_TRIED; each is stopped."""
    found: set[int] = set()
    for node in range(1, NODES_TRIED + 1):
        identifier = REPLY_WANTED | HOST << 8 | node
        link.write((CanFrame(identifier, padded(IDENTITY, NOP), True, True),))
        found |= {frame.can_id >> 8 for frame in link.read() if frame.can_id & 0xFF == HOST and frame.fd}
    return sorted(found & set(range(1, NODES_TRIED + 1)))


def open_link(wiring: Wiring) -> Link[Frames]:
    """The CAN FD bus, or the adapter on its serial port. Raises a `DriverError`."""
    if wiring.can is None:
        return FdcanusbLink(open_port(wiring.port, wiring.baud))
    from drivers.can_link import CanFilter, CanLink  # python-can takes a while to load

    mine = CanFilter(wiring.node << 8 | HOST, 0xFFFF if wiring.node else 0xFF, None)  # 0: whoever answers
    return CanLink(wiring.node, accept=mine, **{**wiring.can, "fd": True})


attach = MoteusDrive
"""The moteus behind a link, not yet greeted."""
