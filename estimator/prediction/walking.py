"""Free runs of a walker across touchdowns: how many steps ahead a model predicts, and where it falls.

The record says when a foot landed, as it says which torque acted: the ground is no part of the model. Between landings
the motion is simulated as any other, at a landing the impact map of `estimator.model.impact` takes over. A walker is
kept up by its controller, which a free run does not have: it falls sooner or later, and what has fallen has no error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray, IndexArray
from estimator.free_runs import SmoothedRun
from estimator.model import Mechanism, land, simulate
from estimator.signals import SINCE, STANCE, angle_column, torque_column

MOST_STEPS = 5
"""Steps that are predicted from every step: nearly all longer free runs fall."""
LYING_RAD = np.pi / 2
"""Angle from upright at which the leg that stands, or the torso, lies."""
INSTANT = 1e-6
"""Share of a sample below which there is nothing to simulate."""


class StepsAhead(NamedTuple):
    """Errors in the last of so many steps."""

    steps: int
    """1: the step in which the free run began."""
    pieces: int
    fell: int
    """Free runs that had fallen by its end; they are not in `rmse`."""
    rmse: FloatArray
    """(n,) [rad]; NaN where all fell"""


class Whole(NamedTuple):
    """One run from its first step on."""

    run: str
    steps: int
    fell_s: float | None
    """After so long; None where it came to the end."""
    fell_step: int
    """In this one, from 1; 0 where it did not."""


@dataclass(frozen=True)
class WalkAhead:
    """A model's free runs across touchdowns."""

    columns: tuple[str, ...]
    ahead: tuple[StepsAhead, ...]
    whole: tuple[Whole, ...]


class Walking(NamedTuple):
    """A record by role, as a free run takes it; see `cut_steps`."""

    time_s: FloatArray
    """(N,)"""
    angles: FloatArray
    """(N, n) [rad], NaN where no leg was known to stand"""
    torque: FloatArray
    """(N, n) [N m]"""
    first: IndexArray
    """(K,) first sample after each touchdown"""
    touchdown_s: FloatArray
    """(K,) instant of each touchdown [s]"""


def walking(data: Dataset, mechanism: Mechanism) -> Walking:
    """Inputs of a free run from a record that `cut_steps` made."""
    torque = np.zeros((len(data), mechanism.n))
    for j in mechanism.actuated:
        torque[:, j] = data[torque_column(mechanism, j)]
    first = np.flatnonzero(np.diff(data[STANCE])) + 1
    angles = np.stack([data[angle_column(mechanism, j)] for j in range(mechanism.n)], axis=-1)
    return Walking(data.time_s, angles, torque, first, data.time_s[first] - data[SINCE][first])


def walk_ahead(runs: Sequence[tuple[Dataset, SmoothedRun]]) -> WalkAhead:
    """Free runs of a walker from the smoothed state in which each step begins; each run with its smoothed motion."""
    mechanism = runs[0][1].problem.mechanism
    squares = np.zeros((MOST_STEPS, mechanism.n))
    samples, pieces, fell = (np.zeros(MOST_STEPS, int) for _ in range(3))
    whole = []
    for data, smoothed in runs:
        record, x, steps = walking(data, mechanism), smoothed.state.x, len(smoothed.signals)
        first = [0, *map(int, smoothed.problem.ends[:-1])]
        begin = [int(np.searchsorted(record.time_s, s.time_s[0] - 1e-9)) for s in smoothed.signals]
        end = [b + len(s.time_s) for b, s in zip(begin, smoothed.signals)]
        for k in range(steps):
            last = steps if k == 0 else min(k + MOST_STEPS, steps)
            q = carry(record, mechanism, smoothed.state.beta, smoothed.problem.collocation.hold,
                      (begin[k], end[last - 1]), x.q[first[k]], x.v[first[k]])
            up = np.asarray(np.isfinite(q).all(axis=1))
            if k == 0:
                down = None if up.all() else begin[0] + int(np.argmin(up))
                whole.append(Whole(data.name, steps, None, 0) if down is None else Whole(
                    data.name, steps, float(record.time_s[down] - record.time_s[begin[0]]),
                    1 + int(np.searchsorted(end, down, side="right"))))
            for n in range(min(last - k, MOST_STEPS)):
                where = slice(begin[k + n] - begin[k], end[k + n] - begin[k])
                pieces[n] += 1
                if not up[: where.stop].all():
                    fell[n] += 1
                    continue
                squares[n] += np.sum((q[where] - record.angles[begin[k + n] : end[k + n]]) ** 2, axis=0)
                samples[n] += where.stop - where.start
    with np.errstate(invalid="ignore"):
        rmse = np.sqrt(squares / samples[:, None])
    return WalkAhead(tuple(angle_column(mechanism, j) for j in range(mechanism.n)),
                     tuple(StepsAhead(n + 1, int(pieces[n]), int(fell[n]), rmse[n]) for n in range(MOST_STEPS)
                           if pieces[n]), tuple(whole))


def carry(record: Walking, mechanism: Mechanism, beta: FloatArray, hold: str, where: tuple[int, int], q0: FloatArray,
          qd0: FloatArray) -> FloatArray:
    """(N, n) angles from the state q0, qd0 (n,) at the first of the samples `where`, across touchdowns.

    NaN from where the walker has fallen, or the motion diverges.
    """
    start, stop = where
    out, dt = np.full((stop - start, mechanism.n), np.nan), float(record.time_s[1] - record.time_s[0])
    inside = (record.first > start) & (record.first < stop)
    at, q, qd = start, q0, qd0
    for first, landed in [*zip(record.first[inside], record.touchdown_s[inside]), (stop, None)]:
        angles, rates, _ = simulate(mechanism, beta, q, qd, record.torque[at:first], dt, hold)
        down = lying(mechanism, angles)
        out[at - start : at - start + down] = angles[:down]
        if down < len(angles) or landed is None:
            return out
        q, qd = across(record, mechanism, beta, hold, int(first), float(landed), angles[-1], rates[-1])
        if not (np.isfinite(q).all() and np.isfinite(qd).all()):
            return out
        at = int(first)
    return out


def across(record: Walking, mechanism: Mechanism, beta: FloatArray, hold: str, first: int, landed: float,
           q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """State at the sample `first` after a touchdown, from the one before it."""
    order = list(range(mechanism.n))
    order[mechanism.exchanged[0]], order[mechanism.exchanged[1]] = mechanism.exchanged[::-1]
    before, after = record.time_s[first - 1], record.time_s[first]
    share = float(np.clip((landed - before) / (after - before), 0.0, 1.0))
    old, new = record.torque[first - 1], record.torque[first]
    middle = old if hold == "zero" else (1.0 - share) * old + share * new[order]
    q, qd = _piece(mechanism, beta, hold, q, qd, np.stack([old, middle]), share * (after - before))
    q, qd = land(mechanism, beta, q, qd)
    return _piece(mechanism, beta, hold, q, qd, np.stack([middle[order], new]), (1.0 - share) * (after - before))


def _piece(mechanism: Mechanism, beta: FloatArray, hold: str, q: FloatArray, qd: FloatArray, torque: FloatArray,
           length_s: float) -> tuple[FloatArray, FloatArray]:
    if length_s < INSTANT:
        return q, qd
    angles, rates, _ = simulate(mechanism, beta, q, qd, torque, length_s, hold)
    return angles[-1], rates[-1]


def lying(mechanism: Mechanism, angles: FloatArray) -> int:
    """First of the samples (N, n) at which the leg that stands or the torso lies, or is nowhere; N where none is."""
    links = np.abs(mechanism.from_zero(mechanism.transform @ angles.T)[[0, 2]])
    down = ~(links < LYING_RAD).all(axis=0)
    return int(np.argmax(down)) if down.any() else len(angles)
