"""An emulated controller as a node on a python-can bus, in real time."""

from __future__ import annotations

import threading

import can

from drivers.can_frame import CanFrame
from drivers.closing import Closing
from drivers.mock.clock import Clock, RealClock
from drivers.mock.link import SerialDevice
from drivers.mock.pty_server import SEND_AHEAD_NS

WAKE_S = 0.001


class CanServer(Closing):
    """Serves a device whose chunks are CAN frames from a thread of its own until `close`, which also ends the bus."""

    def __init__(self, device: SerialDevice, bus: can.BusABC, clock: Clock | None = None) -> None:
        self._device, self._bus, self._clock = device, bus, clock or RealClock()
        self.failure: BaseException | None = None
        """What ended the serving thread early; `close` raises it."""
        self._running = True
        self._thread = threading.Thread(target=self._serve, name="can-server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the bus. May be called twice."""
        if not self._running:
            return
        self._running = False
        self._thread.join()
        self._bus.shutdown()
        if self.failure is not None:
            raise self.failure

    def _serve(self) -> None:
        try:
            while self._running:
                self._turn()
            self._hear(0.0)  # on the bus before the node left it: a Stop, often
        except BaseException as error:
            self.failure = error

    def _hear(self, wait_s: float) -> None:
        message = self._bus.recv(wait_s)
        while message is not None:
            if not message.is_error_frame:
                frame = CanFrame(message.arbitration_id, bytes(message.data), message.is_extended_id, message.is_fd,
                                 message.is_remote_frame)
                self._device.receive((frame,), self._clock.now_ns())
            message = self._bus.recv(0)

    def _turn(self) -> None:
        self._hear(WAKE_S)
        for _, frames in self._device.transmit(self._clock.now_ns() + SEND_AHEAD_NS):
            for frame in frames:
                self._bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data,
                                           is_extended_id=frame.extended, is_fd=frame.fd, bitrate_switch=frame.fd))
