"""`diagnose`: what the simulation gets wrong, the cause, and what extending the model gains.

1. Hold; nominal fit; scores of the library and of generic terms, with the nominal parameters projected out.
2. Friction smoothing velocity, with the likeliest single effect or generic terms; then 1 again.
3. Search of sets of effects, from singles to triples.
4. Free runs of the confirm runs, once. A cause is named only if it reduces their error by a material amount.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc
from threadpoolctl import threadpool_limits

from daq import Dataset, FloatArray
from estimator.diagnosis import conclusion
from estimator.diagnosis.context import (
    DiagnosisContext,
    Explanation,
    best_shapes,
    detected,
    keys_of,
    p_of,
)
from estimator.diagnosis.data_split import RunSplit, split_runs
from estimator.diagnosis.decision_rule import ALPHA, EDGE, MATERIAL, SUFFICES, SURE, WIDTH
from estimator.diagnosis.error_budget import budget, generic_extension
from estimator.diagnosis.error_table import ErrorTable, known_errors, measure_errors
from estimator.diagnosis.further_effect import imitates, present_too, with_one_more
from estimator.diagnosis.noise_check import declared_levels, in_words, noisy_sensors, with_declared_noise
from estimator.diagnosis.noise_floor import noise_floor
from estimator.diagnosis.probability import probability_of, probability_of_no_error
from estimator.diagnosis.refit import (
    Model,
    bootstrap_scores,
    deviance,
    fit_nominal,
    likeliest_smoothing_velocity,
    refit,
    score_discover,
    tests_of,
)
from estimator.diagnosis.result import CandidateScore, Diagnosis
from estimator.diagnosis.rotation import account
from estimator.diagnosis.score_statistics import RunScore, ScoreTests, columns_of
from estimator.diagnosis.search import Progress, Promise, fit_likeliest, grown, search
from estimator.diagnosis.structure import with_structure
from estimator.diagnosis.verdict import IMITATES, NOMINAL, by_error, decide, first_of_each, unnamed
from estimator.effects import Effect, SensorTimeSkew, battery, library
from estimator.errors import FitError
from estimator.fitting import between_samples, describe_smoothing_velocity
from estimator.likelihood import Candidate
from estimator.model import Mechanism
from estimator.numerics import jit
from estimator.options import AUTO, FitOptions
from estimator.parallel import cores
from estimator.prediction import FloorNoise


def diagnose(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, *, gear_ratio: float = 1.0,
             seed: int = 0, progress: Progress | None = None,
             reference: Mapping[str, tuple[float, float]] | None = None, workers: int | None = None,
             material: float = MATERIAL) -> Diagnosis:
    """Diagnose the runs of one rig, in the order of recording.

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
            held_out = {split.names[i] for i in split.confirm}  # they choose nothing
            place = {name: k for k, name in enumerate(split.names)}  # nothing hangs on the order in which runs came
            seen = sorted((d for d in datasets if d.name not in held_out), key=lambda d: place.get(d.name, 0))
            hold, mechanism = between_samples(seen, mechanism, options)
            seeks = options.smoothing_velocity == AUTO and any(p.term == "coulomb" for p in mechanism.parameters)
            split = replace(split, mechanism=mechanism, options=replace(
                split.options, hold=hold, smoothing_velocity="given"))
            found = _diagnose(split, seed, say, reference, material, stated if seeks else None)
            mechanism = found.mechanism or mechanism
    except FitError as error:
        found = Diagnosis("fit_failed", f"No diagnosis: {error}.")
    told = describe_smoothing_velocity(stated, mechanism)
    return replace(found, hold=hold, mechanism=mechanism, wall_s=time.perf_counter() - start,
                   warnings=(*found.warnings, *([told] if told else [])))


def _diagnose(split: RunSplit, seed: int, say: Progress, reference: Mapping[str, tuple[float, float]] | None,
              material: float, stated: Mechanism | None) -> Diagnosis:
    """The diagnosis of runs that are split; friction's smoothing velocity is estimated from `stated`, if given."""
    say("fitting the nominal model", 0.02)
    rng = np.random.default_rng(seed)
    jit.expect()
    effects, refused = library(split.mechanism, split.has_imu, split.encoders)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    named = len(candidates)
    candidates += [Candidate(e) for e in battery(split.mechanism, split.has_imu, split.encoders)]
    context, tests = scored(split, candidates, named, rng, say)
    generic = None
    if stated is not None and detected(context, tests):
        generic = generic_extension(context, context.nominal, tests)
        other = smoothing_velocity_with(context, tests, generic, stated)
        if other is not None:
            with suppress(FitError):
                context, tests = scored(replace(split, mechanism=other, stiction={}), candidates, named, rng, say,
                                        context.bias)
    nominal = context.nominal
    base = conclusion.base(nominal, refused, reference)
    base = replace(base, candidates=rank(context, tests), separability=separability(context, tests))
    if not detected(context, tests):
        if context.noise_dominated:
            raise FitError(context.noise_dominated)
        floor = noise_floor(nominal)
        table = nominal_errors(context, floor, rng)
        hidden = hidden_motion(nominal, material, rng)
        if (table is None or table.error(NOMINAL) <= EDGE) and not hidden:
            base = conclusion.with_noise(base, nominal, floor)
            if table is not None:
                error = table.error(NOMINAL)
                base = replace(base, error=(error, error), probability=probability_of_no_error(table, rng))
            base = conclusion.with_blind_sensors(base, table)
            return replace(conclusion.nothing(base), mechanism=nominal.split.mechanism)
    known: list[ErrorTable] = []
    if generic is None or generic.split is not context.split:
        generic = generic_extension(context, nominal, tests)
    noise = None if generic is None else noise_floor(generic)
    found = search(context, tests, say, lambda found: promise(context, found, noise, material, rng, known))
    say("simulating the held-out runs", 0.85)
    concluded = conclude(context, base, generic, found, rng, material, known)
    return replace(with_structure(concluded, nominal), mechanism=nominal.split.mechanism)


def scored(split: RunSplit, candidates: list[Candidate], named: int, rng: np.random.Generator, say: Progress,
           bias: Sequence[RunScore] = ()) -> tuple[DiagnosisContext, ScoreTests]:
    """The nominal fit and the scores of `candidates` at it, less their `bias`, which is simulated if it is not given.

    Raises `FitError`."""
    nominal = fit_nominal(split)
    say("scoring the library", 0.15)
    scores = score_discover(nominal, candidates)
    if not bias:
        say("simulating bootstrap replicates", 0.2)
        try:
            bias = bootstrap_scores(nominal, candidates, scores, rng)
        except FitError:  # a fit that is far wrong can have negative friction, and its simulation diverge
            bias = [RunScore(np.zeros_like(s.score), s.information) for s in scores]
    context = DiagnosisContext(candidates, columns_of(candidates), named, list(bias), nominal, rng)
    return context, tests_of(nominal, scores, bias)


def smoothing_velocity_with(context: DiagnosisContext, tests: ScoreTests, generic: Model | None, stated: Mechanism
                            ) -> Mechanism | None:
    """The mechanism with its smoothing velocity estimated from `stated` together with the likeliest of the effects of
    the largest scores and of `generic` terms; None if it stays.

    Without what the nominal model lacks, a larger smoothing velocity absorbs part of it.
    """
    single = fit_likeliest(context, grown(context, [Explanation(context.nominal, 0.0, tests)])[:WIDTH])
    models = [m for m in (single, generic) if m is not None]
    if not models:
        return None
    try:
        found = likeliest_smoothing_velocity(min(models, key=deviance), stated)
    except FitError:
        return None
    return None if np.array_equal(found.velocity_scales, context.split.mechanism.velocity_scales) else found


def rank(context: DiagnosisContext, tests: ScoreTests) -> tuple[CandidateScore, ...]:
    """Every effect of the library as scored."""
    out = []
    for i in best_shapes(context, tests):
        effect, columns = context.candidates[i].effect, context.columns[i]
        detectable = tests.detectable(int(columns[0]), ALPHA / context.trials, context.material(context.split.discover))
        out.append(CandidateScore(effect.name, None if effect.joint is None else effect.joint + 1,
                          float(np.sqrt(max(context.gain(tests, i), 0.0))), p_of(context, tests, i),
                          float(tests.size(columns)[0]), max(detectable, context.split.open_size(effect)),
                          context.split.mechanism.unit(effect.sizes[0].unit)))
    return tuple(out)


def separability(context: DiagnosisContext, tests: ScoreTests) -> tuple[tuple[str, ...], FloatArray]:
    """Cosines between what the best shapes of the library would add, nominal parameters projected out."""
    order = best_shapes(context, tests)[:14]
    first = np.array([context.columns[i][0] for i in order])
    information = tests.information[np.ix_(first, first)]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return tuple(context.candidates[i].effect.key for i in order), information / np.outer(scale, scale)


def hidden_motion(model: Model, material: float, rng: np.random.Generator) -> str:
    """The sensor whose noise hides motion, in words; empty without one.

    A sensor noisier than declared is a fault of the simulation only if the model with the declared noise predicts the
    held-out runs materially better or worse, or cannot be fitted. The noise that neighbouring samples show is no more
    than a guess: that of a sensor without a declared noise must predict them better.
    """
    noisy = noisy_sensors(model)
    if not noisy:
        return ""
    text = in_words(*max(noisy.items(), key=lambda one: one[1]))
    levels = declared_levels(model)
    declared, better, worse = any(levels[channel] is not None for channel in noisy), (1, 0), (0, 1)
    try:
        models = [model, with_declared_noise(model)]
        table = measure_errors(models, model, rng.integers(2**63, size=len(model.split.confirm)))
    except (FitError, np.linalg.LinAlgError):
        return text if declared else ""
    draws = table.draws(rng)
    differs = max(table.lowers(a, b, material, draws, b) for a, b in ((better, worse) if declared else (better,)))
    return text if differs >= SURE else ""


def nominal_errors(context: DiagnosisContext, floor: FloorNoise, rng: np.random.Generator) -> ErrorTable | None:
    """Errors of the nominal model's free runs on the confirm runs in units of what the noise `floor` leaves; None where
    they diverge."""
    nominal = context.nominal
    try:
        return measure_errors([nominal], nominal, rng.integers(2**63, size=len(nominal.split.confirm)), noise=floor)
    except FitError:
        return None


def promise(context: DiagnosisContext, found: Sequence[Explanation], floor: FloorNoise | None, material: float,
            rng: np.random.Generator, known: list[ErrorTable]) -> Promise:
    """Whether other sets of effects, and larger ones, than those `found` can be materially better.

    The least error must leave room for that above the noise `floor`, which is that of the nominal model with generic
    terms: a wrong effect counts what it leaves as a disturbance. None: the floor of the best of `found`. For larger
    sets the last effect must have reduced the error by a good part of the material amount; a second effect is tried
    without that, too, where the error is larger than a disturbance explains. Measured errors are appended to `known`.
    """
    best = by_error(first_of_each(found))
    models = [context.nominal, *(e.model for e in best)]
    try:
        table = known_errors(known, models)
        if table is None:
            table = measure_errors(models, models[1], rng.integers(2**63, size=len(context.split.confirm)),
                                   noise=floor or noise_floor(models[1]))
    except FitError:
        return Promise(True, True)
    known.append(table)
    count = max(len(m.effects) for m in models)
    last, before = (min(table.error(k) for k, m in enumerate(models) if (len(m.effects) == count) is own)
                    for own in (True, False))
    least = min(last, before)
    better = least * (1.0 - material) > 1.0
    return Promise(better, better and ((count == 1 and least > EDGE) or last < before * (1.0 - SUFFICES * material)))


def conclude(context: DiagnosisContext, base: Diagnosis, generic: Model | None, options: Sequence[Explanation],
             rng: np.random.Generator, material: float = MATERIAL, known: Sequence[ErrorTable] = ()) -> Diagnosis:
    """Verdict, gain and budget by the confirm runs, and what a report draws; errors that are `known` already."""
    split = context.split
    try:
        decision = decide(context, generic, options, material, rng, known)
    except FitError as error:  # something was detected, or nothing would be decided here
        why = f"every simulation of the held-out runs diverges ({error})"
        return conclusion.unexplained(base, context.nominal, None, why)
    if decision is None:
        nominal = context.nominal
        floor = noise_floor(nominal)
        base = conclusion.with_noise(base, nominal, floor)
        table, hidden = nominal_errors(context, floor, rng), hidden_motion(nominal, material, rng)
        left = 0.0 if table is None else table.error(NOMINAL)
        large = "" if left <= EDGE else f"the free-run error is {left:.1f} times that of noise alone"
        why = large or hidden or context.noise_dominated
        if why:
            return conclusion.unexplained(base, nominal, None, why)
        sure = None if table is None else probability_of_no_error(table, rng)
        return replace(conclusion.nothing(conclusion.with_blind_sensors(base, table)), probability=sure)
    more: list[Explanation] = []
    if decision.verdict in ("named", "partial"):
        more = with_one_more(context, decision.best[0])
        if imitates(context, decision.best[0], more):
            decision = unnamed(decision, generic, material, IMITATES)
    base = replace(base, material=material, budget=budget(decision.table, decision.row, decision.without,
                                                          decision.best[0].model if decision.best else None,
                                                          decision.draws),
                   error=(decision.table.error(NOMINAL), decision.table.error(decision.row)),
                   compared=decision.compared,
                   rotations=account(split, decision.turns, decision.table, decision.row, material))
    if decision.verdict != "named" and decision.terms is not None:
        base = replace(base, remainder=conclusion.remainder_of(decision.terms))
    best = decision.best[0] if decision.best else None
    base = conclusion.with_noise(base, best.model if best else context.nominal, decision.table.unit.noise)
    hidden = hidden_motion(best.model if best else context.nominal, material, rng) if decision.verdict == "none" else ""
    p = 1.0 if best is None else chance_of(context, best, best.gain, best.model.effects)
    if not hidden:
        base = replace(base, probability=probability_of(decision, material))
    if decision.verdict == "none" and not hidden:
        return conclusion.nothing(conclusion.with_blind_sensors(base, decision.table), best, p)
    if decision.verdict in ("none", "unexplained") or best is None:
        return conclusion.unexplained(base, context.nominal, best, hidden or decision.why, rng,
                                      decision.table.unit.noise, p)
    minor = present_too(context, best, more)
    if minor is not None:
        added = [e for e in minor.model.effects if e.key not in keys_of(best)]
        base = conclusion.with_minor(base, best, minor, chance_of(context, minor, minor.gain, added))
    indistinguishable = [with_clock(context, best), *decision.best[1:]]
    return conclusion.finding(base, context.nominal, indistinguishable, p, rng, decision.verdict == "partial",
                              decision.table.unit.noise)


def with_clock(context: DiagnosisContext, explanation: Explanation) -> Explanation:
    """Re-fitted with the IMU's time line free where the recorder's clocks leave it open; as it was where that fails."""
    model, bound, skew = explanation.model, context.split.clock_bound_s, SensorTimeSkew()
    if not context.split.has_imu or bound <= 0.0 or skew.key in {e.key for e in model.effects}:
        return explanation
    try:
        again = refit(model, [*zip(model.effects, model.sizes()), (skew, np.zeros(1))])
    except (FitError, np.linalg.LinAlgError):
        return explanation
    if not again.state.converged or abs(again.state.beta[-1]) > bound:
        return explanation
    return replace(explanation, model=replace(again, nuisances=1))


def chance_of(context: DiagnosisContext, explanation: Explanation, gain: float, effects: Sequence[Effect]) -> float:
    """p-value, over all that were tried, of the gain that `effects` of an explanation make."""
    count = sum(len(e.sizes) for e in effects)
    return max(1e-12, min(1.0, float(fdtrc(count, explanation.left.freedom, max(gain, 0.0) / count)) * context.trials))
