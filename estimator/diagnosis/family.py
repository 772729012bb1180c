"""`family_of`: the answer that the train runs choose, and every model that its verdict asks for, fitted to them.

Its errors on the test runs are measured afterwards, by `measure_first`; where these leave the verdict open, by
`measure_all` on all runs, each a test run once, with every model fitted anew to the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext, assess, with_generic
from estimator.diagnosis.data_split import RunSplit, folds, turned
from estimator.diagnosis.decision_rule import EDGE, SUFFICES
from estimator.diagnosis.error_table import NOMINAL, ErrorTable, joined, measure, spread_out
from estimator.diagnosis.explanation import (
    Explanation,
    admissible,
    by_error,
    fewest_beyond,
    is_close,
    presence,
    shortlisted,
)
from estimator.diagnosis.model import Model, gain_over, nominal_model, refit
from estimator.diagnosis.noise_check import declared_levels, in_words, noisy_sensors, with_declared_noise
from estimator.diagnosis.result import Rotation
from estimator.diagnosis.search import explained, pairs_of, with_one_more
from estimator.diagnosis.train_errors import Floor, floor_of_best, noise_of, surely_errs_less, train_table
from estimator.diagnosis.verdict import Answer, Family, Hidden, choose, likeliest
from estimator.effects import Effect
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.parallel import parallel_map
from estimator.prediction import FloorNoise
from estimator.score import NO_TESTS


@dataclass(frozen=True)
class FittedFamily:
    """A family with the models of its rows."""

    rows: Family
    models: tuple[Model, ...]
    unit: int
    """The row whose noise floor is the unit of all errors"""
    noise: FloorNoise
    """The noise of that floor: of the largest model"""
    smoothers: tuple[int, ...]
    """Rows that may supply an angle that no sensor reads"""


class _Rows:
    """Models by row, each once."""

    def __init__(self, nominal: Model) -> None:
        self.models = [nominal]

    def of(self, model: Model | None) -> int:
        """Row of a model, which is added where it is new; NOMINAL of none."""
        if model is None:
            return NOMINAL
        for k, one in enumerate(self.models):
            if one is model:
                return k
        self.models.append(model)
        return len(self.models) - 1


def family_of(context: DiagnosisContext, explanations: Sequence[Explanation], generic: Model | None) -> FittedFamily:
    """The family of the explanations `explanations`, by the train runs alone."""
    rows, largest = _Rows(context.nominal), generic
    shortlist = by_error(shortlisted(explanations))
    family = Family(rows.of(generic), closest=shortlist[0] if shortlist else None, dominated=context.noise_dominated)
    if any(map(admissible, shortlist)):
        floor = floor_of_best(context, shortlist)
        best, parts = choose_answer(context, shortlist, floor)
        more = with_one_more(context, best[0])
        answer, largest = _answer(context, rows, best, parts, imitates(context, best[0], more))
        second = second_answer(context, shortlist, best, parts, floor)
        minor = present_too(context, best[0], more)
        firsts = [best[0], *([] if second is None else second[0][:1])]
        counts = {len(e.keys) for e in firsts}
        rivals = tuple((e, rows.of(e.model)) for e in shortlist if admissible(e) and len(e.keys) in counts
                       and e.keys not in [first.keys for first in firsts])
        family = replace(family, answer=answer, rivals=rivals, closest=None,
                         second=None if second is None else _answer(context, rows, *second)[0],
                         minor=None if minor is None else (minor, rows.of(minor.model)))
    tried = (NOMINAL,) if family.answer is None else (NOMINAL, family.answer.row)
    family = replace(family, hidden=tuple(h for row in tried if (h := hidden_motion(rows, row)) is not None))
    return FittedFamily(family, tuple(rows.models), tried[-1], noise_of(largest or context.nominal), tried)


def _answer(context: DiagnosisContext, rows: _Rows, best: Sequence[Explanation], parts: Sequence[Explanation],
            imitating: bool = False) -> tuple[Answer, Model]:
    """The answer by its rows, and the first of it with generic terms, where any is significant."""
    first = best[0].model
    extended = with_generic(context, best[0])
    answer = Answer(tuple(one.as_told() for one in best), rows.of(first),
                    tuple(rows.of(part.model) for part in parts), rows.of(extended), imitating)
    return answer, extended


def with_terms(context: DiagnosisContext, explanation: Explanation, terms: Sequence[Effect]) -> Explanation:
    """Re-fitted with those `terms` that are then present, all `within`, where train runs that are left out surely err
    less by them; as it was otherwise."""
    model, own = explanation.model, explanation.keys
    more = [e for e in terms if e.key not in own]
    if not more:
        return explanation
    try:
        again = refit(model, [*pairs_of(model), *((e, np.zeros(len(e.sizes))) for e in more)])
        if not surely_errs_less(again, model, context.rng):
            return explanation
    except FIT_ERRORS:
        return explanation
    (found,) = assess(context, [replace(explanation, model=again, left=NO_TESTS)])
    there = [e for e, seen in zip(again.effects, presence(found)) if seen and e in more]
    if len(there) < len(more):
        return with_terms(context, explanation, there)
    return replace(found, gain=explanation.gain + gain_over(model, again) / found.left.scatter,
                   within=explanation.within | found.within | {e.key for e in more})


def choose_answer(context: DiagnosisContext, shortlist: Sequence[Explanation], floor: Floor
                  ) -> tuple[list[Explanation], list[Explanation]]:
    """The best explanations, and the first without each of its effects, by the train runs.

    Effects whose removal does not raise the error by a material amount are removed, the least of them first. What
    explains an error within the noise floor stays whole: there a set says that there are several small faults.
    """
    every = list(shortlist)
    table = train_table(context, every, floor)
    possible = [(o, k) for k, o in enumerate(every, 1) if admissible(o)]
    best, row = choose(possible, table, context.share)
    while True:
        best = fewest_beyond(best)
        parts = without_each(context, best[0], every)
        every += [p for p in parts if not any(p is e for e in every)]
        rows = [1 + next(k for k, e in enumerate(every) if e is p) for p in parts]
        table = train_table(context, every, floor)
        least = min(rows, key=table.error, default=NOMINAL)
        if not parts or table.error(NOMINAL) <= EDGE or table.falls(row, least, context.share):
            return best, parts
        if every[least - 1].left is NO_TESTS:
            every[least - 1] = assess(context, [weighed_part(every[least - 1], best[0])])[0]
        smaller = every[least - 1]
        same = [(o, k) for o, k in possible if len(o.model.effects) == len(smaller.model.effects)
                and o.keys != smaller.keys]
        best, row = likeliest([(smaller, least), *same], table, context.share, NOMINAL)


def weighed_part(part: Explanation, whole: Explanation) -> Explanation:
    """`part` of an explanation with its gain on the scale of the `whole`'s."""
    loss = gain_over(part.model, whole.model) / whole.left.scatter
    return replace(part, gain=whole.gain - loss, by_run=whole.by_run)


def without_each(context: DiagnosisContext, whole: Explanation, known: Sequence[Explanation]) -> list[Explanation]:
    """The explanation without each of its effects, as `known` has it or fitted; empty for fewer than two effects, or
    where one cannot be fitted."""
    pairs, out = pairs_of(whole.model), []
    if len(pairs) < 2:
        return []
    for k, (effect, _) in enumerate(pairs):
        same = next((e for e in known if e.keys == whole.keys - {effect.key}), None)
        if same is None:
            try:
                model = refit(whole.model, [*pairs[:k], *pairs[k + 1 :]])
            except FIT_ERRORS:
                return []
            (same,) = explained(context, [model])
        out.append(same)
    return out


def second_answer(context: DiagnosisContext, shortlist: Sequence[Explanation], best: Sequence[Explanation],
                  parts: Sequence[Explanation], floor: Floor
                  ) -> tuple[list[Explanation], list[Explanation]] | None:
    """Likeliest explanations with one effect more than `best`, and the first without each effect; None without any.

    The error of the train runs must fall by a material amount.
    """
    count, held = len(best[0].model.effects) + 1, [o.keys for o in best]
    more = [o for o in shortlist if admissible(o) and len(o.model.effects) == count
            and any(h < o.keys for h in held)]
    if not more:
        return None
    table, row = train_table(context, [*more, best[0]], floor), 1 + len(more)
    among = [(o, k) for k, o in enumerate(more, 1) if table.falls(k, row, context.share)]
    if not among:
        return None
    both = fewest_beyond(likeliest(among, table, context.share, row)[0])
    return both, without_each(context, both[0], [*best, *shortlist, *parts])


def imitates(context: DiagnosisContext, best: Explanation, more: Sequence[Explanation]) -> bool:
    """Whether `best` explains less than SUFFICES of what it and one further term explain together, by likelihood.

    Further: the likeliest of `more`, fitted, or any candidate by its score. The nominal model and `best` have the noise
    levels of their own fits. An admissible one of `more` that leaves nothing detectable is a second cause.
    """
    if any(admissible(e) and not e.has_residual for e in more):
        return False
    gain = gain_over(context.nominal, best.model) / best.left.scatter
    return explains_less(gain, best.further, *(e.gain for e in more))


def explains_less(gain: float, further: FloatArray, *more: float) -> bool:
    """Whether this gain is less than SUFFICES of it and the largest of the `further` ones together."""
    return gain < SUFFICES * (gain + max(float(further.max(initial=0.0)), *more, 0.0))


def present_too(context: DiagnosisContext, best: Explanation, more: Sequence[Explanation]) -> Explanation | None:
    """The likeliest admissible one of `more` sets than `best`; None without one that is told apart from the others.

    It must not imitate another term.
    """
    sets = [e for e in more if admissible(e)]
    if not sets or sets[0].gain <= context.least_gain:
        return None
    if explains_less(sets[0].gain, sets[0].further) or any(is_close(e, sets[0]) for e in sets[1:]):
        return None
    return sets[0]


def hidden_motion(rows: _Rows, row: int) -> Hidden | None:
    """A sensor of the model in `row` whose noise may hide motion, and the row of the model with the noise that it is
    known to have; None without one."""
    model = rows.models[row]
    noisy = noisy_sensors(model)
    if not noisy:
        return None
    levels = declared_levels(model)
    stated = any(levels[channel] is not None for channel in noisy)
    text = in_words(*max(noisy.items(), key=lambda one: one[1]))
    try:
        return Hidden(row, rows.of(with_declared_noise(model)), text, stated)
    except FIT_ERRORS:
        return Hidden(row, None, text, stated)


def measure_first(family: FittedFamily, rng: np.random.Generator) -> ErrorTable:
    """Errors of all models of the family on the test runs.

    Units are the noise floor of the answer, of the nominal model where that cannot be simulated. Raises `FitError`
    where neither can.
    """
    try:
        return measure(family.models, family.unit, family.noise, rng, family.smoothers)
    except FitError:
        if family.unit == NOMINAL:
            raise
        return measure(family.models, NOMINAL, family.noise, rng, family.smoothers)


def measure_all(family: FittedFamily, first: ErrorTable, rng: np.random.Generator, material: float
                ) -> tuple[ErrorTable, tuple[Rotation, ...]] | None:
    """Errors of the `core` models of the family with each run a test run once, and what each rotation found.

    `first` has those of the first test runs. None where there are no other runs, or a model cannot be fitted or
    simulated.
    """
    split, core = family.models[NOMINAL].split, family.rows.core
    others = [fold for fold in folds(len(split.runs)) if fold != split.test and len(fold) < len(split.runs)]
    seeds = rng.integers(2**63, size=len(others))
    models = [family.models[row] for row in core]
    unit, smoothers = core.index(family.unit), [core.index(row) for row in family.smoothers]

    def turn(k: int) -> tuple[ErrorTable, list[list[FloatArray]]]:
        nominal = nominal_model(turned(split, others[k]))
        fitted = [nominal, *(_again(nominal, m) for m in models[1:])]
        return (measure(fitted, unit, family.noise, np.random.default_rng(seeds[k]), smoothers),
                [m.whole_sizes() for m in fitted])

    if not others:
        return None
    try:
        turns = parallel_map(turn, len(others), split.workers)
    except FIT_ERRORS:
        return None
    count, row = len(family.models), NOMINAL if family.rows.answer is None else family.rows.answer.row
    tables = [first, *(spread_out(table, core, count) for table, _ in turns)]
    sizes = [family.models[row].whole_sizes(), *(own[core.index(row)] for _, own in turns)]
    found = tuple(_rotation(split, fold, family.models[row], own, table.falls(row, NOMINAL, material))
                  for fold, table, own in zip([split.test, *others], tables, sizes))
    return joined(tables, rng), found


def _again(nominal: Model, model: Model) -> Model:
    """`model` fitted to the train runs of `nominal`, under the noise that it was given where it was given one."""
    begin = replace(nominal, split=replace(nominal.split, options=model.split.options))
    return refit(begin, pairs_of(model))


def _rotation(split: RunSplit, fold: tuple[int, ...], model: Model, sizes: Sequence[FloatArray], falls: bool
              ) -> Rotation:
    named = {f"{effect.key}.{size.name}": float(value)
             for effect, values in zip(model.effects, sizes) for size, value in zip(effect.sizes, values)}
    return Rotation(tuple(split.names[k] for k in fold), named, falls)
