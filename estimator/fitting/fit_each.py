"""Many records fitted one by one, each alone; the work of equally long ones is done together where a method can."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset
from estimator.errors import FitError
from estimator.fitting import hekf
from estimator.fitting.extension import ExtendedFit
from estimator.fitting.fit import estimate
from estimator.fitting.mle import result_of
from estimator.fitting.motion_search import state_of
from estimator.fitting.profile_likelihood import known_noise, search, suits
from estimator.fitting.wls import free_mask
from estimator.likelihood import BatchProblem, LatentProblem, Records
from estimator.methods import Method
from estimator.model import Mechanism
from estimator.options import AUTO, FitOptions
from estimator.result import FitResult
from estimator.signals import SignalSet, split_signals

Outcome = FitResult | FitError


def fit_each(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions,
             method: Method = "mle") -> list[Outcome]:
    """`estimate` on each of `datasets`, in their order; a record that cannot be fitted gives its `FitError`."""
    out: list[Outcome | None] = [None] * len(datasets)
    if options.hold == AUTO and method != "mle":  # as `estimate` takes it
        options = replace(options, hold="linear")
    if method == "hekf" or (method == "mle" and options.latent != "free"):
        together = _fit_mle if method == "mle" else _fit_hekf
        for where, signals in _alike(datasets, mechanism, options, method):
            for k, outcome in zip(where, together(signals, mechanism, options)):
                out[k] = outcome
    for k, data in enumerate(datasets):
        if out[k] is None:
            try:
                out[k] = estimate([data], mechanism, options, method)
            except FitError as error:
                out[k] = error
    return [outcome for outcome in out if outcome is not None]


def _alike(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions,
           method: Method) -> list[tuple[list[int], list[SignalSet]]]:
    """Groups of records with one segment of the same length and rate that the method can take together."""
    groups: dict[tuple[int, float], tuple[list[int], list[SignalSet]]] = {}
    for k, data in enumerate(datasets):
        try:
            signals = split_signals([data], mechanism, options)
        except FitError:
            continue
        if len(signals) == 1 and (method == "hekf" or (options.hold != AUTO and suits(signals, mechanism, options))):
            where, found = groups.setdefault((len(signals[0].time_s), signals[0].rate_hz), ([], []))
            where.append(k)
            found.append(signals[0])
    return [group for group in groups.values() if len(group[0]) > 1]


def _fit_mle(signals: list[SignalSet], mechanism: Mechanism, options: FitOptions) -> list[Outcome]:
    start = time.perf_counter()
    noise = known_noise(mechanism, options)
    spread = None if signals[0].spread is None else np.stack([s.spread for s in signals if s.spread is not None])
    records = Records(np.stack([s.angles for s in signals]), np.stack([s.torque for s in signals]), spread)
    found = search(BatchProblem(mechanism, signals[0].rate_hz, options.hold, noise), records)
    wall = (time.perf_counter() - start) / len(signals)
    free, _ = free_mask(mechanism, options)
    out: list[Outcome] = []
    for k, s in enumerate(signals):
        try:
            state = state_of(found, k, noise)
        except FitError as error:
            out.append(error)
            continue
        problem = LatentProblem([s], mechanism, options.hold)
        out.append(result_of(ExtendedFit(problem, state, [s], free, options), wall))
    return out


def _fit_hekf(signals: list[SignalSet], mechanism: Mechanism, options: FitOptions) -> list[Outcome]:
    begun = time.perf_counter()
    free, given = free_mask(mechanism, options)
    starts = [hekf.first_estimate(s, mechanism, options, free, given) for s in signals]
    filters = [hekf.build_filter(s, mechanism, options, free, start.sigma) for s, start in zip(signals, starts)]
    same = all(np.array_equal(f.variance, filters[0].variance)
               and np.array_equal(f.torque_variance, filters[0].torque_variance) for f in filters)
    if not same:  # noise levels were estimated, record by record
        return [_alone(s, start, f, mechanism, options, free) for s, start, f in zip(signals, starts, filters)]
    first = [hekf.first_state(start, filters[0]) for start in starts]
    y = np.stack([hekf.measurements(s, filters[0].encoders) for s in signals])
    done = filters[0].run(y, np.stack([s.torque for s in signals]), np.stack([x for x, _ in first]),
                          np.stack([p for _, p in first]))
    wall = (time.perf_counter() - begun) / len(signals)
    return [_outcome(s, done, k, mechanism, options, free, wall) for k, s in enumerate(signals)]


def _alone(s: SignalSet, start: hekf.Start, filter_: hekf.Filter, mechanism: Mechanism, options: FitOptions,
           free: np.ndarray) -> Outcome:
    begun = time.perf_counter()
    x, p = hekf.first_state(start, filter_)
    done = filter_.run(hekf.measurements(s, filter_.encoders)[None], s.torque[None], x[None], p[None])
    return _outcome(s, done, 0, mechanism, options, free, time.perf_counter() - begun)


def _outcome(s: SignalSet, done: hekf.Filtered, k: int, mechanism: Mechanism, options: FitOptions,
             free: np.ndarray, wall: float) -> Outcome:
    if done.lost[k]:
        return FitError(f"the filter failed to integrate on {s.run}; use mle")
    n = mechanism.n
    return hekf.hekf_result([s], mechanism, options, free, done.x[k, 2 * n :], done.covariance[k, 2 * n :, 2 * n :],
                            wall)
