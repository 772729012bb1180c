"""A bus object of the mock layer behind a real /dev/i2c-N: the kernel's requests are answered by a thread here."""

import os
import select
import threading
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from smbus2 import i2c_msg

READ = 1


class ServedBus(ABC):
    """Serves `bus` (an object with smbus2's `i2c_rdwr`) as `path` until `close`: the adapter pulled out."""

    path: str

    def __init__(self, bus: Any, device: str | Path) -> None:
        self._bus, self._fd = bus, os.open(device, os.O_RDWR)
        self._wake, self._waker = os.pipe()

    def start(self) -> None:
        """Begin to serve, and wait until the device node is there."""
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        for _ in range(1000):
            if Path(self.path).exists():
                return
            threading.Event().wait(0.01)
        raise TimeoutError(self.path)

    def close(self) -> None:
        """The adapter is gone from the machine, whoever has it open; may be called twice."""
        if not self._thread.is_alive():
            return
        os.write(self._waker, b"x")
        self._thread.join()
        os.close(self._wake)
        os.close(self._waker)

    def transfer(self, heads: list[tuple[int, int, int]], written: bytes) -> bytes:
        """What is read by messages of (address, flags, length), whose bytes to write stand one after the other."""
        messages, at = [], 0
        for address, flags, length in heads:
            if flags & READ:
                messages.append(i2c_msg.read(address, length))
            else:
                messages.append(i2c_msg.write(address, written[at: at + length]))
                at += length
        self._bus.i2c_rdwr(*messages)
        return b"".join(bytes(m) for m in messages if m.flags & READ)

    def _serve(self) -> None:
        try:
            while self._wake not in select.select([self._fd, self._wake], [], [])[0]:
                self._answer(os.read(self._fd, 1 << 19))
        finally:
            os.close(self._fd)

    @abstractmethod
    def _answer(self, request: bytes) -> None:
        """Answer one request of the kernel's."""
