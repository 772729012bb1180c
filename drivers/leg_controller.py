"""The leg controller over any link: handshake, telemetry up, torque and safety down.

Every way out stops the motor: `close`, leaving a `with` block, a failed handshake, a command refused here.
Should the link itself be gone, the firmware's watchdog does it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from drivers.closing import LinkHolder
from drivers.drive import Capabilities, LinkStats, Received
from drivers.errors import DeviceAbsent, DeviceFault, DriverError, ProtocolMismatch
from drivers.fault_remedy import fault_remedy
from drivers.link import Codec, Link
from drivers.protocol import (
    VERSION,
    WATCHDOG_MS_MAX,
    WATCHDOG_MS_MIN,
    Arm,
    ClearFaults,
    Decoder,
    Down,
    DriveLimits,
    Feature,
    Heartbeat,
    Hello,
    HelloRequest,
    LimitsRequest,
    Ping,
    Stop,
    Telemetry,
    TimedCommand,
    TorqueCommand,
    describe_faults,
)

HELLO_EVERY_NS = 100_000_000


class LegController(LinkHolder):
    """One leg controller: the `Drive` of our own firmware.

    `codec` fits the link: the serial framing unless another is given.
    """

    def __init__(self, link: Link[Any], now_ns: Callable[[], int] = time.monotonic_ns,
                 codec: Codec[Any] | None = None) -> None:
        self.hello: Hello | None = None
        """What the firmware said of itself last."""
        self.telemetry: Telemetry | None = None
        """The newest telemetry seen."""
        self.limits: DriveLimits | None = None
        """What the drive itself checks, asked for when arming; None where its firmware does not say."""
        self.capabilities = Capabilities()
        self.words = self.refusal = ""
        self._link = link
        self._now_ns = now_ns
        self._codec: Codec[Any] = codec or Decoder()
        self._write_lock = threading.Lock()
        self._bytes_in = self._reboots = 0
        self._command_seq = self._ping_id = 0

    def open(self, timeout_s: float = 2.0) -> Hello:
        """Stop the motor, shake hands. Raises `DeviceAbsent` (no answer) or `ProtocolMismatch`; both close."""
        try:
            return self._shake_hands(timeout_s)
        except BaseException:
            self.close()
            raise

    def _shake_hands(self, timeout_s: float) -> Hello:
        self.stop()
        deadline, ask_at = self._now_ns() + round(timeout_s * 1e9), 0
        while (now := self._now_ns()) < deadline:
            if now >= ask_at:
                self._send(HelloRequest())
                ask_at = now + HELLO_EVERY_NS
            for message, *_ in self.poll():
                if isinstance(message, Hello):
                    return message
        raise DeviceAbsent(f"leg controller: no answer within {timeout_s:g} s ({self._bytes_in} {self._codec.unit} "
                           "came, none a Hello); check port, baud rate and that the firmware runs")

    def poll(self) -> list[Received]:
        """One read of the link: what it brought, stamped with the time of its return.

        Raises `LinkLost`, and `ProtocolMismatch` at a Hello of another version: nothing that is said then is clear.
        """
        chunk = self._link.read()
        host_ns = self._now_ns()
        self._bytes_in += len(chunk)
        received = [Received(message, host_ns) for message in self._codec.feed(chunk)]
        for message, *_ in received:
            if isinstance(message, Telemetry):
                self.telemetry = message
            elif isinstance(message, Hello):
                if message.version != VERSION:
                    raise ProtocolMismatch(f"leg controller speaks protocol version {message.version}, this "
                                           f"program version {VERSION}; flash matching firmware")
                if self.hello is not None and message.boot_id != self.hello.boot_id:
                    self._reboots += 1
                    self.limits = None
                self.hello = message
            elif isinstance(message, DriveLimits):
                self.limits = message
            elif isinstance(message, Heartbeat) and self.hello and message.boot_id != self.hello.boot_id:
                self._send(HelloRequest())  # restarted, and its Hello did not come through
        return received

    def arm(self, watchdog_ms: int) -> None:
        """Ask for ARMED; the state in the telemetry that follows says whether it was granted.

        Raises `DeviceFault` when faults are latched, ValueError when the time is outside the protocol's range.
        """
        longest = self.hello.watchdog_ms if self.hello else WATCHDOG_MS_MAX
        if not WATCHDOG_MS_MIN <= watchdog_ms <= longest:
            raise ValueError(f"watchdog of {watchdog_ms} ms is outside {WATCHDOG_MS_MIN} to {longest} ms")
        if self.telemetry is not None and self.telemetry.faults:
            self.stop()
            raise DeviceFault(f"leg controller has latched: {describe_faults(self.telemetry.faults)}; "
                              f"{fault_remedy(self.telemetry.faults)}")
        self._send(LimitsRequest())
        self._send(Arm(watchdog_ms))

    def command(self, torque_nm: float) -> int:
        """Ask for a joint torque [N m] and feed the watchdog; returns the command's sequence number.

        A drive that understands it is told which telemetry this answers, and ignores what answers an old one.
        A torque that is not a number or above the firmware's limit stops the motor and raises `DriverError`.
        """
        limit = self.hello.torque_limit_nm if self.hello else 0.0
        if not math.isfinite(torque_nm) or abs(torque_nm) > limit:
            self.stop()
            raise DriverError(f"leg controller: torque of {torque_nm:g} N m is beyond the firmware's limit of "
                              f"{limit:g} N m; motor stopped")
        seq = self._command_seq
        self._command_seq = (seq + 1) % 65536
        seen = self.telemetry
        if seen is not None and self.limits is not None and self.limits.features & Feature.TIMED_COMMANDS:
            self._send(TimedCommand(seq, torque_nm, seen.seq))
        else:
            self._send(TorqueCommand(seq, torque_nm))
        return seq

    def ping(self) -> tuple[int, int]:
        """Send a clock probe; returns its id and the host time just before it was written [ns]."""
        ping_id = self._ping_id
        self._ping_id = (ping_id + 1) % 65536
        frame = self._codec.encode(Ping(ping_id))
        with self._write_lock:
            host_tx_ns = self._now_ns()
            self._link.write(frame)
        return ping_id, host_tx_ns

    def stop(self) -> None:
        """Torque zero and disarm."""
        with self._write_lock:
            self._link.write(self._codec.cut + self._codec.encode(Stop()))

    def clear_faults(self) -> None:
        """Stop, then ask for the latched faults to be cleared; the telemetry that follows says if they were."""
        self.stop()
        self._send(ClearFaults())
        self.telemetry = None  # its faults are out of date from here on

    @property
    def stats(self) -> LinkStats:
        """Counts so far."""
        d = self._codec
        return LinkStats(d.bad_crc, d.bad_length, d.unknown, d.lost, self._reboots)

    def _send(self, message: Down) -> None:
        frame = self._codec.encode(message)
        with self._write_lock:
            self._link.write(frame)

