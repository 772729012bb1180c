"""`RunSplit`: the runs of a diagnosis, split into train runs, of which all is made, and test runs, which judge it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from daq import Dataset, FloatArray, IndexArray
from estimator.diagnosis.decision_rule import LEAST_S
from estimator.effects import Effect, SensorTimeSkew
from estimator.errors import FitError
from estimator.fitting import noise_floors, require_scale
from estimator.likelihood import Candidate, LatentProblem, Noise, Stage
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.score import BEYOND, ONLY, RUNS
from estimator.signals import SignalSet, split_signals

HELD_OUT = (1, 2)
"""Held-out places among four neighbours in excitation, alternating: neither the strongest nor the weakest run."""


@dataclass(frozen=True)
class RunSplit:
    """Runs by falling excitation, each a list of gap-free segments: nothing hangs on the order in which they came."""

    mechanism: Mechanism
    options: FitOptions
    names: tuple[str, ...]
    runs: tuple[tuple[SignalSet, ...], ...]
    starts_s: tuple[float, ...]
    """Session time at which each run starts, pauses left out."""
    train: tuple[int, ...]
    """Runs on which anything may be looked at more than once"""
    test: tuple[int, ...]
    """Runs that nothing sees before the search has ended"""
    gear_ratio: float
    single: bool
    """One run only, cut by time: weaker evidence, for its parts are not independent."""
    clock_bound_s: float = 0.0
    """See `Dataset.clock_bound_s`; the largest of all runs."""
    known: Mapping[str, float] = field(default_factory=dict)
    """Noise levels that the rig declares: here the least that an estimate may be, for a sensor that errs shows as
    noise first."""
    workers: int = 1
    """Processes that may work on independent fits and runs."""
    stiction: Mapping[int, FloatArray] = field(default_factory=dict)
    """Run to `Noise.stiction`, as the nominal model has it: all explanations are compared on the same weights."""
    delays_s: tuple[float, ...] = ()
    """Delays of the torque beyond its hold that the likelihood of the hold found [s]; empty where the hold explains it.

    The first is of the hold that was chosen, another of one that is nearly as likely."""
    taken: Mapping[str, FloatArray] = field(default_factory=dict)
    """Effect to the sizes of a sensor's small fault that is taken off the readings of `runs`"""
    read: tuple[tuple[SignalSet, ...], ...] = ()
    """Runs with all that was read, where anything is taken off"""

    @property
    def inner(self) -> list[tuple[int, ...]]:
        """Folds of the train runs: each stands for test runs while the search goes on; a single train run for
        itself."""
        found = [fold for fold in folds(len(self.runs)) if fold != self.test]
        return found if len(found) > 1 else [self.train]

    @property
    def parts(self) -> Iterator[tuple[int, IndexArray]]:
        """Each train run with its samples among those of all."""
        lengths = [sum(len(s.time_s) for s in self.runs[i]) for i in self.train]
        return zip(self.train, np.split(np.arange(sum(lengths)), np.cumsum(lengths)[:-1]))

    @property
    def has_imu(self) -> bool:
        return bool(self.runs[0][0].imu)

    @property
    def encoders(self) -> tuple[int, ...]:
        """0-based joints whose encoders are read."""
        return self.options.encoders_of(self.mechanism.n)

    @property
    def tolerances(self) -> Mapping[str, tuple[float, ...]] | None:
        """Those of the rig; that of the IMU's time line is at least what the recorder's clocks leave open."""
        stated, key = self.options.tolerances, SensorTimeSkew.name
        if stated is None or not self.clock_bound_s:
            return stated
        own = stated.get(key, (0.0 if ONLY in stated else SensorTimeSkew.sizes[0].tolerance,))
        return {**stated, key: (max(own[0], self.clock_bound_s / BEYOND),)}

    def open_size(self, effect: Effect) -> float:
        """Size of `effect` below which the recorder's clocks leave it open anyway; zero unless it is a time skew."""
        return self.clock_bound_s if isinstance(effect, SensorTimeSkew) else 0.0

    def floors(self, problem: LatentProblem, beta: FloatArray) -> Noise:
        """Least noise levels of a fit at beta (p,)."""
        return noise_floors(problem, self.mechanism, beta).with_declared(self.known, self.mechanism.actuated)

    def signals(self, which: Sequence[int]) -> list[SignalSet]:
        """All segments of these runs."""
        return [s for i in which for s in self.runs[i]]

    def problem(self, which: Sequence[int], angle_range: FloatArray, effects: Sequence[Effect] = (),
                candidates: Sequence[Candidate] = (), signals: Sequence[SignalSet] | None = None,
                disturbed: bool = False) -> LatentProblem:
        """Likelihood of these runs; `signals` stand in for their own (a replicate of them, or a part)."""
        run = [i for i in which for _ in self.runs[i]]
        begin = [s.time_s[0] - self.runs[i][0].time_s[0] for i in which for s in self.runs[i]]
        stage = Stage(tuple(run), tuple(self.starts_s[i] + b for i, b in zip(run, begin)), tuple(map(float, begin)),
                      angle_range, self.gear_ratio)
        problem = LatentProblem(self.signals(which) if signals is None else signals, self.mechanism,
                                self.options.hold, stage, effects, candidates)
        problem = problem.with_disturbance() if disturbed else problem
        known = [self.stiction[i] for i in which if i in self.stiction]
        return problem.with_stiction(np.concatenate(known)) if len(known) == len(which) else problem

    def as_read(self) -> RunSplit:
        """The split of the runs with all that was read."""
        return replace(self, runs=self.read or self.runs)

    def with_stiction(self, found: Mapping[int, FloatArray]) -> RunSplit:
        """Split with `Noise.stiction` of more runs; known values stay."""
        return replace(self, stiction={**found, **self.stiction})


def split_runs(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions,
               gear_ratio: float = 1.0, workers: int = 1) -> RunSplit:
    """Split runs given in the order of recording: of four neighbours in excitation three train, and one tests.

    Raises `FitError` where there is too little.
    """
    known, options = options.noise, replace(options, noise={})
    single = len(datasets) == 1
    if single:
        datasets = _parts(datasets[0])
    runs = [tuple(split_signals([d], mechanism, options)) for d in datasets]
    require_scale(datasets, mechanism, options)
    rates = {s.rate_hz for run in runs for s in run}
    if len(rates) > 1:
        raise FitError("the runs are on grids of different rates; give one rate_hz under [sampling]")
    lengths = [sum(len(s.time_s) for s in run) / run[0].rate_hz for run in runs]
    if sum(lengths) < LEAST_S:
        raise FitError(f"{sum(lengths):.1f} s of data cannot support a diagnosis; record at least {LEAST_S:.0f} s, "
                       "better eight runs of 20 s")
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    order = by_excitation(runs)
    test = folds(len(order))[0]
    train = tuple(k for k in range(len(order)) if k not in test)
    return RunSplit(mechanism, options, tuple(datasets[i].name for i in order), tuple(runs[i] for i in order),
                    tuple(float(starts[i]) for i in order),
                    train, test, gear_ratio, single,
                    max(d.clock_bound_s for d in datasets), known, workers)


def folds(count: int) -> list[tuple[int, ...]]:
    """Groups of test runs for a rotation, as indices by falling excitation; the first are those of the split.

    Each group has one of every four neighbours.
    """
    groups = [tuple(k for k in range(count) if k % 4 == (HELD_OUT[k // 4 % 2] + turn) % 4) for turn in range(4)]
    return [g for g in groups if g] if groups[0] else [(count - 1,), *((k,) for k in range(count - 1))]


def turned(split: RunSplit, test: tuple[int, ...]) -> RunSplit:
    """The same runs with other `test` runs, in one process; stiction is found anew."""
    train = tuple(k for k in range(len(split.runs)) if k not in test)
    return replace(split, train=train, test=test, workers=1, stiction={})


def by_excitation(runs: Sequence[Sequence[SignalSet]]) -> list[int]:
    """Numbers of the runs, from the largest rms torque to the least; runs alike in that by what they measured."""
    torque = [np.concatenate([s.torque.ravel() for s in run]) for run in runs]
    return sorted(range(len(runs)), key=lambda i: (-float(np.mean(torque[i] ** 2)), torque[i].tobytes()))


def _parts(data: Dataset) -> list[Dataset]:
    edges = np.linspace(0, len(data), RUNS + 1).astype(int)
    cuts = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    return [replace(data.part(cut), name=f"{data.name}[{data.time_s[cut.start]:.1f}-{data.time_s[cut.stop - 1]:.1f} s]")
            for cut in cuts]
