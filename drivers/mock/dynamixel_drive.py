"""Dynamixels on a serial line, emulated: packets in and out, control table, current mode, Bus Watchdog, errors.

Written from the e-Manual's pages (see drivers/dynamixel.py). The first turns the emulated knee; `others` are further
ones on the same line, which do nothing but answer.
"""

from __future__ import annotations

import math
import struct

from drivers import dynamixel as dxl
from drivers.dynamixel import Address, HardwareError, Instruction
from drivers.mock.bench_drive import BenchDrive, DriveFacts

FACTS = DriveFacts(node=1, rate_hz=250.0, serial=True)
MODEL, FIRMWARE = 1040, 45
TABLE = 147
REBOOT_NS = 150_000_000
RETURN_DELAY_US = 2
GOALS = range(100, 120)
"""Goal PWM to Goal Position: read only while the Bus Watchdog's error stands."""
READ_ONLY = {*range(7), 69, 70, *range(120, TABLE)}
SHUTDOWN = HardwareError.OVERHEATING | HardwareError.ELECTRICAL_SHOCK | HardwareError.OVERLOAD
"""Errors that turn the torque off, as it comes from the factory."""


def new_table(ident: int, model: int = MODEL) -> bytearray:
    """A control table as from the factory, but for current mode and limits of 24 V."""
    table = bytearray(TABLE)
    for at, form, value in ((Address.MODEL_NUMBER, "<H", model), (Address.FIRMWARE_VERSION, "<B", FIRMWARE),
                            (7, "<B", ident), (8, "<B", 5), (Address.RETURN_DELAY_TIME, "<B", 30),
                            (Address.OPERATING_MODE, "<B", dxl.CURRENT_MODE), (13, "<B", 2),
                            (Address.TEMPERATURE_LIMIT, "<B", 80), (Address.MAX_VOLTAGE_LIMIT, "<H", 300),
                            (Address.MIN_VOLTAGE_LIMIT, "<H", 180), (Address.CURRENT_LIMIT, "<H", 689),
                            (Address.VELOCITY_LIMIT, "<I", 1023), (Address.SHUTDOWN, "<B", SHUTDOWN),
                            (Address.STATUS_RETURN_LEVEL, "<B", 2)):
        struct.pack_into(form, table, at, value)
    return table


class MockDynamixel(BenchDrive):
    """The one by the identifier `wiring.node`, and the line that it is on."""

    nothing = b""
    model = MODEL

    def _set_up(self) -> None:
        self.driver_ok = True
        self.stuck = False
        """All readings, the tick among them, stay as they are."""
        self.table = new_table(self.wiring.node, self.model)
        self.others: dict[int, bytearray] = {}
        self.unit_a = dxl.MODELS[self.model].current_a
        limit = 1.05 * self.settings.torque_limit_nm / self.settings.torque_constant_nm_per_a / self.unit_a
        struct.pack_into("<H", self.table, Address.CURRENT_LIMIT, round(limit))
        self._decoder = dxl.Decoder()
        self._fed_ns = self._t_ns
        self._deaf_until_ns = 0

    # -- packets -------------------------------------------------------------------------------------------

    def _obey(self, data: bytes, t_ns: int) -> None:
        if t_ns < self._deaf_until_ns:
            return
        delay_ns = 0
        for one in self._decoder.feed(data):
            if one.instruction == Instruction.STATUS:
                continue
            self._check(t_ns)
            self._fed_ns = t_ns
            for reply in self._replies(one, t_ns):
                delay_ns += self.table[Address.RETURN_DELAY_TIME] * RETURN_DELAY_US * 1000
                self._send(reply, t_ns + delay_ns)

    def _replies(self, one: dxl.Packet, t_ns: int) -> list[bytes]:
        known = {self.wiring.node: self.table, **self.others}
        match one.instruction:
            case Instruction.SYNC_READ if len(one.params) > 4:
                at, size = struct.unpack_from("<HH", one.params)
                return [self._read(ident, at, size, t_ns) for ident in one.params[4:] if ident in known]
            case Instruction.SYNC_WRITE if len(one.params) > 4:
                at, size = struct.unpack_from("<HH", one.params)
                for k in range(4, len(one.params) - size, size + 1):
                    if one.params[k] in known:
                        self._store(one.params[k], at, one.params[k + 1:k + 1 + size])
                return []
            case Instruction.PING:
                idents = sorted(known) if one.ident == dxl.BROADCAST else [one.ident] if one.ident in known else []
                return [dxl.status(i, self._alert(i), bytes(known[i][:2]) + bytes([known[i][Address.FIRMWARE_VERSION]]))
                        for i in idents]
        if one.ident not in known:
            return []
        level = known[one.ident][Address.STATUS_RETURN_LEVEL]
        match one.instruction:
            case Instruction.READ if len(one.params) == 4:
                at, size = struct.unpack("<HH", one.params)
                return [self._read(one.ident, at, size, t_ns)] if level >= 1 else []
            case Instruction.WRITE if len(one.params) > 2:
                error = self._store(one.ident, struct.unpack_from("<H", one.params)[0], one.params[2:])
            case Instruction.REBOOT:
                error = 0
                if one.ident == self.wiring.node:
                    self.power_cycle()
                    self._deaf_until_ns = t_ns + REBOOT_NS
            case _:
                error = 2
        return [dxl.status(one.ident, self._alert(one.ident) | error)] if level >= 2 else []

    def _alert(self, ident: int) -> int:
        table = self.table if ident == self.wiring.node else self.others[ident]
        return dxl.ALERT if table[Address.HARDWARE_ERROR_STATUS] else 0

    def _read(self, ident: int, at: int, size: int, t_ns: int) -> bytes:
        if at + size > TABLE:
            return dxl.status(ident, self._alert(ident) | 7)
        if ident == self.wiring.node and not self.stuck:
            self._sense(t_ns)
        table = self.table if ident == self.wiring.node else self.others[ident]
        return dxl.status(ident, self._alert(ident), bytes(table[at:at + size]))

    def _store(self, ident: int, at: int, data: bytes) -> int:
        """The error of a status packet; 0 where the bytes are in the table."""
        table = self.table if ident == self.wiring.node else self.others[ident]
        span = range(at, at + len(data))
        if at + len(data) > TABLE or READ_ONLY.intersection(span):
            return 7
        if at < Address.TORQUE_ENABLE and table[Address.TORQUE_ENABLE]:
            return 7
        goals = set(GOALS).intersection(span)
        if goals and table[Address.BUS_WATCHDOG] == dxl.WATCHDOG_ERROR:
            return 4
        if at == Address.GOAL_CURRENT and abs(struct.unpack("<h", data[:2])[0]) > dxl.unsigned(
                bytes(table), Address.CURRENT_LIMIT, 2):
            return 6
        if at == Address.TORQUE_ENABLE and data[0] and table[Address.HARDWARE_ERROR_STATUS] & table[Address.SHUTDOWN]:
            return 1
        table[at:at + len(data)] = data
        if ident == self.wiring.node:
            self._control()
        return 0

    # -- the servo -----------------------------------------------------------------------------------------

    def _sense(self, t_ns: int) -> None:
        ppm = self.settings.clock_error_ppm
        tick = int((t_ns - self._boot_ns) * 1e-6 * (1 + ppm * 1e-6)) + self.settings.first_tick_us // 1000
        turns = self.turns
        position = round(turns * dxl.COUNTS) if math.isfinite(turns) else 0
        position = (position + 2**31) % 2**32 - 2**31
        amperes = self.current_a if math.isfinite(self.current_a) else 0.0  # an integer cannot say that it is none
        current = max(-32768, min(32767, round(amperes / self.unit_a)))
        struct.pack_into("<H", self.table, Address.REALTIME_TICK, tick % dxl.TICK_WRAP)
        struct.pack_into("<h", self.table, Address.PRESENT_CURRENT, current)
        struct.pack_into("<i", self.table, Address.PRESENT_VELOCITY, round(self.turns_per_s * 60.0 / dxl.VELOCITY_RPM))
        struct.pack_into("<i", self.table, Address.PRESENT_POSITION, position)
        struct.pack_into("<H", self.table, Address.PRESENT_INPUT_VOLTAGE, max(0, round(self.volts * 10.0)))
        self.table[Address.PRESENT_TEMPERATURE] = max(0, min(255, round(self.degc)))

    def _control(self) -> None:
        on = (self.table[Address.TORQUE_ENABLE] and self.table[Address.OPERATING_MODE] == dxl.CURRENT_MODE
              and self.table[Address.BUS_WATCHDOG] != dxl.WATCHDOG_ERROR)
        current = struct.unpack_from("<h", self.table, Address.GOAL_CURRENT)[0] * self.unit_a if on else 0.0
        # at the drive: the joint's torque over the turns that the drive counts a turn of the joint
        self.torque_nm = current * self.settings.torque_constant_nm_per_a / abs(self.wiring.turns)

    def _check(self, t_ns: int) -> None:
        table, s = self.table, self.settings
        watchdog = table[Address.BUS_WATCHDOG]
        if (table[Address.TORQUE_ENABLE] and 0 < watchdog < 128
                and t_ns - self._fed_ns > watchdog * dxl.WATCHDOG_UNIT_MS * 1_000_000):
            table[Address.BUS_WATCHDOG] = dxl.WATCHDOG_ERROR
            struct.pack_into("<h", table, Address.GOAL_CURRENT, 0)
        low, high = (dxl.unsigned(bytes(table), at, 2) * 0.1
                     for at in (Address.MIN_VOLTAGE_LIMIT, Address.MAX_VOLTAGE_LIMIT))
        for wrong, bit in ((not low <= self.bus_v <= high, HardwareError.INPUT_VOLTAGE),
                           (self.degc > min(table[Address.TEMPERATURE_LIMIT], s.temperature_limit_degc),
                            HardwareError.OVERHEATING),
                           (not self.encoder_ok, HardwareError.ENCODER),
                           (not self.driver_ok, HardwareError.ELECTRICAL_SHOCK)):
            if wrong:
                table[Address.HARDWARE_ERROR_STATUS] |= bit
        if table[Address.HARDWARE_ERROR_STATUS] & table[Address.SHUTDOWN]:
            table[Address.TORQUE_ENABLE] = 0
        self._control()

    def power_cycle(self) -> None:
        super().power_cycle()
        self.table[Address.TORQUE_ENABLE:TABLE] = bytes(TABLE - Address.TORQUE_ENABLE)
        self.table[Address.STATUS_RETURN_LEVEL] = 2
        self._control()


emulate = MockDynamixel
"""The Dynamixel at the end of a wiring."""
