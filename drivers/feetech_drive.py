"""A Feetech STS servo as a drive that is read and never turned on: half duplex on a serial line.

An STS has no watchdog: what it was told last, it does until it is told otherwise or its supply is gone. A lost host
would leave the torque on, so `arm` refuses, and no byte of this driver turns the torque on. Angle, current, voltage,
temperature and faults are left, for calibration, doctor and dashboard; the joint is moved by hand.

Torque goes off when the drive is opened, stopped and closed, and whenever a sample says that somebody else has turned
it on. A Stop goes out at once, and once more behind an answer that it may have met. Sources: see drivers/feetech.py.
"""

from __future__ import annotations

import math

from drivers import feetech as sts
from drivers.drive import Capabilities, Lack, Wiring
from drivers.errors import DeviceAbsent, ProtocolMismatch
from drivers.feetech import Address, Status
from drivers.link import Link
from drivers.polling import PolledDrive, Reading
from drivers.protocol import VERSION, Fault, Hello
from drivers.transport import open_port

RATE_HZ = 200.0
FIRST, SIZE = Address.TORQUE_ENABLE, Address.PRESENT_CURRENT + 2 - Address.TORQUE_ENABLE
"""One sample: from Torque Enable to Present Current."""
EEPROM = 40
"""Bytes below Torque Enable."""
NODES_TRIED = 20
FAULTS = ((Status.ENCODER, Fault.KNEE_ENCODER, "magnetic encoder"),
          (Status.TEMPERATURE, Fault.OVERTEMPERATURE, "overheating"),
          (Status.CURRENT, Fault.OVERCURRENT, "overcurrent"), (Status.LOAD, Fault.OVERCURRENT, "overload"))
REFUSAL = ("a Feetech STS has no watchdog, so a lost host would leave the torque on: legid reads it and never turns it "
           "on; record its position loop by your own program and use legid import")
LACKS = (
    Lack("it has no watchdog", "legid never arms it; the joint is moved by hand"),
    Lack("it has no torque command, only positions, speeds and a duty", "logs of your own program, by legid import"),
    Lack("it keeps no time", "the host times each sample by request and answer"),
    Lack("its packets have a checksum of 8 bits", "a sample has one length; others are thrown away"),
    Lack("it reads the knee by one sensor", "its own encoder error, and [limits] unchecked names encoder_s"),
    Lack("it reads no pivot", "the IMU, or an absolute sensor on the I2C bus"),
)


class FeetechDrive(PolledDrive[bytes]):
    """One STS by its identifier, `wiring.node`."""

    capabilities = Capabilities(polled=True, clock="none", current="instant", knee_twice=False, hip=False, lacks=LACKS)

    def _set_up(self) -> None:
        self.refusal = REFUSAL
        self.table = b""
        """The EEPROM's part of its memory table."""
        self._where = f"Feetech servo {self.wiring.node}"
        self._decoder = sts.Decoder()
        self._turns: int | None = None
        """Counts of whole turns before the newest position; None before the first."""
        self._counted = 0
        self._stop_again = False

    def _identify(self, timeout_s: float) -> Hello:
        self._halt()
        found = self._answer(lambda: self._write(sts.read(self.wiring.node, 0, EEPROM)),
                             lambda chunk: self._status(chunk, EEPROM), timeout_s)
        if found is None:
            raise DeviceAbsent(f"{self._where}: no answer within {timeout_s:g} s; check [devices.controller] node "
                               "against its ID (1 from the factory), baud against its Baud Rate (1000000 from the "
                               "factory), supply and wiring")
        self.table = found.params
        number = sts.word(self.table, Address.MODEL)
        if number not in sts.MODELS:
            known = ", ".join(sts.MODELS.values())
            raise ProtocolMismatch(f"{self._where}: model number {number} is none that this program knows; use one of "
                                   f"{known}")
        major, minor = self.table[Address.FIRMWARE], self.table[Address.FIRMWARE + 1]
        self._where = f"{sts.MODELS[number]} {self.wiring.node} firmware {major}.{minor}"
        self.words = self._where
        self._halt()
        return Hello(VERSION, self._boot_id, round(self.wiring.rate_hz), self.wiring.gear_ratio,
                     self.wiring.torque_limit_nm, 1000)

    # -- a sample ------------------------------------------------------------------------------------------

    def _attend(self) -> None:
        if self._stop_again and not self._asked_ns:
            self._stop_again = False
            self._write(self._torque_off())

    def _ask(self) -> None:
        self._decoder.clear()
        self._write(sts.read(self.wiring.node, FIRST, SIZE))

    def _hear(self, chunk: bytes) -> Reading | None:
        found = self._status(chunk, SIZE)
        if found is None:
            return None
        ram: bytes = found.params
        faults = self._faults(ram, found.code | ram[Address.STATUS - FIRST])
        if ram[Address.TORQUE_ENABLE - FIRST]:
            self._stop_again = True  # somebody else has turned it on, behind this answer it goes off
        phase = self.table[Address.PHASE] if self.table else 0
        current = sts.to_signed(sts.word(ram, Address.PRESENT_CURRENT - FIRST)) * sts.CURRENT_A
        return Reading(
            driving=False, faults=faults,
            knee_rad=self.joint_rad(self._position(sts.word(ram, Address.PRESENT_POSITION - FIRST)) / sts.COUNTS),
            current_a=math.nan if phase & sts.NO_CURRENT else self.signed(current), torque_cmd_nm=0.0,
            bus_v=0.1 * ram[Address.PRESENT_VOLTAGE - FIRST],
            motor_degc=float(ram[Address.PRESENT_TEMPERATURE - FIRST]), code=float(ram[Address.STATUS - FIRST]))

    def _position(self, read: int) -> int:
        """Counts without the jump from 4095 to 0 of a position within one turn; such a one turns by less than half a
        turn between two samples."""
        counts = sts.to_signed(read)
        if self.table and self.table[Address.PHASE] & sts.MULTI_TURN:
            return counts
        if self._turns is None:
            self._turns = 0
        elif abs(counts - self._counted) > sts.COUNTS // 2:
            self._turns += sts.COUNTS if counts < self._counted else -sts.COUNTS
        self._counted = counts
        return counts + self._turns

    def _faults(self, ram: bytes, status: int) -> int:
        names, faults = [], 0
        for bit, fault, name in FAULTS:
            if status & bit:
                names.append(name)
                faults |= fault
        if status & Status.VOLTAGE:
            high = ram[Address.PRESENT_VOLTAGE - FIRST] > self.table[Address.MAX_VOLTAGE] if self.table else False
            names.append("input voltage")
            faults |= Fault.OVERVOLTAGE if high else Fault.UNDERVOLTAGE
        self.words = ", ".join([self._where, *names])
        return int(faults)

    # -- torque: off ---------------------------------------------------------------------------------------

    def _enable(self, watchdog_ms: int) -> None:
        """Never: `refusal` keeps `arm` from it."""
        self._halt()

    def _turn(self, torque_nm: float) -> None:
        """Never, as nothing enables it."""
        self._halt()

    def _halt(self) -> None:
        self._stop_again = bool(self._asked_ns)
        self._write(self._torque_off())

    def _forget(self) -> None:
        """Its status is that of now."""
        self._decoder.clear()
        self._asked_ns = 0

    def _torque_off(self) -> bytes:
        return sts.silent_write(self.wiring.node, Address.TORQUE_ENABLE, b"\0")

    # -- the line ------------------------------------------------------------------------------------------

    def _status(self, chunk: bytes, size: int) -> sts.Packet | None:
        """The packet of this servo with `size` bytes, where one is complete. An adapter's echo has another length."""
        packet = None
        for one in self._decoder.feed(chunk):
            if one.ident == self.wiring.node and len(one.params) == size:
                packet = one
            elif one.ident == self.wiring.node:
                self._unknown += 1
        self._bad = self._decoder.bad
        return packet


def find_nodes(link: Link[bytes], wiring: Wiring) -> list[int]:
    """Identifiers of the servos that answer, up to NODES_TRIED; each is turned off."""
    found: set[int] = set()
    for node in range(NODES_TRIED + 1):
        decoder = sts.Decoder()
        link.write(sts.silent_write(node, Address.TORQUE_ENABLE, b"\0") + sts.read(node, Address.MODEL, 3))
        found |= {one.ident for one in decoder.feed(link.read()) if len(one.params) == 3}
    return sorted(found)


def open_link(wiring: Wiring) -> Link[bytes]:
    """The serial line. Raises a `DriverError`."""
    if wiring.can is not None:
        raise DeviceAbsent("[devices.controller] can: a Feetech servo is on a serial line; give port and baud")
    return open_port(wiring.port, wiring.baud)


attach = FeetechDrive
"""The servo behind a link, not yet greeted."""
