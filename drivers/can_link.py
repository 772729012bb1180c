"""A CAN bus as the controller's transport. python-can below, nothing of the protocol but its identifiers in here.

Interface, channel and bit rate are python-can's own configuration: socketcan, slcan, virtual, udp_multicast or any
other that it knows. Time stamps of the bus are not used: the controller's tick travels in the frames.
"""

from __future__ import annotations

import errno
from contextlib import suppress
from typing import Any, NamedTuple

import can

from drivers.can_frame import NODE_BITS, NODES, ONE_MESSAGE, CanFrame, Frames
from drivers.errors import DeviceAbsent, DeviceBusy, DriverError, LinkLost
from drivers.exclusive import lock_name

SEND_TIMEOUT_S = 0.1
FRAMES_AT_ONCE = 256
BUS_OFF = 0x40
"""Error class in the identifier of an error frame (linux/can/error.h)."""
DEFAULTS: dict[str, dict[str, Any]] = {"slcan": {"sleep_after_open": 0.2}}
"""python-can sleeps 2 s on opening a slcan adapter."""
_DOWN = "is down; bring it up: ip link set {channel} up type can bitrate 1000000"
_GONE = "is gone; plug the adapter in again"
_MEANING = {errno.ENETDOWN: _DOWN, errno.ENODEV: _GONE, errno.ENXIO: _GONE,
            errno.ENOBUFS: "takes no more frames; is anybody else on the bus, and is it terminated?"}


class CanFilter(NamedTuple):
    """Identifiers that agree with `can_id` in the bits of `can_mask`; `extended` None: of either length."""

    can_id: int
    can_mask: int
    extended: bool | None = False


class CanLink:
    """One node's frames on a CAN bus.

    `config` goes to `can.Bus` as it is. Raises `DeviceAbsent` when the bus cannot be opened, `LinkLost` when it goes
    away later, is taken down, or the controller chip went bus-off.
    """

    def __init__(self, node: int = 0, timeout_s: float = 0.02, accept: CanFilter | None = None, fd: bool = False,
                 **config: Any) -> None:
        """`accept`: the identifiers that are this node's business, those of firmware_protocol.md by default. `fd`: CAN
        FD, where `brs = false` among the configuration leaves the bit rate as it is during the data."""
        if not 0 <= node < NODES:
            raise ValueError(f"CAN node {node} is outside 0 to {NODES - 1}")
        self.errors = 0
        """Error frames seen, other than bus-off."""
        self.other_frames = 0
        """Frames left out: remote, and on a classic bus extended or CAN FD."""
        self.where = f"leg controller on CAN {config.get('channel', '')}".rstrip()
        self._channel, self._timeout_s = config.get("channel", "can0"), timeout_s
        self._node = node
        self._failure: LinkLost | None = None
        self._fd, self._brs = fd, fd and bool(config.pop("brs", True))
        mask = accept or CanFilter(node << NODE_BITS, 0x7FF & ~ONE_MESSAGE)
        if fd:
            config = {"fd": True, **config}
        try:
            self._held = lock_name(f"can/{config.get('interface', '')}/{config.get('channel', '')}/{node}")
        except OSError:
            raise DeviceBusy(f"{self.where}: another program drives node {node}; close it") from None
        try:
            filters: Any = [{key: value for key, value in mask._asdict().items() if value is not None}]
            self._bus = can.Bus(can_filters=filters, **{**DEFAULTS.get(config.get("interface", ""), {}), **config})
        except (can.CanError, OSError, ImportError, ValueError, TypeError) as error:
            self._let_go()
            raise self._absent(error) from error

    @property
    def facts(self) -> dict[str, str | int | None]:
        """Facts about the connection, for a run file."""
        return {"kind": "can", "channel": str(self._channel), "node": self._node}

    def read(self) -> Frames:
        """The frames that arrived; blocks up to the timeout and returns () then. Raises `LinkLost`."""
        frames: list[CanFrame] = []
        try:
            message = None if self._failure else self._bus.recv(self._timeout_s)
            while message is not None:
                self._sort(message, frames)
                if len(frames) >= FRAMES_AT_ONCE:
                    break
                message = self._bus.recv(0)
        except LinkLost as error:
            self._failure = error
        except (can.CanError, OSError, ValueError, TypeError) as error:
            self._failure = self._lost(error)
        if self._failure is not None and not frames:
            raise self._failure
        return tuple(frames)  # what came before a failure is delivered first: a bus says once that it is down

    def write(self, data: Frames) -> None:
        """Hand over all frames. Raises `LinkLost`, also when the bus stops taking them."""
        for frame in data:
            message = can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=frame.extended,
                                  is_fd=frame.fd, bitrate_switch=frame.fd and self._brs, is_remote_frame=frame.remote)
            try:
                self._bus.send(message, timeout=SEND_TIMEOUT_S)
            except (can.CanError, OSError, ValueError, TypeError) as error:
                raise self._lost(error) from error

    def close(self) -> None:
        """Let go of the bus; may be called twice."""
        with suppress(can.CanError, OSError):  # the adapter went away before: nothing is left to let go of
            self._bus.shutdown()
        self._let_go()

    def _let_go(self) -> None:
        if self._held is not None:
            self._held.close()

    def _sort(self, message: can.Message, frames: list[CanFrame]) -> None:
        if message.is_error_frame:
            if message.arbitration_id & BUS_OFF:
                raise LinkLost(f"{self.where}: bus-off, the adapter has left the bus after too many errors; check "
                               "wiring, termination and bit rate, then take the interface down and up")
            self.errors += 1
        elif message.is_remote_frame or (not self._fd and (message.is_extended_id or message.is_fd)):
            self.other_frames += 1
        else:
            frames.append(CanFrame(message.arbitration_id, bytes(message.data), message.is_extended_id, message.is_fd))

    def _why(self, error: Exception) -> str:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        return _MEANING.get(number or 0, f"fails ({error})").format(channel=self._channel)

    def _absent(self, error: Exception) -> DriverError:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if number in (errno.ENODEV, errno.ENXIO):
            why = "no such interface; plug the adapter in, or correct [devices.controller.can]"
        else:
            why = f"cannot be opened ({error}); correct [devices.controller.can]"
        return DeviceAbsent(f"{self.where}: {why}")

    def _lost(self, error: Exception) -> LinkLost:
        return LinkLost(f"{self.where}: the connection is gone: the interface {self._why(error)}")
