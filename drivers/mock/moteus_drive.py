"""A moteus, emulated: CAN FD frames of registers in, frames out; torque mode, its watchdog, its faults, its console.

Written from docs/protocol/*.md and docs/reference/configuration.md of github.com/mjbots/moteus, not from its code.
"""

from __future__ import annotations

import math

from drivers.can_frame import CanFrame, Frames, padded
from drivers.mock.bench_drive import BenchDrive, DriveFacts
from drivers.mock.fdcanusb import MockFdcanusb
from drivers.multiplex import (
    NOP,
    READ,
    STREAM_POLL,
    STREAM_TO_CLIENT,
    STREAM_TO_SERVER,
    WRITE,
    Kind,
    Register,
    Subframe,
    counted,
    parse,
    read_error,
    reply,
    scaled,
    stream,
)

STOPPED, FAULT, POSITION, TIMEOUT, ZERO_VELOCITY, BRAKE = 0, 1, 10, 11, 12, 15
FACTS = DriveFacts(node=1, rate_hz=500.0, serial=True)
FIRMWARE, MAP_VERSION, MODEL = 0x000112, 5, 0x0004
_LSB_OF: dict[tuple[int, ...], tuple[float, float, float]] = {
    (Register.POSITION, Register.COMMAND_POSITION, Register.STOP_POSITION): (0.01, 1e-4, 1e-5),
    (Register.VELOCITY, Register.COMMAND_VELOCITY): (0.1, 0.00025, 1e-5),
    (Register.TORQUE, Register.COMMAND_TORQUE, Register.MAXIMUM_TORQUE, Register.CONTROL_TORQUE): (0.5, 0.01, 0.001),
    (Register.Q_CURRENT,): (1.0, 0.1, 0.001),
    (Register.VOLTAGE,): (0.5, 0.1, 0.001),
    (Register.TEMPERATURE, Register.MOTOR_TEMPERATURE): (1.0, 0.1, 0.001),
    (Register.WATCHDOG_TIMEOUT,): (0.01, 0.001, 1e-6),
    (Register.KP_SCALE, Register.KD_SCALE, Register.ILIMIT_SCALE): (1 / 127, 1 / 32767, 1 / 2147483647),
}
"""A unit of int8, int16 and int32, by register (docs/protocol/registers.md, "Mappings"); plain numbers otherwise."""
LSB = {register: dict(zip((Kind.INT8, Kind.INT16, Kind.INT32), units)) for registers, units in _LSB_OF.items()
       for register in registers}
PLAIN = {Kind.INT8: 1.0, Kind.INT16: 1.0, Kind.INT32: 1.0}
COMMAND: dict[int, float] = {
    Register.COMMAND_POSITION: 0.0, Register.COMMAND_VELOCITY: 0.0, Register.COMMAND_TORQUE: 0.0,
    Register.KP_SCALE: 1.0, Register.KD_SCALE: 1.0, Register.MAXIMUM_TORQUE: math.nan,
    Register.STOP_POSITION: math.nan, Register.WATCHDOG_TIMEOUT: 0.0, Register.ILIMIT_SCALE: 1.0}
"""What a command is where it leaves a register out."""
OVER_VOLTAGE, ENCODER, OVER_TEMPERATURE, UNDER_VOLTAGE, DRIVER = 34, 35, 38, 40, 33


class MockMoteus(BenchDrive):
    """One moteus on the bus, by the identifier `wiring.node`."""

    def _set_up(self) -> None:
        self.mode = STOPPED
        self.fault = 0
        self.driver_ok = True
        self.map_version, self.has_counter = MAP_VERSION, True
        self.stuck_counter_ms: int | None = None
        """Set: the registers are no longer written, as behind a task that hangs; all readings stay as they are."""
        current = 1.05 * self.settings.torque_limit_nm / self.settings.torque_constant_nm_per_a
        self.config = {"id.id": float(self.wiring.node), "servo.timeout_mode": 0.0, "servo.default_timeout_s": 0.1,
                       "servo.max_current_A": current, "servo.max_velocity": self.settings.speed_limit_radps
                       * abs(self.wiring.turns) / (2.0 * math.pi), "servopos.position_min": math.nan,
                       "servopos.position_max": math.nan, "servo.enable_motor_temperature": 1.0,
                       "servo.pid_position.kp": 4.0, "servo.pid_position.kd": 0.05}
        """What `conf get` says. Its default for timeout_mode is 12; this one was set up for legid."""
        self._command: dict[int, float] = dict(COMMAND)
        self._deadline_ns = math.inf
        self._console_in = self._console_out = b""
        self._kept: dict[int, float] = {}

    # -- frames --------------------------------------------------------------------------------------------

    def _obey(self, data: Frames, t_ns: int) -> None:
        for frame in data:
            if frame.can_id & 0xFF == self.wiring.node and not frame.remote:
                self._frame(frame, t_ns)

    def _frame(self, frame: CanFrame, t_ns: int) -> None:
        out, mode, command = b"", None, dict(COMMAND)
        try:
            for part in parse(frame.data):
                if part.op == WRITE:
                    for k, raw in enumerate(part.values):
                        register = part.start + k
                        value = scaled(raw, part.kind, LSB.get(register, PLAIN))
                        if register == Register.MODE:
                            mode = int(value)
                        elif register in command:
                            command[register] = value
                elif part.op == READ:
                    out += self._read(part, t_ns)
                elif part.op == STREAM_TO_SERVER:
                    self._console_in += part.data
                    self._console()
                elif part.op == STREAM_POLL:
                    most = int(part.values[0])
                    out += stream(STREAM_TO_CLIENT, self._console_out[:most])
                    self._console_out = self._console_out[most:]
        except ValueError:
            pass  # what stands before the broken part has been done, as subframe by subframe is
        if mode is not None:
            self._set_mode(mode, command, t_ns)
        if frame.can_id & 0x8000 and out:
            source = frame.can_id >> 8 & 0x7F
            identifier = self.wiring.node << 8 | source
            self._send((CanFrame(identifier, padded(out[:64], NOP), identifier > 0x7FF, True),), t_ns)

    def _read(self, part: Subframe, t_ns: int) -> bytes:
        registers = range(part.start, part.start + len(part.values))
        values = [self._value(register, t_ns) for register in registers]
        for register, value in zip(registers, values):
            if value is None:
                return read_error(register, 1)
        raw = [counted(value, part.kind, LSB.get(register, PLAIN)) if register != Register.MILLISECONDS
               else self._wrapped(value, part.kind) for register, value in zip(registers, values) if value is not None]
        return reply(part.kind, part.start, raw)

    @staticmethod
    def _wrapped(value: float, kind: Kind) -> float:
        if kind == Kind.F32:
            return value % 8388608
        bits = {Kind.INT8: 8, Kind.INT16: 16, Kind.INT32: 32}[kind]
        return (int(value) + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)

    def _value(self, register: int, t_ns: int) -> float | None:
        if self.stuck_counter_ms is not None and register in self._kept:
            return self._kept[register]
        value = self._fresh(register, t_ns)
        if value is not None:
            self._kept[register] = value
        return value

    def _fresh(self, register: int, t_ns: int) -> float | None:
        match register:
            case Register.MODE:
                return self.mode
            case Register.POSITION:
                return self.turns
            case Register.VELOCITY:
                return self.turns_per_s
            case Register.TORQUE:
                return self.current_a * self.settings.torque_constant_nm_per_a / abs(self.wiring.turns)
            case Register.Q_CURRENT:
                return self.current_a
            case Register.MOTOR_TEMPERATURE:
                return self.degc if self.config["servo.enable_motor_temperature"] else 0.0
            case Register.TEMPERATURE:
                return self.settings.ambient_degc + 5.0
            case Register.VOLTAGE:
                return self.volts
            case Register.FAULT:
                return self.fault
            case Register.CONTROL_TORQUE:
                return self.torque_nm
            case Register.MILLISECONDS if self.has_counter:
                ppm = self.settings.clock_error_ppm
                return (t_ns - self._boot_ns) * 1e-6 * (1 + ppm * 1e-6) // 1 + self.settings.first_tick_us // 1000
            case Register.MODEL:
                return MODEL
            case Register.FIRMWARE_VERSION:
                return FIRMWARE
            case Register.REGISTER_MAP_VERSION:
                return self.map_version
            case _:
                return self._command.get(register)

    # -- state ---------------------------------------------------------------------------------------------

    def _set_mode(self, mode: int, command: dict[int, float], t_ns: int) -> None:
        if mode == STOPPED:
            self.mode, self.fault, self.torque_nm, self._deadline_ns = STOPPED, 0, 0.0, math.inf
        elif mode == POSITION and self.mode in (STOPPED, POSITION):
            self.mode, self._command = POSITION, command
            timeout_s = command[Register.WATCHDOG_TIMEOUT] or self.config["servo.default_timeout_s"]
            self._deadline_ns = t_ns + timeout_s * 1e9 if not math.isnan(timeout_s) else math.inf
            self._control()

    def _control(self) -> None:
        """Torque of position mode [N m]: of the error where a position is commanded, damping, feedforward."""
        c = self._command
        kp, kd = self.config["servo.pid_position.kp"], self.config["servo.pid_position.kd"]
        position, velocity = c[Register.COMMAND_POSITION], c[Register.COMMAND_VELOCITY]
        torque = c[Register.COMMAND_TORQUE]
        if not math.isnan(position):
            torque += c[Register.KP_SCALE] * kp * (position - self.turns)
        scale = min(c[Register.KD_SCALE], c[Register.KP_SCALE])
        torque += scale * kd * ((0.0 if math.isnan(velocity) else velocity) - self.turns_per_s)
        own = self.config["servo.max_current_A"] * self.settings.torque_constant_nm_per_a / abs(self.wiring.turns)
        most = min(own, own if math.isnan(c[Register.MAXIMUM_TORQUE]) else c[Register.MAXIMUM_TORQUE])
        self.torque_nm = max(-most, min(most, torque))

    def _check(self, t_ns: int) -> None:
        code = self._cause()
        if code and self.mode not in (STOPPED, FAULT):
            self.mode, self.fault, self.torque_nm = FAULT, code, 0.0
        elif self.mode == POSITION and t_ns >= self._deadline_ns:
            self.mode, self.torque_nm = TIMEOUT, 0.0
        elif self.mode == POSITION:
            self._control()
        if self.mode == TIMEOUT and self.config["servo.timeout_mode"] in (ZERO_VELOCITY, POSITION):
            self.torque_nm = -self.config["servo.pid_position.kd"] * self.turns_per_s

    def _cause(self) -> int:
        s = self.settings
        checks = ((not self.driver_ok, DRIVER), (self.bus_v > s.overvoltage_v, OVER_VOLTAGE),
                  (not self.encoder_ok, ENCODER), (self.degc > s.temperature_limit_degc, OVER_TEMPERATURE),
                  (self.bus_v < s.undervoltage_v, UNDER_VOLTAGE))
        return next((code for wrong, code in checks if wrong), 0)

    def _console(self) -> None:
        *lines, self._console_in = self._console_in.split(b"\n")
        for line in lines:
            words = line.decode("ascii", "replace").split()
            if words[:2] == ["conf", "get"] and len(words) == 3 and words[2] in self.config:
                self._console_out += f"{self.config[words[2]]:g}\r\n".encode()
            elif words[:2] == ["conf", "set"] and len(words) == 4 and words[2] in self.config:
                self.config[words[2]] = float(words[3])
                self._console_out += b"OK\r\n"
            elif words == ["d", "stop"]:
                self._set_mode(STOPPED, {}, self._now_ns)
                self._console_out += b"OK\r\n"
            elif words:
                self._console_out += b"ERR unknown command\r\n"

    def power_cycle(self) -> None:
        super().power_cycle()
        self.mode, self.fault, self._command = STOPPED, 0, dict(COMMAND)


emulate = MockMoteus
"""The moteus at the end of a wiring."""
on_serial = MockFdcanusb
"""The moteus behind an fdcanusb."""
