"""`SmallFault`: what is likeliest wrong with a sensor within its tolerance; readings without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.effects import Effect
from estimator.likelihood import Candidate, LatentProblem, State
from estimator.score import Score, SensorFaults
from estimator.signals import Channel, SignalSet, imu_channels, imu_columns


class SmallFault(NamedTuple):
    """An effect on what a sensor reads, with its likeliest size."""

    effect: Effect
    size: FloatArray
    """Its sizes, without shapes: these are the usual ones."""
    tolerance: FloatArray
    """Of each of its sizes, 1 sigma."""


def faults_shown(sensors: SensorFaults, runs: Sequence[Score], least_gain: float) -> tuple[SmallFault, ...]:
    """The small faults that the scores of `runs` show; none where they gain less than `least_gain`."""
    found = sensors.chosen(runs, least_gain)
    return () if found is None else tuple(
        SmallFault(found.candidates[i].effect, size, tolerance) for i, size, tolerance in
        zip(found.which, found.parts(found.likeliest(runs).sizes), found.parts(found.tolerances), strict=True))


def told(faults: Sequence[SmallFault]) -> str:
    """A sentence on faults that were taken off, with the sizes of at least half a tolerance."""
    sizes = [f"{one.effect.key} {size.name} {value:.2g} (tolerance {tolerance:.2g})".replace("_", " ")
             for one in faults for size, value, tolerance
             in zip(one.effect.sizes, one.size, one.tolerance, strict=True) if abs(value) >= 0.5 * tolerance]
    return ("small faults of sensors, within their tolerances, were taken off the readings: "
            f"{'; '.join(sizes) or 'each is less than half its tolerance'}")


def sizes_of(faults: Sequence[SmallFault], candidates: Sequence[Candidate]) -> FloatArray:
    """(k,) sizes of `faults` in the columns of the `candidates`; zero of all others."""
    known = {one.effect.key: one.size for one in faults}
    return np.concatenate([np.zeros(0), *(
        known.get(one.effect.key, np.zeros(one.width)) if one.shape == one.effect.usual else np.zeros(one.width)
        for one in candidates)])


def without_faults(signals: Sequence[SignalSet], problem: LatentProblem, state: State, faults: Sequence[SmallFault]
                   ) -> list[SignalSet]:
    """Segments of `problem` with what the `faults` add at the motion in `state` taken off their readings."""
    view = replace(problem.view(state.x, state.beta[: problem.mechanism.p]), measured=problem.record)
    added: dict[Channel, FloatArray] = {}
    for one in faults:
        size = np.append(one.size, one.effect.usual or ())
        for channel, values in one.effect.perturb(view, size).readings.items():
            added[channel] = added.get(channel, 0.0) + values
    edges = [0, *map(int, problem.ends)]
    return [_less(s, problem, {channel: values[a:b] for channel, values in added.items()})
            for s, a, b in zip(signals, edges, edges[1:], strict=False)]


def _less(signals: SignalSet, problem: LatentProblem, added: Mapping[Channel, FloatArray]) -> SignalSet:
    angles, torque, imu = signals.angles.copy(), signals.torque.copy(), dict(signals.imu)
    places = {channel: name for k in range(len(problem.mechanism.imus))
              for channel, name in zip(imu_channels(k), imu_columns(k), strict=True)}
    for channel, values in added.items():
        if channel.kind == "encoder":
            angles[:, channel.joint or 0] -= values
        elif channel.kind == "torque":
            torque[:, channel.joint or 0] -= values
        elif channel in places:
            imu[places[channel]] = imu[places[channel]] - values
    return replace(signals, angles=angles, torque=torque, imu=imu)
