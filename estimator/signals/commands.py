"""`Commands`: what position loops were told over one segment, and the input that they make of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from daq import Dataset, FloatArray, Loop
from estimator.signals.filters import lowpass

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

SUPPLY = ("supply_v", "volts")
"""Columns of a motor's supply [V], the first that is there."""
FASTEST_HZ = 10.0
"""Cut-off of a rate where none is stated, at most a tenth of the sampling rate."""


@dataclass(frozen=True)
class Commands:
    """Arrays (N, n), zero at a joint without a loop."""

    loops: tuple[Loop | None, ...]
    """(n,)"""
    angle: FloatArray
    """[rad]"""
    rate: FloatArray
    """[rad/s]"""
    supply: FloatArray
    """[V]; 1 where the drive makes torque"""

    def part(self, where: slice) -> Self:
        """The samples `where`."""
        return replace(self, angle=self.angle[where], rate=self.rate[where], supply=self.supply[where])


def command_columns(joint: int) -> tuple[str, str]:
    """Columns of the commanded angle and rate of a joint (0-based)."""
    return f"q{joint + 1}_cmd_rad", f"qd{joint + 1}_cmd_radps"


def commands_of(data: Dataset, joints: int, where: slice) -> Commands | None:
    """Commands of one gap-free segment; None where no joint of the run has a loop."""
    if not data.loops:
        return None
    loops = tuple(data.loops.get(j + 1) for j in range(joints))
    angle, rate, supply = np.zeros((3, where.stop - where.start, joints))
    for j, loop in enumerate(loops):
        if loop is not None:
            angle[:, j], rate[:, j], supply[:, j] = _told(data.columns, loop, j, where, data.rate_hz)
    return Commands(loops, angle, rate, supply)


def _told(columns: Mapping[str, FloatArray], loop: Loop, joint: int, where: slice, rate_hz: float
          ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Commanded angle and rate and the supply, (N,) each."""
    named, rate_named = command_columns(joint)
    angle = columns[named][where]
    rate = columns[rate_named][where] if rate_named in columns else np.gradient(angle, 1.0 / rate_hz)
    lag = float(loop.command_filter_s)
    angle, rate = lagged(angle, lag, rate_hz), lagged(rate, lag, rate_hz)
    own = next((columns[name][where] for name in SUPPLY if name in columns), np.ones_like(angle))
    return angle, rate, own if np.isnan(loop.supply) else np.full_like(angle, loop.supply)


def earlier(x: FloatArray, late_s: float, rate_hz: float) -> FloatArray:
    """x(t - late_s) of a segment (N,), `monotone` between samples, its first value before it and its last one after it.
    """
    if not late_s or len(x) < 2:
        return x
    at = np.arange(len(x), dtype=np.float64)
    return np.asarray(monotone(x)(np.clip(at - late_s * rate_hz, 0.0, at[-1])))


def monotone(x: FloatArray) -> PchipInterpolator:
    """x (N,) as a function of its index, by cubics that exceed no sample (Fritsch and Butland 1984).

    Straight lines make what curves too small, and splines overshoot where a command steps.
    """
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(np.arange(len(x), dtype=np.float64), x)


def lagged(x: FloatArray, time_constant_s: float, rate_hz: float) -> FloatArray:
    """x of a segment (N,) behind a low pass of first order, exact for x linear between samples, its first value before
    it."""
    if not time_constant_s:
        return x
    from scipy.signal import lfilter

    ratio = time_constant_s * rate_hz
    kept = np.exp(-1.0 / ratio)
    share = ratio * (1.0 - kept)
    found, _ = lfilter([1.0 - share, share - kept], [1.0, -kept], x, zi=share * x[:1])
    return np.asarray(found)


def input_by_law(commands: Commands, joint: int, angle: FloatArray, rate_hz: float, cutoff_hz: float | None = None,
                 order: int = 4) -> FloatArray:
    """(N,) input [N m] that the loop of a joint makes of its encoder's `angle` (N,) over one segment.

    The loop subtracts what its encoder reads, quantised. Rates are low-passed: what a servo differences beyond is
    noise. The integral begins at zero.
    """
    loop = commands.loops[joint]
    assert loop is not None
    held = 0.5 * float(loop.period_s)
    late = held + float(loop.delay_s)
    error = earlier(commands.angle[:, joint], late, rate_hz) - earlier(angle, held, rate_hz)
    cutoff_hz = min(FASTEST_HZ, 0.1 * rate_hz) if cutoff_hz is None else cutoff_hz
    rate = np.gradient(lowpass(angle, cutoff_hz, rate_hz, order), 1.0 / rate_hz)
    seen = lagged(rate, float(loop.velocity_filter_s), rate_hz)
    rate_error = loop.feedforward * earlier(commands.rate[:, joint], late, rate_hz) - earlier(seen, held, rate_hz)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (error[1:] + error[:-1]))]) / rate_hz
    return loop.acting(loop.wanted(error, rate_error, summed), rate, commands.supply[:, joint])
