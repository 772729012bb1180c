"""Torque plans that move the leg enough to identify it, within the rig's limits."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from daq.recording import Plan

FADE_S = 1.0


def random_multisine(seed: int, duration_s: float, peak_nm: float, *, low_hz: float = 0.1, high_hz: float = 2.5,
                     rate_hz: float = 100.0) -> Plan:
    """Equal sines at multiples of 1/`duration_s` between the two frequencies, phases drawn from `seed`.

    Scaled to `peak_nm` [N m] and faded in and out over a second, so that the drive never steps. Raises
    ValueError when the duration holds no such frequency.
    """
    frequencies = np.arange(np.ceil(low_hz * duration_s), np.floor(high_hz * duration_s) + 1) / duration_s
    if frequencies.size == 0 or duration_s < 4 * FADE_S:
        raise ValueError(f"{duration_s:g} s are too short to excite between {low_hz:g} and {high_hz:g} Hz")
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, frequencies.shape)
    torque = np.sin(2.0 * np.pi * np.outer(time_s, frequencies) + phases).sum(axis=1) * _fade(time_s, duration_s)
    return Plan(time_s, torque * (peak_nm / np.abs(torque).max()))


def _fade(time_s: FloatArray, duration_s: float) -> FloatArray:
    """0 at both ends, 1 between, raised cosines over `FADE_S`."""
    edge = np.minimum(time_s, duration_s - time_s) / FADE_S
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))
