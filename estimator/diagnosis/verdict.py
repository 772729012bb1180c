"""`decide`: which explanation stands, and what is left over, by errors on the runs that chose nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.context import DiagnosisContext, Explanation
from estimator.diagnosis.decision_rule import EDGE, SHORTLIST, SHORTLIST_EACH, SUFFICES, SURE
from estimator.diagnosis.error_budget import generic_extension
from estimator.diagnosis.error_table import ErrorTable, choose_rows, extend_errors, measure_errors, with_floor
from estimator.diagnosis.model_comparison import indistinguishable_set
from estimator.diagnosis.model_search import keys_of, presence
from estimator.diagnosis.noise_floor import noise_floor
from estimator.diagnosis.refit import Model, deviance, refit
from estimator.diagnosis.rotation import Turn, rotate
from estimator.diagnosis.score_statistics import Tests
from estimator.errors import FitError
from estimator.verdicts import Verdict

NOMINAL = 0
"""Row of the nominal model in the table of errors."""

UNCHANGED = "the free run of runs that it has not seen errs as much as before"
UNSURE = ("the free run of runs that it has not seen errs less, but not surely so over their pieces, or more on one of "
          "them, or these runs are no likelier with it")


@dataclass(frozen=True)
class Decision:
    """What stands, by the errors in `table`."""

    verdict: Verdict
    """Not `one_of`, which `named` becomes with several `best`."""
    best: tuple[Explanation, ...]
    """What stands, the likeliest first; beside `unexplained` the closest, beside `none` what is there but small."""
    table: ErrorTable
    row: int
    """Row of the first of `best` in the table; NOMINAL where there is none"""
    without: tuple[int, ...]
    """Row of the same less each of its effects, where it has several"""
    beside: int
    """Row of the same with terms without a name beside it; its own where it leaves none"""
    own: int
    """Row of such terms beside the nominal model; NOMINAL where there are none"""
    terms: Model | None
    draws: NDArray[np.intp]
    why: str = ""
    """Why the closest explanation does not stand."""
    turns: tuple[Turn, ...] = ()
    """Of the other runs, where those kept back left it open."""
    more: Explanation | None = None
    """The likeliest that holds what stands and one effect more, which is there but does not matter."""


def decide(context: DiagnosisContext, tests: Tests, options: Sequence[Explanation], material: float,
           rng: np.random.Generator, known: Sequence[ErrorTable] = ()) -> Decision | None:
    """The verdict by errors on the confirm runs, which no fit has seen; some of them are `known` already.

    None where nothing could be fitted, neither a listed effect nor a term without a name. Raises `FitError` where no
    model's free run can be carried through.
    """
    shortlist = by_likelihood(shortlisted([o for o in options if admissible(o)] or options))
    generic = generic_extension(context, context.nominal, tests)
    if not shortlist and generic is None:
        return None
    models = [context.nominal, *(o.model for o in shortlist), *([generic] if generic is not None else [])]
    possible = [(o, k) for k, o in enumerate(shortlist, 1) if admissible(o)]
    table = measured_beside(context, models, [NOMINAL, *(k for _, k in possible)], rng, known)
    draws = table.draws(rng)
    own = len(models) - 1 if generic is not None else NOMINAL
    if not possible:
        table = over_floor(table, generic or context.nominal, rng)
        whole = table.error(NOMINAL)
        nameless = whole > 1.0 + material and own != NOMINAL and matters(table, own, NOMINAL, material, draws)
        closest = tuple(shortlist[:1]) if nameless else ()
        return Decision("unexplained" if nameless or whole > EDGE else "none", closest, table,
                        1 if closest else NOMINAL, (), NOMINAL, own, generic, draws,
                        "a size that makes it what it is could as well be nil, or has a sign that it cannot have")
    begin = Decision("named", (), table, NOMINAL, (), NOMINAL, own, generic, draws)
    asked = ask(context, begin, choose(possible, table, material, draws), possible, rng)
    found = judge(asked, generic, material)
    # what leaves much has to show on all runs, not on those alone that were kept back
    if found.verdict == "partial" or (found.verdict != "named" and is_open(table, asked.row, NOMINAL, material, draws)):
        turned = turn_runs(context, asked, rng)
        found = found if turned is None else judge(turned[0], generic, material)
    if found.verdict != "named":
        return found
    second = second_cause(possible, asked, material)
    if second is None:
        return found
    more = turn_runs(context, ask(context, asked, second, possible, rng), rng, [asked.row])
    if more is None:
        return found
    both, place = more
    if not matters(both.table, both.row, place[asked.row], material, both.draws):
        return found
    both = judge(both, generic, material)
    return both if both.verdict in ("named", "partial") else found


def ask(context: DiagnosisContext, begin: Decision, what: tuple[Sequence[Explanation], int],
        possible: Sequence[tuple[Explanation, int]], rng: np.random.Generator) -> Decision:
    """What is to be judged of explanations that cannot be told apart, and the row of the first: its errors without each
    of its effects, and with terms without a name beside it, in units of what the noise beside all these leaves."""
    (best, row), table = what, begin.table
    beside = generic_extension(context, best[0].model, best[0].left)
    pieces = without_each(context, best[0].model)
    first = len(table.models)
    table = extend_errors(table, [*pieces, *([beside] if beside is not None else [])])
    table = over_floor(table, beside or best[0].model, rng)
    return replace(begin, best=tuple(best), table=table, row=row, without=tuple(range(first, first + len(pieces))),
                   beside=first + len(pieces) if beside is not None else row, terms=beside or best[0].model,
                   more=with_minor(possible, best[0], row, table, begin.draws))


def over_floor(table: ErrorTable, model: Model, rng: np.random.Generator) -> ErrorTable:
    """`table` in units of what the noise of `model` leaves, a coloured disturbance of each joint included; as it was
    where that simulation cannot be carried through."""
    try:
        return with_floor(table, noise_floor(model), rng.integers(2**63, size=int(table.runs.max()) + 1))
    except (FitError, np.linalg.LinAlgError):
        return table


def second_cause(possible: Sequence[tuple[Explanation, int]], asked: Decision, material: float
                 ) -> tuple[list[Explanation], int] | None:
    """The likeliest, and its row, with one effect more than what is `asked` about, where it is open whether that
    matters beside it: the error falls by as much, but not surely so on the runs kept back."""
    table, row = asked.table, asked.row
    count, held = len(asked.best[0].model.effects) + 1, [keys_of(o) for o in asked.best]
    more = [(o, k) for o, k in possible if len(o.model.effects) == count and any(h < keys_of(o) for h in held)
            and table.error(row) - table.error(k) > material * table.error(row)
            and is_open(table, k, row, material, asked.draws)]
    return likeliest(more, table, material * table.error(row)) if more else None


def turn_runs(context: DiagnosisContext, asked: Decision, rng: np.random.Generator, also: Sequence[int] = ()
              ) -> tuple[Decision, dict[int, int]] | None:
    """What is `asked`, with errors on all runs, each kept back in its turn, and where the rows of its table, and those
    in `also`, stand then; None where that cannot be had."""
    table = asked.table
    held = [k for k, m in enumerate(table.models) if m is table.unit.reference or m is table.unit.reader]
    rows = list(dict.fromkeys([NOMINAL, asked.row, *asked.without, asked.beside, asked.own, *also, *held]))
    turned = rotate(context.split, choose_rows(table, rows), rng)
    if turned is None:
        return None
    place = {k: rows.index(k) for k in rows}
    return replace(asked, table=turned[0], row=place[asked.row], without=tuple(place[k] for k in asked.without),
                   beside=place[asked.beside], own=place[asked.own], draws=turned[0].draws(rng),
                   turns=turned[1]), place


def judge(asked: Decision, generic: Model | None, material: float) -> Decision:
    """The verdict on the best explanation that is `asked` about, by its table alone; `generic` are the terms without a
    name beside the nominal model."""
    table, row, more, own, draws = asked.table, asked.row, asked.beside, asked.own, asked.draws
    whole = table.error(NOMINAL)
    if not matters(table, row, NOMINAL, material, draws):
        if whole > 1.0 + material and generic is not None and matters(table, own, NOMINAL, material, draws):
            return replace(asked, verdict="unexplained", terms=generic,
                           why="the error that terms without a name take away stays with it")
        if whole > EDGE:
            return replace(asked, verdict="unexplained", why=shortfall(table, row, material))
        small = table.lowers(row, NOMINAL, 0.0, draws, NOMINAL) >= SURE and bool(np.all(table.agreement[row] > 0.0))
        return replace(asked, verdict="none", best=asked.best if small else ())
    left = table.error(row) - min(table.error(more), table.error(own) if own else np.inf)
    if (whole - table.error(row)) < SUFFICES * (whole - table.error(row) + max(left, 0.0)):
        return replace(asked, verdict="unexplained", why="terms without a name take away more of the error than it")
    if table.error(row) > 1.0 + material and table.excess(row) > SUFFICES * table.excess(NOMINAL):
        return replace(asked, verdict="unexplained", why="it leaves more of the error than it takes away")
    beyond = table.error(row) > max(EDGE, 1.0 + material * whole)
    if beyond or matters(table, more, row, material, draws, NOMINAL):  # the rest of all
        return replace(asked, verdict="partial")
    return asked


def is_open(table: ErrorTable, model: int, than: int, material: float, draws: NDArray[np.intp]) -> bool:
    """Whether the error neither surely falls by what matters from `than` to `model` nor surely does not, while the runs
    are likelier with it: one free run that strays makes most of either error."""
    could = table.lowers(model, than, material, draws, than) > 1.0 - SURE
    return bool(could and table.agreement[model].sum() > table.agreement[than].sum())


def measured_beside(context: DiagnosisContext, models: Sequence[Model], readers: Sequence[int],
                    rng: np.random.Generator, known: Sequence[ErrorTable] = ()) -> ErrorTable:
    """Errors in units of the noise of the likeliest explanation whose simulations can be carried through, of the
    nominal model, which comes first, where there is none; one of `readers` reads the pivot's angle. What is `known` of
    them is taken over. Raises `FitError` where not even that can."""
    for table in known:
        if table.unit.reference is models[1]:
            more = [m for m in models if not any(m is k for k in table.models)]
            place = {id(m): k for k, m in enumerate((*table.models, *more))}
            return choose_rows(extend_errors(table, more), [place[id(m)] for m in models])
    seeds = rng.integers(2**63, size=len(context.split.confirm))
    for reference in models[1:]:
        try:
            return measure_errors(models, reference, seeds, readers)
        except FitError:
            continue
    return measure_errors(models, models[NOMINAL], seeds, readers)


def shortlisted(options: Sequence[Explanation]) -> list[Explanation]:
    """The likeliest explanations, of each number of effects at least `SHORTLIST_EACH`, and each set of effects once."""
    every = sorted(options, key=lambda o: -o.gain)
    ranked = [o for k, o in enumerate(every) if not any(keys_of(o) == keys_of(e) for e in every[:k])]
    first = first_of_each(ranked)
    return [*first, *(o for o in ranked if not any(o is f for f in first))][: max(SHORTLIST, len(first))]


def first_of_each(options: Sequence[Explanation]) -> list[Explanation]:
    """The first of each number of effects, the fewest effects first."""
    counts = sorted({len(o.model.effects) for o in options})
    return [o for n in counts for o in [o for o in options if len(o.model.effects) == n][:SHORTLIST_EACH]]


def by_likelihood(options: Sequence[Explanation]) -> list[Explanation]:
    """The likeliest under its own noise first, those that cannot be last: in units of what a model puts down to noise
    its error is small."""
    return sorted(options, key=lambda o: (not admissible(o), deviance(o.model)))


def admissible(explanation: Explanation) -> bool:
    """Whether each of its effects is there, of a sign that it can have."""
    return all(presence(explanation.model, float(np.sqrt(explanation.left.scatter))))


def choose(possible: Sequence[tuple[Explanation, int]], table: ErrorTable, material: float, draws: NDArray[np.intp]
           ) -> tuple[list[Explanation], int]:
    """The fewest effects that no more of them better by what matters, and what cannot be told from them.

    More effects are held against the best of fewer: a cause that would be named on a leg with nothing else wrong is
    named beside another, however large that is. Where nothing surely matters, by the errors as they are.
    """
    def surely(model: int, than: int) -> bool:
        return matters(table, model, than, material, draws)

    def likely(model: int, than: int) -> bool:
        return table.error(than) - table.error(model) > material * table.error(than)

    for better in (surely, likely):
        best: list[Explanation] = []
        row = NOMINAL
        for count in sorted({len(o.model.effects) for o, _ in possible}):
            found, k = likeliest([(o, k) for o, k in possible if len(o.model.effects) == count], table,
                                 material * table.error(row))
            if better(k, row):
                best, row = found, k
        if best:
            return best, row
    fewest = min(len(o.model.effects) for o, _ in possible)
    return likeliest([(o, k) for o, k in possible if len(o.model.effects) == fewest], table,
                     material * table.error(NOMINAL))


def likeliest(of: Sequence[tuple[Explanation, int]], table: ErrorTable, least: float) -> tuple[list[Explanation], int]:
    """Of those whose error is within `least` of the lowest the likeliest, with what cannot be told from it, and its
    row."""
    lowest = min(table.error(k) for _, k in of)
    best = indistinguishable_set([o for o, k in of if table.error(k) <= lowest + least])
    return best, next(k for o, k in of if o is best[0])


def with_minor(possible: Sequence[tuple[Explanation, int]], best: Explanation, row: int, table: ErrorTable,
               draws: NDArray[np.intp]) -> Explanation | None:
    """The likeliest with one effect beside those of `best`, under which every run is likelier and the error surely
    falls; that it does not fall by what matters is settled."""
    count = len(best.model.effects) + 1
    beside = [o for o, k in possible if keys_of(best) < keys_of(o) and len(o.model.effects) == count and np.all(
        table.agreement[k] > table.agreement[row]) and table.lowers(k, row, 0.0, draws, NOMINAL) >= SURE]
    return max(beside, key=lambda o: o.gain, default=None)


def matters(table: ErrorTable, model: int, than: int, material: float, draws: NDArray[np.intp],
            of: int | None = None) -> bool:
    """Whether `model` has less rms error than `than` by the share `material` of its error, or of that of another model
    `of`, surely so, errs more by as much on none of the runs, and makes them likelier together.

    A law of another form than nature's can make a run that hardly shows the effect less likely: the error says whether
    that is of consequence.
    """
    of = than if of is None else of
    falls = table.error(than) - table.error(model) > material * table.error(of)
    if model == than or not falls or table.raises(model, than, material, of):
        return False
    return bool(table.lowers(model, than, material, draws, of) >= SURE
                and table.agreement[model].sum() > table.agreement[than].sum())


def shortfall(table: ErrorTable, model: int, material: float) -> str:
    """Why a `model` of a large error does not matter: the error does not fall by `material`, or not for sure."""
    falls = table.error(NOMINAL) - table.error(model) > material * table.error(NOMINAL)
    return UNSURE if falls else UNCHANGED


def without_each(context: DiagnosisContext, model: Model) -> list[Model]:
    """The model less each of its effects in turn; the nominal one stands for none."""
    pairs = list(zip(model.effects, model.sizes()))
    if len(pairs) < 2:
        return []
    out = []
    for k in range(len(pairs)):
        try:
            out.append(refit(model, [*pairs[:k], *pairs[k + 1 :]]))
        except (FitError, np.linalg.LinAlgError):
            return []
    return out

