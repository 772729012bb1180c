"""One emulated rig: a plant, an IMU chip and a controller on a single time line of half-millisecond steps."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.link import Codec
from drivers.mock.clock import Clock, RealClock
from drivers.mock.emulator import FirmwareEmulator
from drivers.mock.imu_physics import ImuPhysics
from drivers.mock.lsm9ds1 import MockLsm9ds1
from drivers.mock.plant import Plant, Segment, Snapshot, snapshot
from drivers.mock.settings import FirmwareSettings, ImuSettings
from drivers.protocol import Decoder

STEP_NS = 500_000


class MockRig:
    """The devices share the plant and the clock; each transfer first brings the physics up to the time it is made.

    `imu` is the I2C bus object (with the chip on it), `firmware` the controller to hand to `EmulatorLink` or
    `PtyServer`. Thread-safe.
    """

    def __init__(self, plant: Plant, clock: Clock | None = None, imu: ImuSettings | None = None,
                 firmware: FirmwareSettings | None = None, seed: int = 0, address: int = 0x6B,
                 bus_khz: float = 400.0, codec: Callable[[], Codec[Any]] = Decoder) -> None:
        self.clock = clock or RealClock()
        self.lock = threading.RLock()
        self._plant = plant
        self._t_ns = self.clock.now_ns()
        self._last: Snapshot | None = None
        imu_settings = imu or ImuSettings()
        imu_seed, firmware_seed = np.random.SeedSequence(seed).generate_state(2)
        self.imu = MockLsm9ds1(self.clock, self.advance_to, address, bus_khz, imu_settings.temperature_degc, self.lock)
        self._imu_physics = ImuPhysics(self.imu, imu_settings, np.random.default_rng(imu_seed))
        self.firmware = FirmwareEmulator(firmware, int(firmware_seed), self._t_ns, self.advance_to, self.lock,
                                         codec)

    @property
    def t_ns(self) -> int:
        """How far the physics has come [ns], host time."""
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
        torque = self.firmware.torque_over(t0_ns, t1_ns)
        after = snapshot(self._plant.step(STEP_NS * 1e-9, torque))
        segment = Segment(t0_ns, t1_ns, self._last or after, after)
        self._imu_physics.observe(segment)
        self.firmware.observe(segment)
        self._last, self._t_ns = after, t1_ns
