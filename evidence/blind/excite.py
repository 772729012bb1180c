"""Knee torque for the bench's runs: odd random-phase multisines, and slow ramps with holds."""

from dataclasses import dataclass

import numpy as np

from evidence.blind.leg import Array

SECONDS = 20.0
# big, small and slow content alternate, so that any split of the runs by order sees all three
PATTERN = ("big", "small", "slow", "big", "small", "slow", "big", "small")


@dataclass(frozen=True)
class Torque:
    """A torque that can be asked for at any time; all amplitudes are for scale 1 [N m]."""

    rate: Array
    phase: Array
    amplitude: float
    knot_time: Array
    knot_level: Array

    def at(self, time: Array, scale: float = 1.0) -> Array:
        wave = np.sin(np.multiply.outer(time, self.rate) + self.phase).sum(axis=-1)
        return scale * (self.amplitude * wave + np.interp(time, self.knot_time, self.knot_level))


def draw(rng: np.random.Generator, kind: str) -> Torque:
    """One run's torque with a peak of about 1 (big), 0.5 (small) or a slow course up to 0.6 with ripples (slow)."""
    line = np.arange(1, 60, 2)
    rate = np.asarray(2.0 * np.pi * line[(line / SECONDS >= 0.1) & (line / SECONDS <= 3.0)] / SECONDS, np.float64)
    phase = rng.uniform(0.0, 2.0 * np.pi, rate.shape)
    time = np.arange(0.0, SECONDS, 0.01)
    peak = np.abs(np.sin(np.multiply.outer(time, rate) + phase).sum(axis=-1)).max()
    knots, levels = np.array([0.0, SECONDS]), np.zeros(2)
    share = {"big": 1.0, "small": 0.5, "slow": 0.3}[kind]
    if kind == "slow":
        # ramp, hold, ramp, hold
        edges = np.cumsum(np.concatenate([[0.0], rng.uniform(1.5, 3.0, 10)]))
        height = 0.6 * rng.uniform(0.3, 1.0, 5) * np.array([1, -1, 1, -1, 1]) * rng.choice((-1, 1))
        knots = edges
        levels = np.concatenate([[0.0], np.repeat(height, 2)])
    return Torque(rate, phase, share / peak, knots, levels)
