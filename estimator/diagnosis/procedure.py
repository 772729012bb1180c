"""`diagnose`: what the simulation gets wrong, the cause, and what extending the model gains.

    runs    = split_runs(datasets)            train and test runs
    begun   = begin(runs, library)            fit and scores of the train runs
    found   = search(begun)                   sets of effects, by the train runs alone
    family  = family_of(found)                the answer, and every model that its verdict asks for
    table   = measure_first(family)           free-run errors on the test runs, which are looked at here first
    verdict = decide(table, family)           no fit, no simulation, no random number
    table   = measure_all(family)             where the verdict is open: each run a test run once
    return describe(verdict, table, family)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from daq import Dataset
from estimator.diagnosis import account
from estimator.diagnosis.context import (
    DiagnosisContext,
    Progress,
    detected,
    generic_extension,
    rank,
    scored,
    separability,
)
from estimator.diagnosis.data_split import RunSplit, split_runs
from estimator.diagnosis.decision_rule import EDGE, MATERIAL, WIDTH
from estimator.diagnosis.explanation import Explanation, by_error, first_of_each
from estimator.diagnosis.family import family_of, measure_all, measure_first
from estimator.diagnosis.model import Model, likeliest_smoothing_velocity, nearby, nominal_model, refit
from estimator.diagnosis.noise_check import noisy_sensors
from estimator.diagnosis.result import Diagnosis, Rotation
from estimator.diagnosis.search import fit_sets, grown, pairs_of, search
from estimator.diagnosis.small_faults import without_small_faults
from estimator.diagnosis.structure import with_structure
from estimator.diagnosis.train_errors import surely_errs_less, train_table
from estimator.diagnosis.uses import with_uses
from estimator.diagnosis.verdict import decide, probability_of
from estimator.effects import battery, library
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.fitting import describe_smoothing_velocity, fit_nominal
from estimator.likelihood import Candidate, State
from estimator.model import Mechanism
from estimator.numerics import load_compiler
from estimator.options import AUTO, FitOptions
from estimator.parallel import cores
from estimator.score import ScoreTests


def diagnose(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, *, gear_ratio: float = 1.0,
             seed: int = 0, progress: Progress | None = None,
             reference: Mapping[str, tuple[float, float]] | None = None, workers: int | None = None,
             material: float = MATERIAL, terms: Callable[[Sequence[Dataset]], Collection[str]] = lambda _: ()
             ) -> Diagnosis:
    """Diagnose the runs of one rig, in the order of recording.

    `terms` says which optional parameters, such as torque_offset_2, a fit of some runs would choose; none by default.

    `reference` is (value, std) by parameter of an earlier model: changed inertial parameters are reported as a
    payload. Independent fits share `workers` processes, by default one a core. Data that cannot be diagnosed give the
    verdict `fit_failed` with the reason, never an exception. Matrix products take one thread each meanwhile: they are
    small, and processes that share cores hinder each other.
    """
    start = time.perf_counter()
    say = progress or (lambda stage, fraction: None)
    hold, stated = options.hold, mechanism
    try:
        with threadpool_limits(1), np.errstate(all="ignore"):  # a search may diverge; its end is checked
            split = split_runs(datasets, mechanism, options, gear_ratio, cores() if workers is None else workers)
            tests = {split.names[i] for i in split.test}  # they choose nothing
            place = {name: k for k, name in enumerate(split.names)}  # nothing hangs on the order in which runs came
            seen = sorted((d for d in datasets if d.name not in tests), key=lambda d: place.get(d.name, 0))
            hold, mechanism, near, delays = fit_nominal(seen, mechanism, split.options)
            seeks = options.smoothing_velocity == AUTO and any(p.term == "coulomb" for p in mechanism.parameters)
            split = replace(split, mechanism=mechanism, delays_s=delays, options=replace(
                split.options, hold=hold, smoothing_velocity="given"))
            found = _diagnose(split, near, seed, say, reference, material, stated if seeks else None, terms(seen))
            mechanism = found.mechanism or mechanism
    except FitError as error:
        found = Diagnosis("fit_failed", f"No diagnosis: {error}.")
    told = describe_smoothing_velocity(stated, mechanism)
    return replace(found, hold=hold, mechanism=mechanism, wall_s=time.perf_counter() - start,
                   warnings=(*found.warnings, *([told] if told else [])))


def _diagnose(split: RunSplit, near: State | None, seed: int, say: Progress,
              reference: Mapping[str, tuple[float, float]] | None, material: float, stated: Mechanism | None,
              wanted: Collection[str]) -> Diagnosis:
    """The diagnosis of runs that are split, from their fit `near`; friction's smoothing velocity is estimated from
    `stated`, if given. A fit would choose the `wanted` terms."""
    say("fitting the nominal model", 0.02)
    rng = np.random.default_rng(seed)
    load_compiler()
    effects, refused = library(split.mechanism, split.has_imu, split.encoders)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    named = len(candidates)
    candidates += [Candidate(e) for e in battery(split.mechanism, split.has_imu, split.encoders)]

    def anew(nominal: Model) -> Begun:
        return begin(nominal, candidates, named, rng, say, material)

    begun = anew(without_small_faults(nominal_model(split, near)))
    if stated is not None and begun.there:
        other = with_smoothing_velocity(begun, stated)
        if other is not None:
            begun = anew(other)
    found = searched(begun, say)
    context = begun.context
    context.terms = [e for e in effects if wanted and
                     f"{e.name}_{1 + (split.mechanism.actuated[0] if e.joint is None else e.joint)}" in wanted]
    base = account.base(context.nominal, refused, reference)
    base = replace(base, candidates=rank(context, begun.tests), separability=separability(context, begun.tests))
    say("simulating the held-out runs", 0.85)
    concluded = conclude(context, base, found, begun.generic, rng)
    read = replace(context.nominal, split=context.nominal.split.as_read())
    whole = with_uses(with_structure(concluded, read), read)
    return replace(whole, mechanism=context.nominal.split.mechanism)


class Begun(NamedTuple):
    """The nominal model of some runs, and what its scores show."""

    context: DiagnosisContext
    tests: ScoreTests
    there: bool
    """Whether a term is detected."""
    generic: Model | None
    """With generic terms, where any is significant."""


def begin(nominal: Model, candidates: list[Candidate], named: int, rng: np.random.Generator, say: Progress,
          material: float) -> Begun:
    """The scores of `candidates` at a nominal fit, and what they show."""
    context, tests = scored(nominal, candidates, named, rng, say)
    there = detected(context, tests)
    generic = generic_extension(context, nominal, tests) if there else None
    context.share = material
    return Begun(context, tests, there, generic)


def searched(begun: Begun, say: Progress) -> list[Explanation]:
    """Explanations of what is there. Raises `FitError` where noise hides whether anything is."""
    if begun.there or large(begun.context):
        return search(begun.context, begun.tests, say)
    if begun.context.noise_dominated:
        raise FitError(begun.context.noise_dominated)
    return []


def large(context: DiagnosisContext) -> bool:
    """Whether explanations are sought even where no term is detected: the nominal model errs more on the train runs
    than noise explains, or a sensor's noise may hide motion."""
    return bool(noisy_sensors(context.nominal)) or EDGE < least_error(context, []) < np.inf


def least_error(context: DiagnosisContext, explanations: Sequence[Explanation]) -> float:
    """The least error of the nominal model and of explanations on the train runs, over that of noise; infinite where
    none can be simulated."""
    with suppress(FitError):
        best = by_error(first_of_each(explanations))
        table = train_table(context, best)
        return min(table.error(k) for k in range(1 + len(best)))
    return np.inf


def conclude(context: DiagnosisContext, base: Diagnosis, explanations: Sequence[Explanation], generic: Model | None,
             rng: np.random.Generator) -> Diagnosis:
    """The account of what is decided on the test runs, and where that is open on all runs."""
    material = context.share
    try:
        family = family_of(context, explanations, generic)
        first = measure_first(family, rng)
    except FitError as error:
        return account.undecided(base, f"every simulation of the held-out runs diverges ({error})")
    table, rotations = first, tuple[Rotation, ...]()
    decision = decide(first, family.rows, material)
    if decision.open and (every := measure_all(family, first, rng, material)) is not None:
        table, rotations = every
        decision = decide(table, family.rows, material)
    probability = probability_of(decision, table, family.rows, first, material)
    return account.describe(context, base, family, decision, table, first, rotations, probability, rng)


def with_smoothing_velocity(begun: Begun, stated: Mechanism) -> Model | None:
    """The nominal model with its smoothing velocity estimated from `stated` together with the likeliest of the effects
    of the largest scores and of generic terms; None if it stays.

    Without what the nominal model lacks, a larger smoothing velocity absorbs part of it. It stays where it surely
    predicts train runs better that are left out.
    """
    context = begun.context
    singles = fit_sets(context, grown(context, [Explanation(context.nominal, 0.0, begun.tests)])[:WIDTH])
    models = [m for m in (*(e.model for e in singles), begun.generic) if m is not None]
    if not models:
        return None
    likeliest = max(models, key=lambda m: m.log_marginal)
    try:
        found = likeliest_smoothing_velocity(likeliest, stated)
        if np.array_equal(found.velocity_scales, context.split.mechanism.velocity_scales):
            return None
        nominal = nominal_model(replace(context.split, mechanism=found, stiction={}), nearby(context.nominal))
        again = refit(nominal, pairs_of(likeliest))
        return None if surely_errs_less(likeliest, again, context.rng) else nominal
    except FIT_ERRORS:
        return None
