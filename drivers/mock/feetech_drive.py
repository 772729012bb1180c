"""STS servos on a serial line, emulated: packets in and out, memory table, PWM mode, status. There is no watchdog.

Written from Feetech's memory table (see drivers/feetech.py). The first turns the emulated knee: in PWM mode its torque
is the duty's share of `STALL_NM`, so that a motor that somebody left running can be stopped. `others` only answer.
"""

from __future__ import annotations

import math
import struct

from drivers import feetech as sts
from drivers.feetech import Address, Instruction, Status
from drivers.mock.bench_drive import BenchDrive, DriveFacts

FACTS = DriveFacts(node=1, rate_hz=200.0, serial=True)
MODEL = 777
STALL_NM = 2.9
"""Torque at a duty of 1 and 12 V: 30 kg cm."""
READ_ONLY = {0, 1, 3, 4, *range(56, 71)}


def new_table(ident: int, model: int = MODEL) -> bytearray:
    """A memory table as from the factory, but for limits of the emulated bench's supply."""
    table = bytearray(sts.TABLE)
    for at, form, value in ((Address.FIRMWARE, "<B", 3), (1, "<B", 9), (Address.MODEL, "<H", model),
                            (Address.IDENT, "<B", ident), (Address.STATUS_LEVEL, "<B", 1), (11, "<H", 4095),
                            (Address.MAX_TEMPERATURE, "<B", 70), (Address.MAX_VOLTAGE, "<B", 250),
                            (Address.MIN_VOLTAGE, "<B", 180), (16, "<H", 1000), (21, "<B", 32), (22, "<B", 32),
                            (48, "<H", 1000), (Address.LOCK, "<B", 1)):
        struct.pack_into(form, table, at, value)
    return table


class MockFeetech(BenchDrive):
    """The one by the identifier `wiring.node`, and the line that it is on."""

    nothing = b""

    def _set_up(self) -> None:
        self.driver_ok = True
        self.table = new_table(self.wiring.node)
        self.others: dict[int, bytearray] = {}
        self.echoes = False
        """The adapter gives back what was written, as one does whose lines are tied together."""
        self._decoder = sts.Decoder()

    # -- packets -------------------------------------------------------------------------------------------

    def _obey(self, data: bytes, t_ns: int) -> None:
        if self.echoes:
            self._outbox.append((t_ns, data))
        for k, one in enumerate(self._decoder.feed(data)):
            self._check(t_ns)
            for n, reply in enumerate(self._replies(one)):
                self._send(reply, t_ns + 1000 * (k + n))

    def _replies(self, one: sts.Packet) -> list[bytes]:
        known = {self.wiring.node: self.table, **self.others}
        p = one.params
        match one.code:
            case Instruction.SYNC_READ if len(p) > 2:
                return [self._read(ident, p[0], p[1]) for ident in p[2:] if ident in known]
            case Instruction.SYNC_WRITE if len(p) > 2:
                size = p[1]
                for k in range(2, len(p) - size, size + 1):
                    if p[k] in known:
                        self._store(p[k], p[0], p[k + 1:k + 1 + size])
                return []
            case Instruction.PING:
                idents = sorted(known) if one.ident == sts.BROADCAST else [one.ident] if one.ident in known else []
                return [sts.packet(ident, known[ident][Address.STATUS]) for ident in idents]
        if one.ident not in known:
            return []
        match one.code:
            case Instruction.READ if len(p) == 2:
                return [self._read(one.ident, p[0], p[1])]
            case Instruction.WRITE if len(p) > 1:
                self._store(one.ident, p[0], p[1:])
                level = known[one.ident][Address.STATUS_LEVEL]
                return [sts.packet(one.ident, known[one.ident][Address.STATUS])] if level else []
        return []

    def _read(self, ident: int, at: int, size: int) -> bytes:
        if ident == self.wiring.node:
            self._sense()
        table = self.table if ident == self.wiring.node else self.others[ident]
        return sts.packet(ident, table[Address.STATUS], bytes(table[at:at + size]))

    def _store(self, ident: int, at: int, data: bytes) -> None:
        table = self.table if ident == self.wiring.node else self.others[ident]
        for k, value in enumerate(data, at):
            locked = k < Address.TORQUE_ENABLE and table[Address.LOCK]
            if k < sts.TABLE and k not in READ_ONLY and not locked:
                table[k] = value
        if ident == self.wiring.node:
            self._control()

    # -- the servo -----------------------------------------------------------------------------------------

    def _sense(self) -> None:
        turns = self.turns
        counts = round(turns * sts.COUNTS) if math.isfinite(turns) else 0
        if not self.table[Address.PHASE] & sts.MULTI_TURN:
            counts %= sts.COUNTS
        amperes = self.current_a if math.isfinite(self.current_a) else 0.0
        for at, number in ((Address.PRESENT_POSITION, counts),
                           (Address.PRESENT_SPEED, round(self.turns_per_s * sts.COUNTS)),
                           (Address.PRESENT_CURRENT, round(amperes / sts.CURRENT_A))):
            struct.pack_into("<H", self.table, at, sts.from_signed(number))
        struct.pack_into("<H", self.table, Address.PRESENT_LOAD, sts.from_signed(round(1000 * self._duty()), 10))
        self.table[Address.PRESENT_VOLTAGE] = max(0, min(255, round(self.volts * 10.0)))
        self.table[Address.PRESENT_TEMPERATURE] = max(0, min(255, round(self.degc)))

    def _duty(self) -> float:
        if not self.table[Address.TORQUE_ENABLE] or self.table[Address.MODE] != sts.PWM_MODE:
            return 0.0
        return sts.to_signed(sts.word(bytes(self.table), Address.GOAL_TIME), 10) / sts.PWM_FULL

    def _control(self) -> None:
        self.torque_nm = self._duty() * STALL_NM / abs(self.wiring.turns)

    def _check(self, t_ns: int) -> None:
        table = self.table
        wrong = ((not table[Address.MIN_VOLTAGE] <= 10.0 * self.bus_v <= table[Address.MAX_VOLTAGE], Status.VOLTAGE),
                 (self.degc > table[Address.MAX_TEMPERATURE], Status.TEMPERATURE),
                 (not self.encoder_ok, Status.ENCODER), (not self.driver_ok, Status.CURRENT))
        table[Address.STATUS] = sum(bit for bad, bit in wrong if bad)
        if table[Address.STATUS]:
            table[Address.TORQUE_ENABLE] = 0
        self._control()

    def power_cycle(self) -> None:
        super().power_cycle()
        eeprom = bytes(self.table[:Address.TORQUE_ENABLE])
        self.table = new_table(self.wiring.node)
        self.table[:Address.TORQUE_ENABLE] = eeprom
        self._control()


emulate = MockFeetech
"""The servo at the end of a wiring."""
