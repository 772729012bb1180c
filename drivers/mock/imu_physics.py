"""Raw numbers of an IMU on link 1 from the leg's motion: geometry, low pass, errors, noise, quantiser, clipping."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from drivers import lsm9ds1_registers as reg
from drivers.mock.lsm9ds1 import MockLsm9ds1
from drivers.mock.plant import Segment, Snapshot
from drivers.mock.settings import ImuSettings

INT16 = (-32768, 32767)
Felt = tuple[float, float, float]
"""Gyro z [rad/s], accelerometer x and y [m/s2], in the axes of the link."""


class ImuPhysics:
    """Feeds the chip a sample at each tick of the chip's own oscillator."""

    def __init__(self, chip: MockLsm9ds1, settings: ImuSettings, rng: np.random.Generator) -> None:
        self._chip, self._settings, self._rng = chip, settings, rng
        self._to_chip = np.asarray(settings.mount, float).T
        self._accel_to_chip = np.linalg.inv(np.asarray(settings.accel_matrix, float)) @ self._to_chip
        self._noise = np.repeat([settings.gyro_noise_radps, settings.accel_noise_mps2], 3)
        self._bias = np.array([*settings.gyro_bias_radps, *settings.accel_bias_mps2])
        self._rate_hz = 0.0
        self._due_ns = 0.0
        self._ahead: deque[tuple[float, list[int]]] = deque()
        self._passed: Felt | None = None
        """What the low passes let through, at the end of the last segment."""

    def observe(self, segment: Segment) -> None:
        """Take the samples due within the segment; the chip gets them when their time has come."""
        rate = self._chip.rate_hz
        if not rate:
            self._rate_hz = 0.0
            self._passed = None
            self._ahead.clear()
            return
        period_ns = 1e9 / (rate * (1 + self._settings.rate_error))
        if rate != self._rate_hz:  # switched on: the oscillator's phase is its own
            self._rate_hz = rate
            self._due_ns = segment.t0_ns + period_ns * self._rng.random()
        before, after = self._low_passed(segment)
        while self._due_ns <= segment.t1_ns:
            w = (self._due_ns - segment.t0_ns) / (segment.t1_ns - segment.t0_ns)
            self._ahead.append((self._due_ns, self.raw([a + w * (b - a) for a, b in zip(before, after)])))
            self._due_ns += period_ns

    def release(self, t_ns: int) -> None:
        """Push the samples due up to `t_ns` into the chip."""
        while self._ahead and self._ahead[0][0] <= t_ns:
            self._chip.push(self._ahead.popleft()[1])

    def felt(self, state: Snapshot) -> Felt:
        """Motion that the chip is exposed to: q1d, a_x = l*q1dd + g*sin(q1), a_y = -l*q1d^2 - g*cos(q1)."""
        s = self._settings
        return (state.q1d, s.lever_arm_m * state.q1dd + s.gravity_mps2 * math.sin(state.q1),
                -s.lever_arm_m * state.q1d**2 - s.gravity_mps2 * math.cos(state.q1))

    def _low_passed(self, segment: Segment) -> tuple[Felt, Felt]:
        """What the low passes let through at both ends: y' = 2 pi f (x - y), exact for an x that is a ramp."""
        x0, x1 = self.felt(segment.before), self.felt(segment.after)
        y0 = self._passed or x0
        gyro_hz, accel_hz = self._chip.cutoffs_hz
        y1 = []
        for a, b, y, cutoff_hz in zip(x0, x1, y0, (gyro_hz, accel_hz, accel_hz)):
            turns = 2.0 * math.pi * cutoff_hz * (segment.t1_ns - segment.t0_ns) * 1e-9
            lag = (b - a) / turns
            y1.append(b - lag + (y - a + lag) * math.exp(-turns))
        self._passed = y1[0], y1[1], y1[2]
        return y0, self._passed

    def raw(self, felt: Sequence[float]) -> list[int]:
        """Six readings [LSB] of this motion: see `felt`."""
        gyro, x, y = felt
        physical = np.concatenate([self._to_chip @ (0.0, 0.0, gyro), self._accel_to_chip @ (x, y, 0.0)])
        physical += self._bias + self._noise * self._rng.standard_normal(6)
        gyro_range, accel_range = self._chip.ranges
        per_lsb = np.repeat([math.radians(reg.GYRO_MDPS_PER_LSB[gyro_range] * 1e-3),
                             reg.ACCEL_MG_PER_LSB[accel_range] * 1e-3 * reg.STANDARD_GRAVITY], 3)
        lsb: list[int] = np.clip(np.rint(physical / per_lsb), *INT16).astype(int).tolist()
        return lsb
