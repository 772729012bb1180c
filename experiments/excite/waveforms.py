"""Kinds of torque plan and the motion that each gives. An effect names the kinds that show it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq import FloatArray
from estimator.effects import PlanKind

HOLD_LEVELS = (0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0)
STEADY_SPEEDS = (1.0, 2.0, 4.0)
"""Of the triangles, relative."""
STEADY_LEVEL = 0.6
"""Of a ramp's largest torque: angles are nearly proportional to it, so even ramps give nearly even speeds."""
SLOW_HZ, FAST_HZ = (0.05, 0.3), (3.0, 8.0)
MICRO_HZ, MICRO_SHARE = 0.7, 0.12
KICK_S = (0.25, 0.6)
"""Width of a kick is drawn from here."""
SWING_S = 6.0
"""Least time from kick to kick."""
EDGE_S = 0.5

Shape = Callable[[FloatArray, np.random.Generator], FloatArray]
"""(times from 0 [s], random numbers) -> torque, of any scale."""


@dataclass(frozen=True)
class Kind:
    """One kind of plan."""

    what: str
    shape: Shape | None = None
    """None: designed by the optimiser."""
    share: float = 1.0
    """Of the largest size that the limits allow."""


def ramps(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Torque in slow ramps from hold to hold, on both sides of zero."""
    levels = np.array(HOLD_LEVELS) * rng.choice((-1.0, 1.0))
    levels[1:-1] *= rng.uniform(0.8, 1.0, levels.size - 2)
    at = t / t[-1] * (2 * levels.size - 1)
    return np.asarray(np.interp(at, np.arange(2 * levels.size), np.repeat(levels, 2)))


def steady(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Triangles at several rates, a rest after each: nearly constant speed both ways."""
    corners, levels, side = [0.0], [0.0], rng.choice((-1.0, 1.0))
    for speed in rng.permutation(STEADY_SPEEDS):
        for step, level in ((1.0, side), (2.0, -side), (1.0, 0.0), (0.5 * speed, 0.0)):
            corners.append(corners[-1] + step / speed)
            levels.append(STEADY_LEVEL * level)
    return np.asarray(np.interp(t, np.array(corners) / corners[-1] * t[-1], levels))


def swing(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Kicks, and the torque zero after each until it has died down."""
    out = np.zeros_like(t)
    swings = max(1, int(t[-1] / SWING_S))
    for k in range(swings):
        _kick(out, t, EDGE_S + k * t[-1] / swings, rng)
    return out


def rest(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Motor off, one kick, motor off again until all is at rest."""
    out = np.zeros_like(t)
    _kick(out, t, 0.4 * t[-1], rng)
    return out


def _kick(out: FloatArray, t: FloatArray, start: float, rng: np.random.Generator) -> None:
    width = rng.uniform(*KICK_S)
    inside = (t >= start) & (t < start + width)
    out[inside] += rng.choice((-1.0, 1.0)) * rng.uniform(0.7, 1.0) * np.sin(np.pi * (t[inside] - start) / width)


def slow(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Slow reversals: random phases below 0.3 Hz."""
    return _multisine(t, rng, SLOW_HZ)


def fast(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """High frequencies, random phases."""
    return _multisine(t, rng, FAST_HZ)


def micro(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Small sines about several levels of torque."""
    return _faded(ramps(t, rng) + MICRO_SHARE * np.sin(2 * np.pi * MICRO_HZ * t), t)


def _multisine(t: FloatArray, rng: np.random.Generator, band_hz: tuple[float, float]) -> FloatArray:
    length = t[-1] + t[1]
    lines = np.arange(max(1, np.ceil(band_hz[0] * length)), max(3, np.floor(band_hz[1] * length)) + 1) / length
    phases = rng.uniform(0.0, 2.0 * np.pi, (lines.size, 1))
    return _faded(np.sin(2.0 * np.pi * lines[:, None] * t + phases).sum(axis=0), t)


def _faded(wave: FloatArray, t: FloatArray) -> FloatArray:
    return np.asarray(wave * np.clip(np.minimum(t, t[-1] - t) / EDGE_S, 0.0, 1.0))


KINDS: dict[PlanKind, Kind] = {
    "large": Kind("designed Fourier series, as large as the limits allow"),
    "small": Kind("the same motion with half the torque", share=0.5),
    "ramps": Kind("slow torque ramps with holds between, both sides of zero", ramps),
    "swing": Kind("kicks, each followed by a free swing with the torque at zero", swing),
    "slow": Kind("slow reversals, below 0.3 Hz and well inside the limits", slow, 0.6),
    "steady": Kind("nearly constant speed in both directions at several speeds, with rests", steady),
    "fast": Kind("high frequencies, 3 to 8 Hz", fast),
    "micro": Kind("small sines about several held torques", micro, 0.8),
    "rest": Kind("rest with the motor off, one large swing, rest again", rest),
}
USUAL: tuple[PlanKind, ...] = ("large", "ramps", "small", "swing")
