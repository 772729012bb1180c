"""`commands_at`: what position loops are told at all samples and Gauss points of a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from daq import FloatArray, IndexArray, Loop
from estimator.effects import Commanded, Told, summed
from estimator.model import GAUSS
from estimator.signals import SignalSet


def commands_at(signals: Sequence[SignalSet], left: IndexArray, dt_s: float
                ) -> tuple[Commanded, Commanded] | None:
    """At the samples (n, N) and at the Gauss points (n, 2, K) of the intervals that begin at `left` (K,); None where
    not all segments have commands."""
    commands = [s.commands for s in signals if s.commands is not None]
    if not commands or len(commands) < len(signals):
        return None
    lengths = [len(s.time_s) for s in signals]
    loop = Loop.along([list(c.loops) for c in commands], lengths)
    angle, rate, supply = (np.concatenate([getattr(c, name) for c in commands]).T for name in (
        "angle", "rate", "supply"))
    first = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
    place = np.arange(first.size, dtype=np.float64)
    told = Told(np.ascontiguousarray(angle), np.ascontiguousarray(rate), first, dt_s)
    blank = Commanded.of(loop, supply, np.zeros_like(supply), place, told)
    read = np.nan_to_num(np.concatenate([s.angles for s in signals]).T)
    error = blank.error(read, np.zeros_like(read), np.zeros_like(read))[0]
    samples = replace(blank, summed=summed(error, first, dt_s))
    return samples, _at_gauss(samples, left)


def _at_gauss(samples: Commanded, left: IndexArray) -> Commanded:
    def between(x: FloatArray) -> FloatArray:
        return np.stack([x[..., left] + w * (x[..., left + 1] - x[..., left]) for w in GAUSS], axis=-2)

    both = len(samples.supply), 2, left.size
    held = samples.loop.at((slice(None), left))
    values = {f.name: np.asarray(getattr(held, f.name)) for f in fields(held)}
    loop = Loop(**{name: np.broadcast_to(value[:, None], both) for name, value in values.items()})
    return Commanded.of(loop, between(samples.supply), between(samples.summed), between(samples.place), samples.told)
