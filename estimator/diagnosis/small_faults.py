"""`without_small_faults`: a nominal model of readings less what is likeliest wrong with their sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daq import FloatArray
from estimator.diagnosis.decision_rule import MATERIAL, SUFFICES
from estimator.diagnosis.model import Model, nearby, nominal_model, score_train, smooth
from estimator.diagnosis.tolerances import marginalised
from estimator.effects import GenericReading, GenericTorque
from estimator.fit_errors import FIT_ERRORS
from estimator.likelihood import Candidate
from estimator.parallel import parallel_map
from estimator.score import BEYOND, Nuisance, Score, nuisance_candidates, nuisances_of, project, total
from estimator.signals import Channel, SignalSet


def without_small_faults(nominal: Model) -> Model:
    """`nominal` fitted anew to readings less the likeliest faults of sensors within their tolerances.

    As it was where these gain too little, there is no such fit, or a position loop acts on what an encoder reads.
    """
    split, stated = nominal.split, nominal.split.tolerances
    if stated is None or split.mechanism.followers or not np.isfinite(nominal.state.covariance).all():
        return nominal
    effects = [one for one in nuisance_candidates(nominal.problem, stated)
               if not isinstance(one.effect, GenericTorque | GenericReading)]
    scores, nuisances = score_train(nominal, effects), nuisances_of(effects, nominal.problem, stated)
    sizes = small_sizes(nominal, scores, effects, nuisances)
    if total(scores).score[nominal.state.beta.size :] @ sizes < MATERIAL**2 * nominal.problem.total:
        return nominal
    ends = np.cumsum([len(one.effect.sizes) for one in effects])[:-1]
    taken = {one.effect.key: own for one, own in zip(effects, np.split(sizes, ends), strict=True) if own.any()}
    try:
        runs = parallel_map(lambda run: without_faults(nominal, run, effects, taken), len(split.runs), split.workers)
        less = replace(split, runs=tuple(runs), read=split.runs, taken=taken, stiction={})
        return nominal_model(less, nearby(nominal))
    except FIT_ERRORS:
        return nominal


def small_sizes(model: Model, scores: Sequence[Score], effects: Sequence[Candidate], nuisances: Sequence[Nuisance]
                ) -> FloatArray:
    """(k,) likeliest size of each of the `nuisances` that is of a reading, laws at zero.

    All are zero where one is beyond BEYOND tolerances, or where the effect of the largest gain alone is a law or beyond
    them and explains more than SUFFICES of what all readings do: a fit that lacks a cause says little of small faults.
    """
    p, tolerance = model.state.beta.size, np.array([own.tolerance for own in nuisances])
    keys, reading = (np.array([getattr(own, name) for own in nuisances]) for name in ("source", "reading"))
    found = marginalised(model, scores, effects, [own._replace(tolerance=own.tolerance * own.reading)
                                                  for own in nuisances])
    sizes, used = np.zeros(tolerance.size), np.flatnonzero(tolerance * reading)
    if found is not None and used.size:
        tests = project(scores, p)
        sizes[used] = found.step[p : p + used.size]
        best = max((np.flatnonzero(keys == key) for key in dict.fromkeys(keys)), key=tests.gain)
        alone = tests.size(best)
        another = np.any(~reading[best] | (np.abs(alone) > BEYOND * tolerance[best]))
        if np.any(np.abs(sizes) > BEYOND * tolerance) or (
                another and alone @ tests.score[best] > SUFFICES * sizes @ tests.score):
            sizes[:] = 0.0
    return sizes


def taken_in_words(model: Model) -> list[str]:
    """A sentence on what is taken off the readings, with each size of at least half its tolerance; empty for nothing.
    """
    m, taken, stated = model.split.mechanism, model.split.taken, model.split.tolerances or {}
    told: list[str] = []
    for one in nuisance_candidates(model.problem, stated) if taken else ():
        sizes, own = one.effect.sizes, taken.get(one.effect.key, ())
        told += [f"{one.effect.key.replace('@', ' at joint ')}, {size.name} {value:.2g}"
                 f"{' ' * (size.unit != '1')}{m.unit(size.unit).strip('1')}"
                 for size, value, nuisance in zip(sizes, own, nuisances_of([one], model.problem, stated))
                 if abs(value) >= 0.5 * nuisance.tolerance]
    return [f"small faults of sensors, within their tolerances, were taken off the readings{': ' * bool(told)}"
            f"{'; '.join(told).replace('_', ' ')}"] if taken else []


def without_faults(model: Model, run: int, effects: Sequence[Candidate], taken: Mapping[str, FloatArray]
                   ) -> tuple[SignalSet, ...]:
    """Segments of a run less what `effects` of the sizes `taken` add to the readings of its smoothed motion."""
    found = smooth(model, run)
    problem, state = found.problem, found.state
    view = replace(problem.view(state.x, state.beta[: problem.mechanism.p]), measured=problem.record)
    added: dict[Channel, FloatArray] = {}
    for one in effects:
        if one.effect.key in taken:
            size = np.append(taken[one.effect.key], one.shape)
            for channel, values in one.effect.perturb(view, size).readings.items():
                added[channel] = added.get(channel, 0.0) + values
    return tuple(s.less({channel: values[a:b] for channel, values in added.items()})
                 for s, (a, b) in zip(model.split.runs[run], pairwise([0, *problem.ends]), strict=True))
