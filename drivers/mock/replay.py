"""A recorded run as devices: the frames and registers that were read, at the times at which they were read.

Nothing runs in a thread. Whoever plays the recording (`experiments.emulation`) moves the clock to the next thing
that the recorder did, lets the device have ready what it brought then, and has the driver fetch it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from drivers import lsm9ds1_registers as reg
from drivers.mock.clock import VirtualClock
from drivers.mock.lsm9ds1 import MockLsm9ds1
from drivers.protocol import Decoder, Fault, FaultReport, Hello, HelloRequest, Message, Pong, Telemetry, encode

SETTLE_STEP_NS = 1_000_000
BUS_ERRORS = re.compile(r"bus errors \[errno (\d+)\]")


class ReplayLink:
    """A `Link` with no device behind it: it answers the handshake, and gives what is put into it. Torque commands,
    arming and stopping go nowhere."""

    def __init__(self, hello: Hello, clock: VirtualClock) -> None:
        self.facts: dict[str, Any] = {}
        """What the recorded link said of itself."""
        self._hello, self._clock = hello, clock
        self._ready = b""
        self._decoder = Decoder()

    def put(self, messages: Sequence[Message]) -> None:
        """Set the bytes of the next read."""
        self._ready += b"".join(map(encode, messages))

    def read(self) -> bytes:
        """The bytes that were put in; an empty read takes a millisecond."""
        if not self._ready:
            self._clock.sleep(0.001)
        data, self._ready = self._ready, b""
        return data

    def write(self, data: bytes) -> None:
        """A request for a Hello is answered; everything else is for nobody."""
        if any(isinstance(message, HelloRequest) for message in self._decoder.feed(data)):
            self.put([self._hello])

    def close(self) -> None:
        """Do nothing: a replay holds no device."""


class ReplayBus:
    """The I2C bus with the chip whose recorded samples are drained again. Transfers take no time, but for the read of
    the fill level, which takes what it took."""

    def __init__(self, clock: VirtualClock, address: int = 0x6B) -> None:
        self._clock = clock
        self._chip = MockLsm9ds1(VirtualClock(), address=address)
        self._after_ns: int | None = None
        self._fillers = reg.SETTLE_SAMPLES
        self._filled_ns = clock.now_ns()

    def put(self, raw: Sequence[Sequence[int]], after_ns: int, gap: bool) -> None:
        """`raw` (n, 6) LSB are what the next drain finds; its fill level has been read at `after_ns`.

        `gap`: samples before them were lost.
        """
        for sample in raw:
            self._chip.push(sample)
        if gap:
            self._chip.mark_overrun()
        self._after_ns = after_ns

    def fail(self, reason: str) -> bool:
        """Fail once as the reason of a recorded gap says; False where it is no failure of the bus."""
        found = BUS_ERRORS.match(reason)
        if found:
            self._chip.fail(int(found[1]), times=4)
        return found is not None

    def fill(self) -> None:
        """A sample that the driver will throw away, as the first after the FIFO was restarted."""
        self._chip.push([0] * 6)

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """One transaction of smbus2 messages."""
        if self._fillers and self._chip.streaming:
            self._settle()
        self._chip.i2c_rdwr(*i2c_msgs)
        level = len(i2c_msgs) == 2 and bytes(i2c_msgs[0])[:1] == bytes([reg.FIFO_CTRL]) and i2c_msgs[1].len == 2
        if level and self._after_ns is not None:
            self._clock.advance_to(self._after_ns)

    def _settle(self) -> None:
        """A chip that was just configured has samples that a driver throws away; the recording holds none."""
        now = self._clock.now_ns()
        if now - self._filled_ns >= SETTLE_STEP_NS and not self._chip.level:
            self._filled_ns = now
            self._fillers -= 1
            self.fill()

    def close(self) -> None:
        """Do nothing: a replay holds no device."""


def frames(row: Any) -> Telemetry:
    """The frame behind one record of telemetry."""
    names = Telemetry.__dataclass_fields__
    return Telemetry(**{name: row[name].item() for name in names})


def pong(row: Any) -> Pong:
    """The answer behind one record of a clock probe."""
    return Pong(int(row["ping_id"]), int(row["rx_tick_us"]), int(row["tx_tick_us"]))


def rebooted(hello: Hello, boot_id: int) -> Hello:
    """Hello of the same controller after a restart."""
    return replace(hello, boot_id=boot_id)


def fault_report(text: str) -> Iterator[FaultReport]:
    """The report behind a recorded event, `overspeed, value 41.2`; nothing where it says none."""
    name, _, value = text.rpartition(", value ")
    for fault in Fault:
        if fault.name and fault.name.lower().replace("_", " ") == name:
            yield FaultReport(0, int(fault), int(fault), float(value))
