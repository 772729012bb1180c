"""`detect_change`: what tells test runs from reference runs; `compare_sessions`: the same of two equal sessions."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, FloatArray
from estimator.change.contrast import Contrast, contrast, difference, seen
from estimator.change.free_runs import error_levels, larger_error
from estimator.change.groups import groups_of
from estimator.change.loop_law import with_changed_law
from estimator.change.noise import compare_noise, levels_of, with_noise
from estimator.change.reference import Reference, require_runs
from estimator.change.result import Change, LevelChange
from estimator.change.scores import ReferenceFit, fit_reference, noisiness, score_run
from estimator.change.structure import find_structure
from estimator.change.verdict import (
    AGAINST,
    SESSIONS,
    Fold,
    Scored,
    basis_of,
    conclude,
    likeliest_changes,
    with_errors,
)
from estimator.fit_errors import FIT_ERRORS
from estimator.loops import LawSizes, changed_law, volts_of, without_changes
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.score import ALPHA, Score, total

STEPS = 2
"""Times that a change is estimated anew, at the model with the change of before."""
FEW_RUNS = 4
"""Fewer runs of a session than these give a warning that their scatter is poorly known."""


def detect_change(test: Sequence[Dataset], reference: Reference) -> Change:
    """Change between the `reference` runs and `test` runs of one rig, by the laws of position loops first; data that
    cannot tell give `fit_failed`."""
    return _after_law(reference.law, test, reference.fit.model.mechanism, lambda left: _detected(left, reference))


def _after_law(law: LawSizes, test: Sequence[Dataset], mechanism: Mechanism,
               compare: Callable[[Sequence[Dataset]], Change]) -> Change:
    """The change by the laws of loops and, without what these show, by the leg."""
    changes = changed_law(law, test, mechanism)
    left = without_changes(test, mechanism, changes)
    return with_changed_law(compare(left), changes, mechanism, volts_of(left))


def _detected(test: Sequence[Dataset], reference: Reference) -> Change:
    fit, structure = reference.fit, reference.structure

    def compare() -> Change:
        require_runs(test)
        noise = compare_noise(levels_of(test, fit.model.mechanism, fit.options), reference.noise)
        own = with_noise(fit, [one for one in noise if one.p_value < ALPHA])
        groups = groups_of(fit, reference.known)

        def against(some: Sequence[Score]) -> Contrast:
            return contrast(total(some), reference.known, structure)

        def scored(shift: FloatArray | None) -> tuple[Scored, list[Fold]]:
            parts = seen([score_run(fit, d, own, shift) for d in test], structure)
            folds = [Fold(d.name, against(parts[:k] + parts[k + 1 :]), against([parts[k]]))
                     for k, d in enumerate(test)]
            return Scored(groups, against(parts), structure), folds

        found = conclude(fit, *_relinearised(scored), noise, AGAINST)
        if found.verdict != "no_change":
            return found
        return with_errors(found, lambda: larger_error(error_levels(fit, test), reference.errors), AGAINST)

    few = len(reference.runs) < FEW_RUNS
    found = _timed(compare)
    return replace(found, reference=reference.runs, test=tuple(d.name for d in test), warnings=(*found.warnings, *(
        f"{len(reference.runs)} reference runs: their scatter is poorly known; four or more are better",) * few))


def compare_sessions(a: Sequence[Dataset], b: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, *,
                     gear_ratio: float = 1.0, pairs: int = 1) -> Change:
    """Change from session `a` to session `b`; sizes are those of b less those of a.

    The model is that of the session which it leaves less noise in: a fit to a session with a fault may be far off. The
    scatter is that of runs within their sessions, so exchanging a and b turns the signs and nothing else.
    p-values are over all `pairs` of sessions. The laws of position loops are compared first.
    """
    return _after_law(LawSizes.of(a, mechanism), b, mechanism,
                      lambda left: _compared(a, left, mechanism, options, gear_ratio, pairs))


def _compared(a: Sequence[Dataset], b: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float,
              pairs: int) -> Change:
    def compare() -> Change:
        require_runs(a)
        require_runs(b)
        fits = [fit_reference(runs, mechanism, options, gear_ratio) for runs in (a, b)]
        fit = min(fits, key=noisiness)
        levels = [levels_of(runs, mechanism, options) for runs in (a, b)]
        noise = compare_noise(levels[1], levels[0])
        there = compare_noise(*levels) if fit is fits[1] else noise
        own = with_noise(fit, [one for one in there if one.p_value < ALPHA])
        known = [[score_run(fit, d, None if fit is its else own) for d in runs] for runs, its in zip((a, b), fits)]
        begun = find_structure(known, fit.model.mechanism.p)
        groups = groups_of(fit, total(seen([*known[0], *known[1]], begun)))

        def scored(shift: FloatArray | None) -> tuple[Scored, list[Fold]]:
            scores = known if shift is None else [
                its if fit is fits[k] else [score_run(fit, d, own, shift if k else -shift) for d in (a, b)[k]]
                for k, its in enumerate(known)]
            structure = begun if shift is None else find_structure(scores, fit.model.mechanism.p)
            first, second = (seen(runs, structure) for runs in scores)

            def between(some: Sequence[Score], others: Sequence[Score]) -> Contrast:
                return difference(total(some), total(others), structure)

            folds = [Fold(d.name, between(first[:k] + first[k + 1 :], second), between([first[k]], second))
                     for k, d in enumerate(a)]
            folds += [Fold(d.name, between(first, second[:k] + second[k + 1 :]), between(first, [second[k]]))
                      for k, d in enumerate(b)]
            return Scored(groups, between(first, second), structure, pairs), folds

        found = conclude(fit, *_relinearised(scored), noise, SESSIONS)
        if found.verdict != "no_change":
            return found
        for its, runs, others in ((fits[0], a, b), (fits[1], b, a)):
            def rise(its: ReferenceFit = its, runs: Sequence[Dataset] = runs, others: Sequence[Dataset] = others
                     ) -> LevelChange | None:
                left_out = error_levels(its, runs, [score_run(its, d) for d in runs])
                return larger_error(error_levels(its, others), left_out, 2 * pairs)

            found = with_errors(found, rise, SESSIONS)
        return found

    few = min(len(a), len(b)) < FEW_RUNS
    found = _timed(compare)
    return replace(found, reference=tuple(d.name for d in a), test=tuple(d.name for d in b), warnings=(
        *found.warnings, *("fewer than four runs of a session: their scatter is poorly known",) * few))


def _timed(compare: Callable[[], Change]) -> Change:
    """The answer with its time; `fit_failed` with the reason for data that cannot tell."""
    begin = time.perf_counter()
    try:
        with np.errstate(all="ignore"):  # a search may diverge on its way; where it ends is checked
            found = compare()
    except FIT_ERRORS as error:
        found = Change("fit_failed", f"No comparison: {error}.")
    return replace(found, wall_s=time.perf_counter() - begin)


def _relinearised(scored: Callable[[FloatArray | None], tuple[Scored, list[Fold]]]) -> tuple[Scored, list[Fold]]:
    """The scores at the likeliest change, where there is one: a large change is not linear."""
    found = scored(None)
    for _ in range(STEPS):
        order = found[0].order
        if found[0].p_value(order[0]) >= ALPHA:
            break
        basis = basis_of(found[0].groups, likeliest_changes(found[0], order))
        try:
            found = scored(basis @ found[0].contrast.along(basis).size())
        except FIT_ERRORS:
            break
    return found
