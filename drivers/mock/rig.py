"""One emulated rig: a plant, an IMU chip and a controller on a single time line of half-millisecond steps."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from drivers.drive import Wiring
from drivers.errors import DeviceAbsent
from drivers.link import Codec
from drivers.mock.as5600 import MockAs5600
from drivers.mock.bench_drive import DriveFacts
from drivers.mock.chip import MockBus
from drivers.mock.clock import Clock, RealClock
from drivers.mock.current_shunt import MockShunt
from drivers.mock.emulator import FirmwareEmulator
from drivers.mock.imu_physics import ImuPhysics
from drivers.mock.link import SerialDevice
from drivers.mock.lsm9ds1 import MockLsm9ds1
from drivers.mock.motor import Motor
from drivers.mock.plant import Plant, Segment, Snapshot, snapshot
from drivers.mock.settings import FirmwareSettings, ImuSettings, PivotSettings, ShuntSettings
from drivers.protocol import Decoder

STEP_NS = 500_000
REMEMBERED = 8192
"""Steps of the motor's charge that are kept: a conversion of the shunt looks back over its own length."""


class EmulatedDrive(SerialDevice, Protocol):
    """A drive's far end, stepped with the leg's physics."""

    @property
    def motor(self) -> Motor:
        """Torque that it asks of the joint, and torque that acts."""

    def torque_over(self, t0_ns: int, t1_ns: int) -> float:
        """Mean joint torque [N m] in the physics step that follows."""

    def observe(self, segment: Segment) -> None:
        """Update the sensors after a step."""


DriveMaker = Callable[[FirmwareSettings, int, int, Callable[[int], None], threading.RLock], EmulatedDrive]
"""Makes an emulated drive from its settings, seed, time [ns], what brings the world up to a time, and the lock."""


def _module(kind: str) -> Any:
    """`drivers/mock/KIND_drive.py`. Raises `DeviceAbsent` where there is none."""
    module = f"{__package__}.{kind}_drive"
    if find_spec(module) is None:
        raise DeviceAbsent(f"[devices.controller] kind: no emulator of {kind}; yours is drivers/mock/{kind}_drive.py")
    return import_module(module)


def drive_facts(kind: str) -> DriveFacts:
    """Facts about a kind of drive other than legid's firmware. Raises `DeviceAbsent`."""
    facts: DriveFacts = _module(kind).FACTS
    return facts


def drive_maker(kind: str, wiring: Wiring) -> DriveMaker | None:
    """The emulator of a kind of drive, `emulate` of `drivers/mock/KIND_drive.py`; None for our own firmware. Raises
    `DeviceAbsent` where there is none."""
    if kind == "legid":
        return None
    emulate = _module(kind).emulate
    return lambda settings, *world: emulate(settings, wiring, *world)


def on_serial(kind: str, drive: EmulatedDrive) -> SerialDevice:
    """The drive behind the serial adapter that its kind has; itself where it speaks bytes."""
    adapter = None if kind == "legid" else getattr(_module(kind), "on_serial", None)
    device: SerialDevice = adapter(drive) if adapter else drive
    return device


class MockRig:
    """The devices share the plant and the clock; each transfer first brings the physics up to the time it is made.

    `imu` is the I2C bus object (with the chip on it), `drive` the controller to hand to `EmulatorLink` or
    `PtyServer`: our own firmware, unless `make` gives another. With `pivot` and `shunt` these chips are there too;
    `bus` has all of them. Thread-safe.
    """

    def __init__(self, plant: Plant, clock: Clock | None = None, imu: ImuSettings | None = None,
                 firmware: FirmwareSettings | None = None, seed: int = 0, address: int = 0x6B,
                 bus_khz: float = 400.0, codec: Callable[[], Codec[Any]] = Decoder,
                 pivot: PivotSettings | None = None, shunt: ShuntSettings | None = None, shunt_kind: str = "ina226",
                 shunt_address: int = 0x40, make: DriveMaker | None = None) -> None:
        self.clock = clock or RealClock()
        self.lock = threading.RLock()
        self._plant = plant
        self._t_ns = self.clock.now_ns()
        self._last: Snapshot | None = None
        self._segment: Segment | None = None
        self._charges: deque[tuple[int, float]] = deque([(self._t_ns, 0.0)], REMEMBERED)
        imu_settings = imu or ImuSettings()
        imu_seed, firmware_seed = np.random.SeedSequence(seed).generate_state(2)
        wire: dict[str, Any] = {"advance": self.advance_to, "bus_khz": bus_khz, "lock": self.lock}
        self.imu = MockLsm9ds1(self.clock, imu_settings.temperature_degc, address, **wire)
        self._imu_physics = ImuPhysics(self.imu, imu_settings, np.random.default_rng(imu_seed))
        own = firmware or FirmwareSettings()
        place = int(firmware_seed), self._t_ns, self.advance_to, self.lock
        self.drive: EmulatedDrive = make(own, *place) if make else FirmwareEmulator(own, *place, codec)
        self.pivot = MockAs5600(self.clock, self._pivot_rad, pivot, seed, **wire) if pivot else None
        self.shunt = MockShunt(self.clock, self._charge, shunt_kind, shunt, seed, shunt_address,
                               **wire) if shunt else None
        self._per_a = shunt.torque_constant_nm_per_a if shunt else 1.0
        self.bus = MockBus([chip for chip in (self.imu, self.pivot, self.shunt) if chip is not None])
        """All chips of the rig on one bus."""

    @property
    def firmware(self) -> FirmwareEmulator:
        """The drive, where it is our own firmware."""
        assert isinstance(self.drive, FirmwareEmulator)
        return self.drive

    @property
    def t_ns(self) -> int:
        """Time up to which the physics is simulated [ns], host time."""
        return self._t_ns

    def advance_to(self, t_ns: int) -> None:
        """Run the physics past `t_ns`, in whole steps; the devices then show what happened up to `t_ns`.

        Physics that lagged behind would make every sample appear late by up to a step.
        """
        with self.lock:
            while self._t_ns < t_ns:
                self._step()
            self._imu_physics.release(t_ns)

    def _step(self) -> None:
        t0_ns, t1_ns = self._t_ns, self._t_ns + STEP_NS
        torque = self.drive.torque_over(t0_ns, t1_ns)
        after = snapshot(self._plant.step(STEP_NS * 1e-9, torque))
        segment = Segment(t0_ns, t1_ns, self._last or after, after)
        self._segment = segment
        self._charges.append((t1_ns, self._charges[-1][1] + torque / self._per_a * STEP_NS * 1e-9))
        self._imu_physics.observe(segment)
        self.drive.observe(segment)
        self._last, self._t_ns = after, t1_ns

    def _pivot_rad(self, t_ns: int) -> float:
        return self._segment.at(t_ns).q1 if self._segment else 0.0

    def _charge(self, t_ns: int) -> float:
        """Integral of the motor's current up to a time [A s]; before what is remembered it is that of its beginning."""
        k = bisect_left(self._charges, (t_ns, -1e300))
        if k == 0 or k == len(self._charges):
            return self._charges[min(k, len(self._charges) - 1)][1]
        (t0, c0), (t1, c1) = self._charges[k - 1], self._charges[k]
        return c0 + (c1 - c0) * (t_ns - t0) / (t1 - t0)
