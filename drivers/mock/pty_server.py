"""An emulated controller on a real pseudo-terminal, which pyserial opens by path like any port."""

from __future__ import annotations

import os
import select
import threading
import time
import tty

from drivers.closing import Closing
from drivers.mock.clock import Clock, RealClock
from drivers.mock.link import SerialDevice

WAKE_S = 0.001
SEND_AHEAD_NS = 50_000
"""What is due this soon is handed to the kernel now: an answer must not wait for the next turn."""
LAST_WORD_S = 0.02
"""How long the kernel may take over what was written just before the plug was pulled."""


class PtyServer(Closing):
    """Serves a device in real time from a thread of its own until `close`, which is also how one unplugs it."""

    def __init__(self, device: SerialDevice, clock: Clock | None = None) -> None:
        self._device, self._clock = device, clock or RealClock()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        """Path of the port."""
        self.failure: BaseException | None = None
        """What ended the serving thread early; `close` raises it."""
        self._running = True
        self._thread = threading.Thread(target=self._serve, name="pty-server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplug: readers of the port see it vanish. May be called twice."""
        if not self._running:
            return
        self._running = False
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)
        if self.failure is not None:
            raise self.failure

    def _serve(self) -> None:
        try:
            while self._running:
                self._turn()
            end = time.monotonic() + LAST_WORD_S
            while (left := end - time.monotonic()) > 0.0:  # on the wire before the plug was pulled: a Stop, often
                self._hear(left)
        except BaseException as error:
            self.failure = error

    def _hear(self, wait_s: float) -> None:
        """Hand over the bytes that come in; waits for the first."""
        readable, _, _ = select.select([self._master], [], [], wait_s)
        if readable:
            self._device.receive(os.read(self._master, 65536), self._clock.now_ns())

    def _turn(self) -> None:
        """Bytes that came in go to the device before its time moves on: a late thread must not starve it."""
        self._hear(WAKE_S)
        now = self._clock.now_ns()
        data = b"".join(frame for _, frame in self._device.transmit(now + SEND_AHEAD_NS))
        try:
            while data:
                data = data[os.write(self._master, data):]
        except BlockingIOError:
            return  # nobody reads the port: the bytes are lost, as on a real UART
