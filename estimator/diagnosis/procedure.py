"""`diagnose`: what the simulation gets wrong, the cause, and what extending the model gains.

1. Hold and friction smoothing velocity; nominal fit; detection by generic terms.
2. Scores of the library, with the nominal parameters projected out.
3. Full re-fits of the best singles, of all others if none explains the error, then pairs, then one triple.
4. Free runs of the confirm runs, once. A cause is named only if it reduces their error by a material amount.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc
from threadpoolctl import threadpool_limits

from daq import Dataset, FloatArray
from estimator.diagnosis import conclusion
from estimator.diagnosis.context import DiagnosisContext, Explanation, best_shapes, detected, least_gain, p_of, seated
from estimator.diagnosis.data_split import RunSplit, split_runs
from estimator.diagnosis.decision_rule import ALPHA, EDGE, FAR_WRONG, MATERIAL, MOST_ASSESSED, SUFFICES, SURE
from estimator.diagnosis.error_budget import budget
from estimator.diagnosis.error_table import ErrorTable, measure_errors
from estimator.diagnosis.model_search import (
    Progress,
    assess_residuals,
    closing,
    explain,
    fit_first,
    fit_others,
    fit_singles,
    keys_of,
)
from estimator.diagnosis.noise_check import in_words, noisy_sensors, with_declared_noise
from estimator.diagnosis.noise_floor import noise_floor
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
from estimator.diagnosis.result import CandidateScore, Cause, Diagnosis
from estimator.diagnosis.rotation import account
from estimator.diagnosis.score_statistics import RunScore, ScoreTests, columns_of
from estimator.diagnosis.structure import with_structure
from estimator.diagnosis.verdict import NOMINAL, Decision, by_likelihood, decide, first_of_each
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
            assert found is not None
            mechanism = found.mechanism or mechanism
    except FitError as error:
        found = Diagnosis("fit_failed", f"No diagnosis: {error}.")
    told = describe_smoothing_velocity(stated, mechanism)
    return replace(found, hold=hold, mechanism=mechanism, wall_s=time.perf_counter() - start,
                   warnings=(*found.warnings, *([told] if told else [])))


def _diagnose(split: RunSplit, seed: int, say: Progress, reference: Mapping[str, tuple[float, float]] | None,
              material: float, stated: Mechanism | None, bias: Sequence[RunScore] | None = None,
              ordinary: Model | None = None) -> Diagnosis | None:
    """The diagnosis; None if its smoothing velocity does not outperform that of the `ordinary` model.

    The friction smoothing velocity is estimated again together with the best explanation, from `stated`. If it differs,
    the diagnosis is repeated with it, with the same `bias` of the scores. `ordinary` has the smoothing velocity
    estimated without effects.
    """
    say("fitting the nominal model", 0.02)
    rng = np.random.default_rng(seed)
    jit.expect()
    nominal = fit_nominal(split)
    effects, refused = library(split.mechanism, split.has_imu, split.encoders)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    named = len(candidates)
    candidates += [Candidate(e) for e in battery(split.mechanism, split.has_imu, split.encoders)]
    say("scoring the library", 0.15)
    scores = score_discover(nominal, candidates)
    say("simulating bootstrap replicates", 0.2)
    if bias is None:
        try:
            bias = bootstrap_scores(nominal, candidates, scores, rng)
        except FitError:  # a fit that is far wrong can have negative friction, and its simulation diverge
            bias = [RunScore(np.zeros_like(s.score), s.information) for s in scores]
    context = DiagnosisContext(candidates, columns_of(candidates), named, list(bias), nominal, rng)
    tests = tests_of(nominal, scores, bias)
    ranked = rank(context, tests)
    base = conclusion.base(nominal, refused, reference)
    base = replace(base, candidates=ranked, separability=separability(context, tests))
    if not detected(context, tests):
        if context.noise_dominated:
            raise FitError(context.noise_dominated)
        if ordinary is not None:
            return None
        floor = noise_floor(nominal)
        error = nominal_error(context, floor, rng)
        hidden = hidden_motion(nominal, material, rng)
        if (error is None or error <= EDGE) and not hidden:
            base = conclusion.with_noise(base, nominal, floor)
            return conclusion.nothing(replace(base, error=None if error is None else (error, error)))
    known: list[ErrorTable] = []

    def promising(found: Sequence[Explanation]) -> bool:
        return promise(context, found, material, rng, known)

    def far_wrong() -> bool:
        return not known or known[-1].error(NOMINAL) > FAR_WRONG

    searched = search(context, tests, say, stated, promising, far_wrong)
    found, other = next(searched)
    while other is not None:
        with suppress(FitError):
            again = _diagnose(replace(split, mechanism=other, stiction={}), seed, say, reference, material, None, bias,
                              nominal)
            if again is not None:
                return again
        found, other = next(searched)
    say("simulating the held-out runs", 0.85)
    concluded = conclude(context, base, tests, found, rng, material, known, ordinary)
    return None if concluded is None else replace(with_structure(concluded, nominal), mechanism=split.mechanism)


def search(context: DiagnosisContext, tests: ScoreTests, say: Progress, stated: Mechanism | None,
           promise: Callable[[Sequence[Explanation]], bool], far_wrong: Callable[[], bool]
           ) -> Iterator[tuple[list[Explanation], Mechanism | None]]:
    """Fitted explanations, at the end with None.

    Before that, once at most and as soon as the likeliest has another smoothing velocity, those found so far with a
    mechanism that has it: asked for the next, the search goes on with the velocity that it began with.
    """
    def another(model: Model | None) -> Mechanism | None:
        nonlocal stated
        found = smoothing_velocity_with(model, stated)
        stated = stated if found is None else None
        return found

    say("re-fitting the best explanations", 0.4)
    first = fit_first(context, tests)
    other = another(likeliest_of(first))
    if other is not None:
        yield [], other
    options = fit_singles(context, tests, first)
    best = likeliest_of([e.model for e in options])
    other = None if any(best is m for m in first) else another(best)
    if other is not None:
        yield options, other
    say("scoring their residuals", 0.6)
    options = assess_residuals(context, seated(options, MOST_ASSESSED))
    if options and not promise(options):
        yield options, None
        return
    if far_wrong() and not any(e.adequate for e in closing(context, options)):
        say("re-fitting all others", 0.65)
        every = fit_others(context, tests, options)
        found = likeliest_of([e.model for e in every])
        if found is not None and not any(found is e.model for e in options):
            other = another(found)
            if other is not None:
                yield options, other
            options = assess_residuals(context, seated(every, MOST_ASSESSED))
    options = explain(context, tests, options, say, promise)
    more = max((e for e in options if len(e.model.effects) > 1), key=lambda e: (e.adequate, e.gain), default=None)
    other = None if more is None else another(more.model)
    if other is not None:
        yield options, other
    yield options, None


def likeliest_of(models: Sequence[Model]) -> Model | None:
    """The likeliest under its own noise."""
    return min(models, key=deviance, default=None)


def smoothing_velocity_with(model: Model | None, stated: Mechanism | None) -> Mechanism | None:
    """The mechanism with the smoothing velocity estimated together with `model`, from `stated`; None if unchanged."""
    if stated is None or model is None:
        return None
    try:
        found = likeliest_smoothing_velocity(model, stated)
    except FitError:
        return None
    return None if np.array_equal(found.velocity_scales, model.split.mechanism.velocity_scales) else found


def rank(context: DiagnosisContext, tests: ScoreTests) -> tuple[CandidateScore, ...]:
    """Every effect of the library as scored."""
    out = []
    for i in best_shapes(context, tests):
        effect, columns = context.candidates[i].effect, context.columns[i]
        detectable = tests.detectable(int(columns[0]), ALPHA / context.trials, least_gain(context, i))
        out.append(CandidateScore(effect.name, None if effect.joint is None else effect.joint + 1,
                          float(np.sqrt(max(context.gain(tests, i), 0.0))), p_of(context, tests, i),
                          float(tests.size(columns)[0]), max(detectable, effect.open_size(context.split.clock_bound_s)),
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
    held-out runs materially better or worse, or cannot be fitted.
    """
    noisy = noisy_sensors(model)
    if not noisy:
        return ""
    text = in_words(*max(noisy.items(), key=lambda one: one[1]))
    try:
        models = [model, with_declared_noise(model)]
        table = measure_errors(models, model, rng.integers(2**63, size=len(model.split.confirm)))
    except (FitError, np.linalg.LinAlgError):
        return text
    draws = table.draws(rng)
    differs = max(table.lowers(a, b, material, draws, b) for a, b in ((0, 1), (1, 0))) >= SURE
    return text if differs else ""


def nominal_error(context: DiagnosisContext, floor: FloorNoise, rng: np.random.Generator) -> float | None:
    """rms error of the nominal model's free runs on the confirm runs in units of what the noise `floor` leaves; None
    where they cannot be carried through."""
    nominal = context.nominal
    try:
        table = measure_errors([nominal], nominal, rng.integers(2**63, size=len(nominal.split.confirm)),
                               noise=floor)
    except FitError:
        return None
    return table.error(NOMINAL)


def promise(context: DiagnosisContext, found: Sequence[Explanation], material: float, rng: np.random.Generator,
            known: list[ErrorTable]) -> bool:
    """Whether more effects than those `found` have could be material.

    The error of fewer effects must be large enough, and the last effect must reduce it by a good part of the material
    amount, unless the error is larger than a disturbance explains. Measured errors are appended to `known`.
    """
    counts = sorted({len(e.model.effects) for e in found})
    best = by_likelihood(first_of_each(found))
    models = [context.nominal, *(e.model for e in best)]
    try:
        table = measure_errors(models, models[1], rng.integers(2**63, size=len(context.split.confirm)),
                               noise=noise_floor(models[1]))
    except FitError:
        return True
    known.append(table)
    errors = {n: min(table.error(k) for k, m in enumerate(models) if len(m.effects) == n) for n in (0, *counts)}
    last, before = errors[counts[-1]], min(error for n, error in errors.items() if n < counts[-1])
    return before * (1.0 - material) > 1.0 and (before > EDGE or last < before * (1.0 - SUFFICES * material))


def conclude(context: DiagnosisContext, base: Diagnosis, tests: ScoreTests, options: Sequence[Explanation],
             rng: np.random.Generator, material: float = MATERIAL, known: Sequence[ErrorTable] = (),
             ordinary: Model | None = None) -> Diagnosis | None:
    """Verdict, gain and budget by the confirm runs, and what a report draws; errors that are `known` already. None
    where nothing is established that betters the `ordinary` model."""
    split = context.split
    try:
        decision = decide(context, tests, options, material, rng, known)
    except FitError as error:  # something was detected, or nothing would be decided here
        if ordinary is not None:
            return None
        why = f"every simulation of the held-out runs diverges ({error})"
        return conclusion.unexplained(base, context.nominal, None, why)
    if ordinary is not None and not outdoes(decision, ordinary, material, rng):
        return None
    if decision is None:
        nominal = context.nominal
        floor = noise_floor(nominal)
        base = conclusion.with_noise(base, nominal, floor)
        left, hidden = nominal_error(context, floor, rng), hidden_motion(nominal, material, rng)
        large = "" if left is None or left <= EDGE else f"the free-run error is {left:.1f} times that of noise alone"
        why = large or hidden or context.noise_dominated
        return conclusion.unexplained(base, nominal, None, why) if why else conclusion.nothing(base)
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
    if decision.verdict == "none" and not hidden:
        return conclusion.nothing(base, best)
    if decision.verdict in ("none", "unexplained") or best is None:
        return conclusion.unexplained(base, context.nominal, best, hidden or decision.why, rng,
                                      decision.table.unit.noise)
    if decision.more is not None:
        base = replace(base, immaterial=minor_causes(context, base, decision.more, best))
    p = chance_of(context, best, best.gain, best.model.effects)
    indistinguishable = [with_clock(context, best), *decision.best[1:]]
    return conclusion.finding(base, context.nominal, indistinguishable, p, rng, decision.verdict == "partial",
                              decision.table.unit.noise)


def outdoes(decision: Decision | None, ordinary: Model, material: float, rng: np.random.Generator) -> bool:
    """True if a named cause reduces the test error by a material amount compared with the ordinary model."""
    if decision is None or decision.verdict not in ("named", "partial"):
        return False
    best = decision.best[0].model
    try:
        table = measure_errors([ordinary, best], best, rng.integers(2**63, size=len(best.split.confirm)))
    except FitError:
        return False
    return table.error(1) < (1.0 - material) * table.error(0)


def minor_causes(context: DiagnosisContext, found: Diagnosis, more: Explanation, best: Explanation
                 ) -> tuple[Cause, ...]:
    """Causes of `more` in addition to those of `best`."""
    added = [e for e in more.model.effects if e.key not in keys_of(best)]
    p = chance_of(context, more, more.gain_over_parent, added)
    places = {(e.name, None if e.joint is None else e.joint + 1) for e in added}
    return tuple(c for c in conclusion.causes_of(more, p, found) if (c.effect, c.joint) in places)


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
