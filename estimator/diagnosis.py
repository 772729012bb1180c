"""`diagnose`: what the simulation gets wrong, what that is, and what extending it gains.

Nominal fit, detection without names, scores of the library with the nominal parameters projected out, full
re-fits of the best singles, then pairs, then one triple, closure on what was seen, and last, once, closure and
gain on the confirm runs. A cause is named only where nothing detectable is left over on runs opened once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.dataset import Dataset
from estimator import account
from estimator.effects import Effect, library
from estimator.effects.anonymous import AnonymousReading, AnonymousTorque, battery
from estimator.effects.timing import SensorTimeSkew
from estimator.errors import FitError
from estimator.evidence import (
    Model,
    fit_nominal,
    misfit,
    refit,
    rehearsal_scores,
    score_confirm,
    score_discover,
    tests_of,
)
from estimator.extended import Candidate
from estimator.mechanism import Mechanism
from estimator.options import FitOptions
from estimator.scores import RunScore, Tests, columns_of
from estimator.session import Session, open_session
from estimator.verdict import Diagnosis, Ranked

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]
ALPHA = 0.01
"""p-value, over all candidates tried, below which something is there."""
SINGLES = 5
"""Best effects that are re-fitted one by one."""
PAIRS = 4
MATERIAL = 0.01
"""Least gain of a material effect: this much of twice the log likelihood a sample. Smaller ones can be
significant in long records (microseconds of skew, a per mille of scale) and change no simulation."""
LEFT_OVER = 0.03
"""What a cause may leave for others on the discover runs: this share of its own gain. Functional forms differ."""
LEFT_OVER_CONFIRM = 0.3
"""The same on the confirm runs, where parameters are not re-fitted."""
LEAST_CLOSED = 0.1
"""Least share of the free-run gap that a named cause closes on the confirm runs. A law of another form than the real
one's (friction that drifts along another curve) may be right and close a quarter; parameters can
imitate most of a rotor."""
RIVAL = 0.5
"""An explanation with less than this share of the best one's gain leaves the rest of it unexplained: not a rival."""
TIE = 0.02
"""Explanations within this share of the best one's gain are not told apart."""
TIE_GAIN = 8.0
"""... or within this much of twice the log likelihood."""


@dataclass(frozen=True)
class Explained:
    """One set of effects, fitted, and what it leaves over on the discover runs."""

    model: Model
    gain: float
    left: Tests
    best_left: int
    """Candidate with the largest remaining gain."""
    best_named_left: int
    closed: bool
    """What it leaves is little beside its gain."""
    clean: bool = False
    """It leaves nothing detectable."""
    bias: tuple[RunScore, ...] = ()
    """What its scores are on average when it is right, one a discover run, its own sizes left out."""


@dataclass
class Desk:
    """What all steps share."""

    session: Session
    candidates: list[Candidate]
    columns: list[NDArray[np.intp]]
    named: int
    """The first so many candidates are of the library."""
    bias: list[RunScore]
    nominal: Model
    rng: np.random.Generator

    @property
    def trials(self) -> int:
        return len(self.candidates)

    def gain(self, tests: Tests, i: int) -> float:
        """Of candidate i; nil for a skew that the recorder's clocks leave open anyway."""
        if (self.candidates[i].effect.name == SensorTimeSkew.name
                and abs(float(tests.size(self.columns[i])[0])) < self.session.clock_bound_s):
            return 0.0
        return tests.gain(self.columns[i])

    def material(self, which: Sequence[int]) -> float:
        """Least gain that counts on these runs."""
        return MATERIAL * sum(len(s.time_s) for s in self.session.signals(which))


def diagnose(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, *, gear_ratio: float = 1.0,
             seed: int = 0, progress: Progress | None = None,
             reference: Mapping[str, tuple[float, float]] | None = None) -> Diagnosis:
    """Diagnose the runs of one rig, in the order of recording.

    `reference` is (value, std) by parameter of an earlier model: changed inertial parameters are reported as a
    payload. Data that cannot be diagnosed give the verdict `fit_failed` with the reason, never an exception.
    """
    start = time.perf_counter()
    say = progress or (lambda stage, fraction: None)
    try:
        session = open_session(datasets, mechanism, options, gear_ratio)
        found = _diagnose(session, np.random.default_rng(seed), say, reference)
    except FitError as error:
        found = Diagnosis("fit_failed", f"No diagnosis: {error}.")
    return replace(found, wall_s=time.perf_counter() - start)


def _diagnose(session: Session, rng: np.random.Generator, say: Progress,
              reference: Mapping[str, tuple[float, float]] | None) -> Diagnosis:
    say("fitting the nominal model", 0.02)
    nominal, _ = fit_nominal(session)
    effects, refused = library(session.mechanism, session.has_imu)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    named = len(candidates)
    candidates += [Candidate(e) for e in battery(session.mechanism, session.has_imu)]
    say("scoring the library", 0.15)
    scores = score_discover(session, nominal, candidates)
    say("rehearsing the nominal model", 0.2)
    try:
        bias = rehearsal_scores(session, nominal, candidates, rng)
    except FitError:  # a fit that is far wrong can have friction below zero, and its simulation run off
        bias = [RunScore(np.zeros_like(s.score), s.information) for s in scores]
    desk = Desk(session, candidates, columns_of(candidates), named, bias, nominal, rng)
    tests = tests_of(session, nominal, scores, bias)
    ranked = rank(desk, tests)
    base = account.base(session, nominal, refused, reference)
    base = replace(base, candidates=ranked, separability=separability(desk, tests))
    least = desk.material(session.discover)
    if not any(p_of(desk, tests, i) < ALPHA and desk.gain(tests, i) > least for i in range(desk.trials)):
        return account.nothing(base, desk.session, nominal)
    say("re-fitting the best explanations", 0.4)
    options = explain(desk, tests, say)
    say("opening the confirm runs", 0.85)
    return conclude(desk, base, options, rng)


def p_of(desk: Desk, tests: Tests, i: int) -> float:
    """p-value of candidate i over all that were tried."""
    return min(1.0, tests.p_value(desk.columns[i]) * desk.trials)


def best_shapes(desk: Desk, tests: Tests, skip: Sequence[str] = ()) -> list[int]:
    """Library candidates, best shape of each effect, by falling gain."""
    best: dict[str, int] = {}
    for i in range(desk.named):
        key = desk.candidates[i].effect.key
        if key not in skip and (key not in best or desk.gain(tests, i) > desk.gain(tests, best[key])):
            best[key] = i
    return sorted(best.values(), key=lambda i: -desk.gain(tests, i))


def rank(desk: Desk, tests: Tests) -> tuple[Ranked, ...]:
    """Every effect of the library as scored."""
    out = []
    least = desk.material(desk.session.discover)
    for i in best_shapes(desk, tests):
        effect, columns = desk.candidates[i].effect, desk.columns[i]
        out.append(Ranked(effect.name, None if effect.joint is None else effect.joint + 1,
                          float(np.sqrt(max(desk.gain(tests, i), 0.0))), p_of(desk, tests, i),
                          float(tests.size(columns)[0]),
                          tests.detectable(int(columns[0]), ALPHA / desk.trials, least), effect.sizes[0].unit))
    return tuple(out)


def separability(desk: Desk, tests: Tests) -> tuple[tuple[str, ...], FloatArray]:
    """Cosines between what the best shapes of the library would add, nominal parameters projected out."""
    order = best_shapes(desk, tests)[:14]
    first = np.array([desk.columns[i][0] for i in order])
    information = tests.information[np.ix_(first, first)]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return tuple(desk.candidates[i].effect.key for i in order), information / np.outer(scale, scale)


def explain(desk: Desk, tests: Tests, say: Progress) -> list[Explained]:
    """Fitted explanations, singles first; more effects only where no single closes."""
    order = best_shapes(desk, tests)
    promising = [i for i in order[:SINGLES] if p_of(desk, tests, i) < 0.5]
    starts = [[(desk.candidates[i].effect, start_size(desk, tests, i))] for i in promising]
    singles = weigh(desk, starts)
    say("looking at what they leave over", 0.6)
    singles = judge(desk, singles[:4])
    if any(s.closed for s in singles) or not singles:
        return singles
    say("trying pairs", 0.7)
    pairs = grow(desk, singles[:2], PAIRS)
    if any(s.closed for s in pairs) or not pairs:
        return pairs + singles
    say("trying three", 0.8)
    return grow(desk, pairs[:1], 2) + pairs + singles


def start_size(desk: Desk, tests: Tests, i: int) -> FloatArray:
    """One-step sizes of candidate i, with its shape."""
    return np.concatenate([tests.size(desk.columns[i]), desk.candidates[i].shape])


def weigh(desk: Desk, starts: Sequence[Sequence[tuple[Effect, FloatArray]]]) -> list[Explained]:
    """Fit every start, compare all under the noise of the best, most likely first."""
    models = []
    for start in starts:
        model = fit_extension(desk, start)
        if model is not None:
            models.append(model)
    if not models:
        return []
    noise = min((m.state.noise for m in models), key=lambda s: account.log_volume(desk.nominal.problem, s))
    try:
        plain = misfit(refit(desk.session, desk.nominal, [], 10, noise))
    except FitError:  # it is too wrong to settle under so little noise; where it stands will do
        plain = misfit(replace(desk.nominal, state=replace(desk.nominal.state, noise=noise)))
    out = []
    for m in models:
        try:
            again = refit(desk.session, m, list(zip(m.effects, m.sizes())), 8, noise)
        except FitError:  # under the noise of the best one it has no fit at all
            continue
        out.append(Explained(m, plain - misfit(again), _NO_TESTS, -1, -1, False))
    return sorted(out, key=lambda e: -e.gain)


def fit_extension(desk: Desk, start: Sequence[tuple[Effect, FloatArray]]) -> Model | None:
    """Full re-fit, first with shapes held; None where it fails."""
    try:
        held = refit(desk.session, desk.nominal, start, 8, hold_shapes=True)
    except (FitError, np.linalg.LinAlgError):
        return None
    if not any(e.shapes and not e.whole_shapes for e in held.effects) and held.state.converged:
        return held
    try:
        return refit(desk.session, held, list(zip(held.effects, held.sizes())), 12)
    except (FitError, np.linalg.LinAlgError):
        return held


_NO_TESTS = Tests(np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 1.0)


def judge(desk: Desk, explained: Sequence[Explained]) -> list[Explained]:
    """Each with what it leaves over, gains over the scatter that the most likely one leaves."""
    if not explained:
        return []
    bias = rehearsed(desk, explained[0].model)
    first = judged(desk, explained[0], bias, None)
    scatter = float(np.median(first.left.inflation))
    rivals = [e for e in explained[1:] if e.gain > RIVAL * explained[0].gain]
    return [first, *(judged(desk, e, bias, scatter) for e in rivals)]


def rehearsed(desk: Desk, model: Model) -> list[RunScore]:
    """Bias of the scores at `model`, without the entries of its own sizes; the nominal model's where it cannot run.

    Motion and noise of an explanation differ from the nominal fit's, and so does the bias.
    """
    p = desk.session.mechanism.p
    own = np.arange(p, model.problem.parameter_count)
    try:
        found = rehearsal_scores(desk.session, model, desk.candidates, desk.rng)
    except FitError:
        return desk.bias
    return [RunScore(np.delete(r.score, own), np.delete(np.delete(r.information, own, 0), own, 1)) for r in found]


def judged(desk: Desk, explained: Explained, rehearsals: Sequence[RunScore], scatter: float | None) -> Explained:
    """With what it leaves over on the discover runs, and its gain over the scatter (by default its own)."""
    model = explained.model
    scores = score_discover(desk.session, model, desk.candidates)
    p = desk.session.mechanism.p
    bias = [padded(b, model.problem.parameter_count - p, p) for b in rehearsals]
    left = tests_of(desk.session, model, scores, bias)
    own = {e.key for e in model.effects}
    gains = [desk.gain(left, i) if c.effect.key not in own else 0.0 for i, c in enumerate(desk.candidates)]
    best = int(np.argmax(gains))
    best_named = int(np.argmax(gains[: desk.named]))
    gain = explained.gain / (float(np.median(left.inflation)) if scatter is None else scatter)
    small = max(LEFT_OVER * gain, desk.material(desk.session.discover))
    least = desk.material(desk.session.discover)
    detectable = [g for i, g in enumerate(gains) if g > least and p_of(desk, left, i) < ALPHA]
    return Explained(model, gain, left, best, best_named, gain > least and max(detectable, default=0.0) < small,
                     not detectable, tuple(rehearsals))


def padded(score: RunScore, added: int, at: int) -> RunScore:
    """A nominal run's bias as one of a model with `added` more parameters after the first `at`."""
    return RunScore(np.insert(score.score, [at] * added, 0.0), score.information)


def borrowed(bias: Sequence[RunScore], run: RunScore, added: int, at: int) -> RunScore:
    """Mean bias of the discover runs, scaled column by column to what this run informs of.

    A run that never reaches a stop says nothing of it, and has no bias about it either.
    """
    score = np.mean([b.score for b in bias], axis=0)
    known = np.mean([np.diag(b.information) for b in bias], axis=0)
    here = np.delete(np.diag(run.information), np.arange(at, at + added))
    share = np.clip(here / np.maximum(known, 1e-100), 0.0, 3.0)
    return padded(RunScore(score * share, bias[0].information), added, at)


def grow(desk: Desk, parents: Sequence[Explained], most: int) -> list[Explained]:
    """Each parent with one more effect: those that its left-over scores best."""
    starts = []
    for parent in parents:
        own = [e.key for e in parent.model.effects]
        for i in best_shapes(desk, parent.left, own)[: max(1, most // len(parents))]:
            if p_of(desk, parent.left, i) < 0.5:
                begin = list(zip(parent.model.effects, parent.model.sizes()))
                starts.append([*begin, (desk.candidates[i].effect, start_size(desk, parent.left, i))])
    unique = {tuple(sorted(e.key for e, _ in s)): s for s in reversed(starts)}
    return judge(desk, weigh(desk, list(unique.values()))[:3])


def conclude(desk: Desk, base: Diagnosis, options: Sequence[Explained], rng: np.random.Generator) -> Diagnosis:
    """Verdict by closure on the confirm runs, gain and what a report draws."""
    session = desk.session
    closed = sorted((o for o in options if o.closed), key=lambda o: (len(o.model.effects), -o.gain))
    if not options:
        return account.unexplained(base, session, desk.nominal, None, "no effect of the library fits")
    if not closed:
        best = max(options, key=lambda o: o.gain)
        what = desk.candidates[best.best_left].effect
        label = what.key if not isinstance(what, AnonymousTorque | AnonymousReading) else "a term without a name"
        return account.unexplained(base, session, desk.nominal, best, f"beside it {label} is still detectable", rng)
    fewest = len(closed[0].model.effects)
    rivals = [o for o in closed if len(o.model.effects) == fewest]
    near = [o for o in rivals if o.gain >= rivals[0].gain * (1 - TIE) - TIE_GAIN]
    ties = [o for o in near if o.clean] or near
    best = ties[0]
    if not confirmed(desk, best):
        return account.unexplained(base, session, desk.nominal, best, "it does not hold on the confirm runs", rng)
    p = max(1e-12, min(1.0, _p_of_gain(best) * desk.trials))
    session, ties = session.sharp(), [sharpened(desk, ties[0]), *ties[1:]]
    found = account.finding(base, session, desk.nominal, ties, p, rng)
    if found.gap_closed is None or found.gap_closed < LEAST_CLOSED:
        closed_share = "an unknown share" if found.gap_closed is None else f"{100 * found.gap_closed:.0f} %"
        return account.unexplained(base, session, desk.nominal, best,
                                   f"it closes {closed_share} of the free-run gap on the confirm runs", rng)
    return found


def sharpened(desk: Desk, explained: Explained) -> Explained:
    """Re-fitted with the rig's own rounding of sign(qd), which its saved model has too; as it was where that fails.

    The wider rounding of the search costs a few per mille on every parameter alike. Where the recorder's clocks
    leave it open, the IMU's time line is free meanwhile. Dry friction near rest has no known form: what the two
    roundings make of a parameter differs, and the difference counts as one standard deviation more.
    """
    model = explained.model
    effects = list(zip(model.effects, model.sizes()))
    skew = SensorTimeSkew()
    beside = int(desk.session.has_imu and desk.session.clock_bound_s > 0.0
                 and skew.key not in {e.key for e in model.effects})
    if beside:
        effects.append((skew, np.zeros(1)))
    try:
        again = replace(refit(desk.session.sharp(), model, effects), beside=beside)
    except (FitError, np.linalg.LinAlgError):
        return explained
    if not again.state.converged:
        return explained
    between = again.state.beta.copy()
    between[: model.width] -= model.state.beta[: model.width]
    between[model.width :] = 0.0
    again.state.covariance += np.outer(between, between)
    return replace(explained, model=again)


def _p_of_gain(explained: Explained) -> float:
    from scipy.stats import f as fisher

    k = sum(len(e.sizes) for e in explained.model.effects)
    return float(fisher.sf(explained.gain / k, k, explained.left.freedom))


def confirmed(desk: Desk, explained: Explained) -> bool:
    """Closure on the confirm runs, opened here for the first and only time, and a gain there."""
    session, model = desk.session, explained.model
    scores = score_confirm(session, model, desk.candidates)
    p = session.mechanism.p
    bias = [borrowed(explained.bias, r, model.problem.parameter_count - p, p) for r in scores]
    left = tests_of(session, model, scores, bias, explained.left)
    own = {e.key for e in model.effects}
    share = len(session.confirm) / len(session.discover)
    small = max(LEFT_OVER_CONFIRM * explained.gain * share, desk.material(session.confirm))
    for i in range(desk.trials):
        if desk.candidates[i].effect.key in own:
            continue
        if p_of(desk, left, i) < ALPHA and desk.gain(left, i) > small:
            return False
    return account.confirm_gain(session, desk.nominal, model) > 0.0
