"""An emulated controller as an in-process link on any clock, with the delays of a cable."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import numpy as np

from drivers.errors import LinkLost
from drivers.mock.clock import Clock

COARSE_NS, FINE_NS = 250_000, 20_000
"""How often a waiting read looks: finely while the device may be answering, since a real read returns with the first
byte of the answer."""
ANSWER_NS = 150_000
TIMEOUT_NS = 1_000_000


class SerialDevice(Protocol):
    """Whatever stands at the far end of the cable: the firmware emulator, or a recording of one."""

    def receive(self, data: Any, t_ns: int) -> None:
        """A chunk that is there now; its last byte came in at `t_ns`."""

    def post(self, data: Any, t_ns: int) -> None:
        """A chunk under way that will be there at `t_ns`."""

    def transmit(self, until_ns: int) -> list[tuple[int, Any]]:
        """(time, chunk) of what left the device up to `until_ns`, in order, each once."""


class EmulatorLink:
    """A `Link` to a device. `read` waits on the clock, so a virtual one moves while somebody waits.

    Each way takes `delay_s` and an exponential extra of mean `jitter_s`; order is kept. `nothing` is an empty chunk:
    `()` for a device on CAN.
    """

    def __init__(self, device: SerialDevice, clock: Clock, delay_s: float = 0.0003,
                 jitter_s: float = 0.0001, seed: int = 0, nothing: Any = b"") -> None:
        self._device, self._clock = device, clock
        self._delay_s, self._jitter_s = delay_s, jitter_s
        self._rng = np.random.default_rng(seed)
        self._up: deque[tuple[int, Any]] = deque()
        self._down_last = self._up_last = 0
        self._lost = False
        self._nothing = nothing
        device.transmit(clock.now_ns())  # said before anybody listened

    def read(self) -> Any:
        """Bytes that have arrived; waits up to the timeout for some. Raises `LinkLost` once unplugged."""
        deadline = self._clock.now_ns() + TIMEOUT_NS
        while not (data := self._arrived()):
            now = self._clock.now_ns()
            if now >= deadline:
                break
            answering = self._down_last <= now < self._down_last + ANSWER_NS
            wake = min(deadline, now + (FINE_NS if answering else COARSE_NS))
            if now < self._down_last:
                wake = min(wake, self._down_last)
            if self._up:
                wake = min(wake, max(self._up[0][0], now + 1))
            self._clock.sleep((wake - now) * 1e-9)
        return data

    def write(self, data: Any) -> None:
        """On its way to the device. Raises `LinkLost` once unplugged."""
        self._check()
        now = self._clock.now_ns()
        self._take(now)
        self._down_last = max(self._down_last, now + self._delay_ns())
        self._device.post(data, self._down_last)

    def close(self) -> None:
        """Close the link; bytes already written still arrive."""
        self._lost = True

    def unplug(self) -> None:
        """Pull the cable: the device runs on alone."""
        self._lost = True

    def _check(self) -> None:
        if self._lost:
            raise LinkLost("leg controller on the emulated link: the connection is gone; check cable and power")

    def _arrived(self) -> Any:
        self._check()
        now, data = self._clock.now_ns(), self._nothing
        self._take(now)
        while self._up and self._up[0][0] <= now:
            data += self._up.popleft()[1]
        return data

    def _take(self, until_ns: int) -> None:
        for t_ns, frame in self._device.transmit(until_ns):
            self._up_last = max(self._up_last, t_ns + self._delay_ns())
            self._up.append((self._up_last, frame))

    def _delay_ns(self) -> int:
        return round((self._delay_s + self._jitter_s * self._rng.exponential()) * 1e9)
