"""Common parts of emulated I2C chips: transfers, time on the wire, failures on demand; and a bus of several chips."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from drivers.mock.clock import Clock

NO_ACKNOWLEDGE = 121


class MockChip:
    """A chip and the bus it is alone on: `i2c_rdwr` takes smbus2 messages, time passes as on the wire.

    A subclass says what registers read (`read`) and take (`receive`). `advance(t_ns)` brings the world up to a time;
    it is called before every transfer.
    """

    def __init__(self, clock: Clock, address: int, advance: Callable[[int], None] = lambda t_ns: None,
                 bus_khz: float = 400.0, lock: threading.RLock | None = None) -> None:
        self.address = address
        self.closed = False
        self.held_at: int | None = None
        """A byte that every read brings, whatever the chip says: lines that are held low (0) or not at all (255)."""
        self._clock, self._advance, self._bus_khz = clock, advance, bus_khz
        self._lock = lock or threading.RLock()
        self._failures: deque[tuple[int, int]] = deque()
        self._pointer = 0

    def fail(self, errno: int, times: int = 1, after_bytes: int = 0) -> None:
        """The next `times` transfers raise OSError(errno), a read after `after_bytes` went over the wire."""
        self._failures.extend([(errno, after_bytes)] * times)

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """One transaction of smbus2 messages. Raises OSError 121 for another address, or what `fail` asked for."""
        # A register is latched when its turn comes on the wire: after the addresses and what is written.
        lead = sum(1 + message.len for message in i2c_msgs) - (i2c_msgs[-1].len if i2c_msgs else 0)
        self._clock.sleep(lead * 9 / (self._bus_khz * 1e3))
        with self._lock:
            self._advance(self._clock.now_ns())
            moved = self._transact(i2c_msgs)
        self._clock.sleep((moved - lead) * 9 / (self._bus_khz * 1e3))

    def close(self) -> None:
        """The bus handle is let go of; the chip runs on."""
        self.closed = True

    def _transact(self, messages: Sequence[Any]) -> int:
        """Bytes that went over the wire, addresses included."""
        if any(message.addr != self.address for message in messages):
            raise OSError(NO_ACKNOWLEDGE, "no acknowledge")
        errno, good_bytes = self._failures.popleft() if self._failures else (0, 0)
        if errno and not good_bytes:
            raise OSError(errno, "injected")
        for message in messages:
            if not message.flags & 1:
                data = bytes(message)
                if data:
                    self._pointer = data[0]
                    self.receive(data[0], data[1:])
                continue
            found = self.read(self._pointer, min(message.len, good_bytes) if errno else message.len)
            for i in range(len(found)):
                message.buf[i] = found[i:i + 1] if self.held_at is None else bytes([self.held_at])
        if errno:
            raise OSError(errno, "injected")
        return sum(1 + message.len for message in messages)

    def receive(self, register: int, data: bytes) -> None:
        """Bytes written from `register` on; none: the pointer was set."""
        raise NotImplementedError

    def read(self, register: int, count: int) -> bytes:
        """`count` bytes from `register` on."""
        raise NotImplementedError


class MockBus:
    """Several emulated chips on one bus: a transaction goes to the chip of its first message's address."""

    def __init__(self, chips: Sequence[Any]) -> None:
        self._chips = {chip.address: chip for chip in chips}
        self._lock = threading.Lock()

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Raises OSError 121 where no chip has the address."""
        chip = self._chips.get(i2c_msgs[0].addr)
        if chip is None:
            raise OSError(NO_ACKNOWLEDGE, "no acknowledge")
        with self._lock:
            chip.i2c_rdwr(*i2c_msgs)

    def close(self) -> None:
        """Let go of all chips."""
        for chip in self._chips.values():
            chip.close()
