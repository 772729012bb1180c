"""A recorded run as devices: the same frames and the same raw samples, through the same link and bus objects.

The streams are given as the recorder keeps them: numpy structured arrays (or mappings of arrays) with these fields.
telemetry: `host_ns`, `boot_id` and the fields of `protocol.Telemetry`. imu, one row a sample: `drain_before_ns`,
`drain_after_ns`, `gap_before`, `gyro_x` ... `accel_z` (raw counts). probes: `host_tx_ns`, `host_rx_ns`,
`rx_tick_us`, `tx_tick_us`.

Time is virtual and is the recording's own: once both devices have been opened the clock jumps to the first
recorded event. A ping is answered as the recorded one next to it was, moved to the time at which it is asked.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.lsm9ds1 import ImuConfig
from drivers.lsm9ds1_registers import SETTLE_SAMPLES
from drivers.mock.clock import VirtualClock
from drivers.mock.imu_times import latch_times
from drivers.mock.lsm9ds1 import MockLsm9ds1
from drivers.protocol import Decoder, Hello, HelloRequest, Ping, Pong, Telemetry, encode

Stream = NDArray[np.void] | Mapping[str, NDArray[Any]]
AXES = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
AHEAD_NS = 1_000_000
MARGIN_NS = 10_000_000
LEAD_NS = 5_000_000_000
"""The clock starts this long before the first event: time to open the devices in."""


class ReplayRig:
    """`imu` is the I2C bus object, `firmware` the device to hand to an `EmulatorLink` (with no delay of its own)."""

    def __init__(self, telemetry: Stream, imu: Stream | None, probes: Stream, hello: Hello,
                 imu_config: ImuConfig | None = None, address: int = 0x6B, bus_khz: float = 400.0) -> None:
        config = imu_config or ImuConfig()
        first = [int(telemetry["host_ns"][0])]
        if imu is not None:
            first.append(int(imu["drain_before_ns"][0]))
        self.first_ns = min(first) - MARGIN_NS
        """Host time at which the recording starts, just before its first event."""
        self.end_ns = int(telemetry["host_ns"][-1])
        """Host time of the last frame: nothing comes after it."""
        self.clock = VirtualClock(self.first_ns - LEAD_NS)
        self.firmware = ReplayController(telemetry, probes, hello, self._opened)
        self.imu = MockLsm9ds1(self.clock, self._feed, address, bus_khz)
        self._samples = None if imu is None else _ImuStream(imu, config, self.imu)

    def _feed(self, t_ns: int) -> None:
        if self._samples is not None:
            self._samples.feed(t_ns)
        self._opened()

    def _opened(self) -> None:
        """Both devices open: skip the rest of the lead."""
        if self.firmware.greeted and (self._samples is None or self._samples.settled):
            self.clock.advance_to(self.first_ns)


class _ImuStream:
    """Recorded samples into the chip's FIFO, each at the time at which it was latched."""

    def __init__(self, imu: Stream, config: ImuConfig, chip: MockLsm9ds1) -> None:
        self._chip = chip
        self._raw = np.column_stack([np.asarray(imu[axis], np.int16) for axis in AXES])
        self._gap = np.asarray(imu["gap_before"], bool)
        self._due = latch_times(np.asarray(imu["drain_before_ns"], np.int64),
                                np.asarray(imu["drain_after_ns"], np.int64), self._gap, 1e9 / config.rate_hz)
        self._period_ns = round(1e9 / config.rate_hz)
        self._next = 0
        self._fillers = SETTLE_SAMPLES
        self._filler_due: int | None = None

    @property
    def settled(self) -> bool:
        """The samples that a driver throws away after power-up have been taken."""
        return not self._fillers and not self._chip.level

    def feed(self, t_ns: int) -> None:
        """Push what was latched up to `t_ns`. A gap shows as an overrun, once what came before it is drained."""
        if self._fillers:
            self._settle(t_ns)
            return
        while self._next < len(self._due) and self._due[self._next] <= t_ns:
            if self._gap[self._next] and self._next:
                if self._chip.level:
                    return
                self._chip.mark_overrun()
            self._chip.push(self._raw[self._next].tolist())
            self._next += 1

    def _settle(self, t_ns: int) -> None:
        """The recording holds no settling samples; a chip that was just configured has them all the same."""
        if not self._chip.streaming:
            self._filler_due = None
            return
        self._filler_due = t_ns if self._filler_due is None else self._filler_due
        while self._fillers and self._filler_due + self._period_ns <= t_ns:
            self._filler_due += self._period_ns
            self._fillers -= 1
            self._chip.push(self._raw[0].tolist())


class ReplayController:
    """The recorded frames up, each at the host time at which it was read; answers Hello and Ping."""

    def __init__(self, telemetry: Stream, probes: Stream, hello: Hello, opened: Callable[[], None]) -> None:
        self.greeted = False
        self._hello, self._opened = hello, opened
        self._telemetry, self._next = telemetry, 0
        self._boots = np.asarray(telemetry["boot_id"])
        self._host_ns = np.asarray(telemetry["host_ns"], np.int64)
        self._probes = {name: np.asarray(probes[name], np.int64)
                        for name in ("host_tx_ns", "host_rx_ns", "rx_tick_us", "tx_tick_us")}
        self._names = [f.name for f in fields(Telemetry)]
        self._decoder = Decoder()
        self._answers: deque[tuple[int, bytes]] = deque()

    def receive(self, data: bytes, t_ns: int) -> None:
        """Bytes from the host; torque, arming and stopping were decided when the run was recorded."""
        for message in self._decoder.feed(data):
            if isinstance(message, HelloRequest):
                self.greeted = True
                self._answers.append((t_ns, encode(self._hello)))
                self._opened()
            elif isinstance(message, Ping) and len(self._probes["host_tx_ns"]):
                self._answers.append(self._pong(message.ping_id, t_ns))

    def post(self, data: bytes, t_ns: int) -> None:
        """The same for bytes that will be there at `t_ns`."""
        self.receive(data, t_ns)

    def transmit(self, until_ns: int) -> list[tuple[int, bytes]]:
        """(host time, frame) recorded or answered, in order of time.

        They are handed out ahead of time, so that a waiting link knows to the nanosecond when to wake.
        """
        out = list(self._answers)
        self._answers.clear()
        stop = int(np.searchsorted(self._host_ns, until_ns + AHEAD_NS, side="right"))
        for row in range(self._next, stop):
            out.extend(self._frames(row))
        self._next = max(self._next, stop)
        return sorted(out, key=lambda item: item[0])

    def _frames(self, row: int) -> list[tuple[int, bytes]]:
        t_ns, frames = int(self._host_ns[row]), []
        boot_id = int(self._boots[row])
        if boot_id != self._hello.boot_id:
            self._hello = replace(self._hello, boot_id=boot_id)
            frames.append((t_ns, encode(self._hello)))
        values = (self._telemetry[name][row].item() for name in self._names)
        frames.append((t_ns, encode(Telemetry(*values))))
        return frames

    def _pong(self, ping_id: int, t_ns: int) -> tuple[int, bytes]:
        p = self._probes
        near = int(np.argmin(np.abs(p["host_tx_ns"] - t_ns)))
        moved_us = round((t_ns - p["host_tx_ns"][near]) / 1000 * self._ticks_per_us(near))
        ticks = [int(p[name][near] + moved_us) % 2**32 for name in ("rx_tick_us", "tx_tick_us")]
        took_ns = int(p["host_rx_ns"][near] - p["host_tx_ns"][near])
        return t_ns + took_ns, encode(Pong(ping_id, *ticks))

    def _ticks_per_us(self, near: int) -> float:
        """Rate of the MCU's clock against the host's around a probe; 1 where two probes do not tell."""
        tx, ticks = self._probes["host_tx_ns"], self._probes["rx_tick_us"]
        a, b = max(0, near - 8), min(len(tx) - 1, near + 8)
        if tx[b] <= tx[a]:
            return 1.0
        rate = float(((ticks[b] - ticks[a]) % 2**32) * 1000 / (tx[b] - tx[a]))
        return rate if abs(rate - 1) < 1e-3 else 1.0
