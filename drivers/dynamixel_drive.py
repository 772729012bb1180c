"""A Dynamixel of the X series as a drive: protocol 2.0 on a serial line of half duplex, current control mode.

The line carries one thing at a time. A request and its answer are never interrupted by a command: that waits for the
answer and goes out at once behind it. Writes are sync writes to one, which nobody answers. A Stop does not wait: it
goes out at once, and once more behind the answer that it may have met.

Its Bus Watchdog counts the time since any instruction, a poll as well. So that only commands feed it, polling stops
where commands stop: from then on the line is silent until the watchdog has acted.

Sources: see drivers/dynamixel.py; "Bus Watchdog", "Hardware Error Status" and "Shutdown" of the control tables.
"""

from __future__ import annotations

import math
import struct
from collections import deque

from drivers import dynamixel as dxl
from drivers.drive import Capabilities, Lack, Received, Wiring
from drivers.dynamixel import Address, HardwareError
from drivers.errors import DeviceAbsent, ProtocolMismatch
from drivers.link import Link
from drivers.polling import PolledDrive, Reading
from drivers.protocol import VERSION, DriveLimits, Fault, Hello, Reaction
from drivers.transport import open_port

RATE_HZ = 250.0
FIRST, SIZE = Address.TORQUE_ENABLE, Address.PRESENT_TEMPERATURE + 1 - Address.TORQUE_ENABLE
"""One sample: from Torque Enable to Present Temperature."""
EEPROM = 64
"""Bytes below Torque Enable."""
SETTLE_S = 0.02
"""Pause after a write to the EEPROM [s]."""
PING_BYTES = 3
"""Length of the parameters of its answer: model number and firmware."""
REBOOT_S = 0.3
ANSWER_S = 0.005
"""Time in which an answer that is under way arrives [s]."""
SILENCE_MARGIN_NS = 5_000_000
WATCHDOG_STEP_NS = dxl.WATCHDOG_UNIT_MS * 1_000_000
NODES_TRIED = 20
TICK_SLACK_MS, TICK_SHARE, TICK_SPAN_MS, LONG_AGO_MS = 3.0, 0.05, 100.0, 10_000.0
"""Allowed error of the realtime tick against the host's clock: absolute and relative; the least time span over which
they are compared; the longest gap."""
FAULTS = ((HardwareError.OVERHEATING, Fault.OVERTEMPERATURE, "overheating"),
          (HardwareError.ENCODER, Fault.KNEE_ENCODER, "motor encoder"),
          (HardwareError.ELECTRICAL_SHOCK, Fault.GATE_DRIVER, "electrical shock or too little power"),
          (HardwareError.OVERLOAD, Fault.OVERCURRENT, "overload"))
LACKS = (
    Lack("its commands carry no number", "each holds until the next, at most until the Bus Watchdog acts"),
    Lack("its Bus Watchdog is fed by polls too, in steps of 20 ms", "polling stops where commands stop"),
    Lack("its tick shows milliseconds and wraps at 32.768 s", "the host times each sample by request and answer"),
    Lack("it reads the knee by one sensor", "its own encoder error, and [limits] unchecked names encoder_s"),
    Lack("it reads no pivot", "the IMU, or an absolute sensor on the I2C bus"),
    Lack("it has no E-stop input", "a hard-wired stop that takes the supply away; record asks for it"),
    Lack("it forgets a hardware error only by a reboot", "legid doctor --clear-faults reboots it"),
)


class DynamixelDrive(PolledDrive[bytes]):
    """One Dynamixel by its identifier, `wiring.node`."""

    capabilities = Capabilities(polled=True, clock="counter", current="instant", knee_twice=False, hip=False,
                                lacks=LACKS)

    def _set_up(self) -> None:
        self.table = b""
        """The EEPROM's part of its control table."""
        self.model = dxl.Model("Dynamixel", 1e-3)
        self._where = f"Dynamixel {self.wiring.node}"
        self._decoder = dxl.Decoder()
        self._firmware = 0
        self._waiting: list[bytes] = []
        self._asked_counts: deque[tuple[int, float]] = deque(maxlen=16)
        self._watchdog_ns = self._bus_ns = self._commanded_ns = 0
        self._counted: deque[tuple[float, int]] = deque()
        self._stale = 0
        self._tick = 0

    # -- identify ------------------------------------------------------------------------------------------

    def _identify(self, timeout_s: float) -> Hello:
        self._post(self._torque_off(), now=True)
        found = self._answer(lambda: self._post(dxl.packet(self.wiring.node, dxl.Instruction.PING), now=True),
                             lambda chunk: self._status(chunk, PING_BYTES), timeout_s)
        if found is None:
            raise DeviceAbsent(f"{self._where}: no answer within {timeout_s:g} s; check [devices.controller] node "
                               "against its ID, baud against its Baud Rate (57600 from the factory), supply, wiring, "
                               "and that it speaks protocol 2.0")
        number, self._firmware = int.from_bytes(found.params[:2], "little"), found.params[2]
        if number not in dxl.MODELS:
            known = ", ".join(model.name for model in dxl.MODELS.values())
            raise ProtocolMismatch(f"{self._where}: model number {number} is none that this program knows with a "
                                   f"current mode; use one of {known}")
        self.model = dxl.MODELS[number]
        self._where = f"{self.model.name} {self.wiring.node}"
        if self._firmware < dxl.OLDEST_WITH_WATCHDOG:
            raise ProtocolMismatch(f"{self._where}: firmware {self._firmware} has no Bus Watchdog, without which a "
                                   f"lost host leaves the torque on; update to {dxl.OLDEST_WITH_WATCHDOG} or newer "
                                   "with DYNAMIXEL Wizard 2.0")
        self.table = self._need(0, EEPROM, timeout_s)
        if self.table[Address.OPERATING_MODE] != dxl.CURRENT_MODE:
            self._set_current_mode(timeout_s)
        ram = self._need(FIRST, SIZE, timeout_s)
        self._latched = self._faults(ram)
        most = dxl.unsigned(self.table, Address.CURRENT_LIMIT, 2) * self.model.current_a
        self.limits = self._own_limits()
        return Hello(VERSION, self._boot_id, round(self.wiring.rate_hz), self.wiring.gear_ratio,
                     most * self.wiring.torque_constant_nm_per_a, 1000)

    def _need(self, address: int, size: int, timeout_s: float) -> bytes:
        found = self._answer(lambda: self._post(dxl.read(self.wiring.node, address, size), now=True),
                             lambda chunk: self._status(chunk, size), timeout_s)
        if found is None:
            raise DeviceAbsent(f"{self._where}: answers a ping and no read; set its Status Return Level to 1 or 2, "
                               "check ground, and that no other device on the line has its ID")
        params: bytes = found.params
        return params

    def _set_current_mode(self, timeout_s: float) -> None:
        """The mode lies in the EEPROM, which takes a write while the torque is off."""
        self._post(dxl.silent_write(self.wiring.node, Address.OPERATING_MODE, bytes([dxl.CURRENT_MODE])), now=True)
        self._sleep(SETTLE_S)
        before, self.table = self.table[Address.OPERATING_MODE], self._need(0, EEPROM, timeout_s)
        if self.table[Address.OPERATING_MODE] != dxl.CURRENT_MODE:
            raise ProtocolMismatch(f"{self._where}: Operating Mode stays {before} after 0 (current control) was "
                                   "written; set it with DYNAMIXEL Wizard 2.0")

    def _own_limits(self) -> DriveLimits:
        rpm = dxl.unsigned(self.table, Address.VELOCITY_LIMIT, 4) * dxl.VELOCITY_RPM
        speed = rpm / 60.0 * 2.0 * math.pi / abs(self.wiring.turns)
        return DriveLimits(0, int(Reaction.LIMP), speed, math.nan, math.nan)

    # -- a sample ------------------------------------------------------------------------------------------

    def poll(self) -> list[Received]:
        if self._silent():
            self._sleep(1e-3)
            return []
        return super().poll()

    def _silent(self) -> bool:
        """Commands have stopped: nothing may go over the line until the watchdog has acted."""
        passed = self._now_ns() - self._commanded_ns
        return self._enabled and self._watchdog_ns - self._bus_ns <= passed < self._watchdog_ns + SILENCE_MARGIN_NS

    def _attend(self) -> None:
        if not self._asked_ns:
            self._flush()

    def _ask(self) -> None:
        self._decoder.clear()
        self._flush(dxl.read(self.wiring.node, FIRST, SIZE))

    def _hear(self, chunk: bytes) -> Reading | None:
        found = self._status(chunk, SIZE)
        if found is None:
            return None
        ram: bytes = found.params
        faults = self._faults(ram)
        on = bool(ram[Address.TORQUE_ENABLE - FIRST])
        if faults and on:
            self._post(self._torque_off(), now=True)  # not every error turns it off
        self._tick = dxl.unsigned(ram, Address.REALTIME_TICK - FIRST, 2)
        goal = dxl.signed(ram, Address.GOAL_CURRENT - FIRST, 2)
        position = dxl.signed(ram, Address.PRESENT_POSITION - FIRST, 4)
        current = dxl.signed(ram, Address.PRESENT_CURRENT - FIRST, 2) * self.model.current_a
        self._flush()
        return Reading(
            driving=on and not faults, faults=faults, knee_rad=self.joint_rad(position / dxl.COUNTS),
            current_a=self.signed(current), torque_cmd_nm=self._echoed(goal) if on and not faults else 0.0,
            bus_v=0.1 * dxl.unsigned(ram, Address.PRESENT_INPUT_VOLTAGE - FIRST, 2),
            motor_degc=float(ram[Address.PRESENT_TEMPERATURE - FIRST]),
            code=float(ram[Address.HARDWARE_ERROR_STATUS - FIRST]))

    def _received(self, reading: Reading, asked_ns: int, host_ns: int) -> list[Received]:
        """Nothing where the realtime tick stands still: then the reading is an old one."""
        middle_ms = (asked_ns + host_ns) * 0.5e-6
        out: list[Received] = []
        if self._counted and middle_ms - self._counted[-1][0] > LONG_AGO_MS:
            self._counted.clear()  # it may have wrapped unseen
        if self._counted:
            then_ms, then = self._counted[0]
            passed, counted = middle_ms - then_ms, (self._tick - then) % dxl.TICK_WRAP
            allowed = TICK_SLACK_MS + TICK_SHARE * passed + (host_ns - asked_ns) * 1e-6
            if counted - passed > allowed:  # back to zero, seen around the wrap
                out = self._reboot(host_ns)
            elif passed - counted > allowed:
                self._stale += 1
                return []
        self._counted.append((middle_ms, self._tick))
        while self._counted[-1][0] - self._counted[0][0] > TICK_SPAN_MS:
            self._counted.popleft()
        return out + super()._received(reading, asked_ns, host_ns)

    def _reboot(self, host_ns: int) -> list[Received]:
        self._reboots += 1
        self._counted.clear()
        self._boot_id = (self._boot_id + 1) % 2**32
        self.stop()
        return self._greet_again(host_ns)

    def _faults(self, ram: bytes) -> int:
        error = ram[Address.HARDWARE_ERROR_STATUS - FIRST]
        names, faults = [], 0
        for bit, fault, name in FAULTS:
            if error & bit:
                names.append(name)
                faults |= fault
        if error & HardwareError.INPUT_VOLTAGE:
            volts = dxl.unsigned(ram, Address.PRESENT_INPUT_VOLTAGE - FIRST, 2)
            high = volts > dxl.unsigned(self.table, Address.MAX_VOLTAGE_LIMIT, 2)
            names.append("input voltage")
            faults |= Fault.OVERVOLTAGE if high else Fault.UNDERVOLTAGE
        if ram[Address.BUS_WATCHDOG - FIRST] == dxl.WATCHDOG_ERROR:
            names.append("Bus Watchdog: no command came in time")
            faults |= Fault.WATCHDOG
        self.words = ", ".join([f"{self.model.name} firmware {self._firmware}", *names])
        return int(faults)

    def _echoed(self, counts: int) -> float:
        """The torque that was asked for, where these counts are what became of one [N m]."""
        for sent, torque_nm in reversed(self._asked_counts):
            if sent == counts:
                return torque_nm
        return self.signed(counts * self.model.current_a) * self.wiring.torque_constant_nm_per_a

    # -- torque --------------------------------------------------------------------------------------------

    def _enable(self, watchdog_ms: int) -> None:
        steps = max(watchdog_ms // (2 * dxl.WATCHDOG_UNIT_MS), 1)
        self._bus_ns = steps * WATCHDOG_STEP_NS
        self._watchdog_ns = max(watchdog_ms * 1_000_000, self._bus_ns + WATCHDOG_STEP_NS // 2)
        node = self.wiring.node
        self._commanded_ns = self._now_ns()
        self._post(dxl.silent_write(node, Address.BUS_WATCHDOG, b"\0")
                   + dxl.silent_write(node, Address.GOAL_CURRENT, b"\0\0")
                   + dxl.silent_write(node, Address.TORQUE_ENABLE, b"\1")
                   + dxl.silent_write(node, Address.BUS_WATCHDOG, bytes([steps])))

    def _turn(self, torque_nm: float) -> None:
        limit = dxl.unsigned(self.table, Address.CURRENT_LIMIT, 2)
        counts = round(self.signed(torque_nm / self.wiring.torque_constant_nm_per_a) / self.model.current_a)
        counts = max(-limit, min(limit, counts))
        self._asked_counts.append((counts, torque_nm))
        self._commanded_ns = self._now_ns()
        self._post(dxl.silent_write(self.wiring.node, Address.GOAL_CURRENT, struct.pack("<h", counts)))

    def _halt(self) -> None:
        self._waiting.clear()
        if self._asked_ns:
            self._waiting.append(self._torque_off())
        self._post(self._torque_off(), now=True)

    def _forget(self) -> None:
        """A watchdog's error is written away; a hardware error goes with a reboot, behind which the RAM is new."""
        node = self.wiring.node
        self._post(dxl.silent_write(node, Address.BUS_WATCHDOG, b"\0"), now=True)
        if self._latched & ~Fault.WATCHDOG:
            self._post(dxl.packet(node, dxl.Instruction.REBOOT), now=True)
            self._sleep(REBOOT_S)
        self._sleep(ANSWER_S)
        self._link.read()  # an answer under way still shows what is forgotten
        self._decoder.clear()
        self._asked_ns = 0
        self._counted.clear()

    def _torque_off(self) -> bytes:
        node = self.wiring.node
        return (dxl.silent_write(node, Address.GOAL_CURRENT, b"\0\0")
                + dxl.silent_write(node, Address.TORQUE_ENABLE, b"\0"))

    # -- the line ------------------------------------------------------------------------------------------

    def _post(self, data: bytes, now: bool = False) -> None:
        """Write `data`, now or as soon as no answer is awaited."""
        with self._lock:
            if self._asked_ns and not now:
                self._waiting = [data] if data[:9] == b"".join(self._waiting)[:9] else [*self._waiting, data]
            else:
                self._flush()
                self._write(data)

    def _flush(self, behind: bytes = b"") -> None:
        """What waits, and something behind it, in one piece."""
        with self._lock:
            data = b"".join(self._waiting) + behind
            self._waiting = []
            if data:
                self._write(data)

    def _status(self, chunk: bytes, size: int | None = None) -> dxl.Packet | None:
        """The status packet of this drive with so many bytes, where one is complete."""
        packet = None
        for one in self._decoder.feed(chunk):
            mine = one.ident == self.wiring.node and one.instruction == dxl.Instruction.STATUS
            if mine and (size is None or len(one.params) == size):
                packet = one
            elif mine:
                self._unknown += 1
        self._bad = self._decoder.bad + self._stale
        return packet


def find_nodes(link: Link[bytes], wiring: Wiring) -> list[int]:
    """Identifiers of the Dynamixels that answer, up to NODES_TRIED; each is turned off."""
    found: set[int] = set()
    for node in range(NODES_TRIED + 1):
        decoder = dxl.Decoder()
        link.write(dxl.silent_write(node, Address.TORQUE_ENABLE, b"\0") + dxl.packet(node, dxl.Instruction.PING))
        found |= {one.ident for one in decoder.feed(link.read()) if one.instruction == dxl.Instruction.STATUS}
    return sorted(found)


def open_link(wiring: Wiring) -> Link[bytes]:
    """The serial line. Raises a `DriverError`."""
    if wiring.can is not None:
        raise DeviceAbsent("[devices.controller] can: a Dynamixel is on a serial line; give port and baud")
    return open_port(wiring.port, wiring.baud)


attach = DynamixelDrive
"""The Dynamixel behind a link, not yet greeted."""
