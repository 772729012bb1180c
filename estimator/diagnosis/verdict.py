"""`decide`: which explanation stands, and what is left over, by errors on the runs that chose nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.context import DiagnosisContext, Explanation
from estimator.diagnosis.decision_rule import EDGE, SHORTLIST, SUFFICES, SURE
from estimator.diagnosis.error_budget import ErrorTable, extend_errors, generic_extension, measure_errors
from estimator.diagnosis.model_comparison import indistinguishable_set
from estimator.diagnosis.model_search import presence
from estimator.diagnosis.refit import Model, refit
from estimator.diagnosis.score_statistics import Tests
from estimator.errors import FitError

NOMINAL = 0
"""Row of the nominal model in the table of errors."""

UNCHANGED = "the free run of runs that it has not seen errs as much as before"
UNSURE = ("the free run of runs that it has not seen errs less, but not surely so over their pieces, or not every one "
          "of these runs is likelier with it")


@dataclass(frozen=True)
class Decision:
    """What stands, by the errors in `table`."""

    verdict: str
    """none | named | partial | unexplained; several `best` make `named` a `one_of`"""
    best: tuple[Explanation, ...]
    """What stands, the likeliest first; beside `unexplained` the closest, beside `none` what is there but small."""
    table: ErrorTable
    row: int
    """Row of the first of `best` in the table; NOMINAL where there is none"""
    without: tuple[int, ...]
    """Row of the same less each of its effects, where it has several"""
    generic: int
    """Row of what the best one leaves with terms without a name beside it; its own where there are none"""
    terms: Model | None
    draws: NDArray[np.intp]
    why: str = ""
    """Why the closest explanation does not stand."""


def decide(context: DiagnosisContext, tests: Tests, options: Sequence[Explanation], material: float,
           rng: np.random.Generator) -> Decision | None:
    """The verdict by errors on the confirm runs, opened here for the first and only time.

    None where nothing could be fitted, neither a listed effect nor a term without a name. Raises `FitError` where no
    model's free run can be carried through.
    """
    shortlist = shortlisted(options)
    generic = generic_extension(context, context.nominal, tests)
    if not shortlist and generic is None:
        return None
    models = [context.nominal, *(o.model for o in shortlist), *([generic] if generic is not None else [])]
    table = measure_errors(context.split, models, models[1], rng.integers(2**63, size=len(context.split.confirm)))
    draws = table.draws(rng)
    whole = table.error(NOMINAL)
    least = material * whole
    possible = [(o, k) for k, o in enumerate(shortlist, 1) if admissible(o)]
    own = len(models) - 1 if generic is not None else NOMINAL
    if not possible:
        found = generic is not None and matters(table, own, NOMINAL, least, draws)
        closest = tuple(shortlist[:1])
        return Decision("unexplained" if found or whole > EDGE else "none", closest if found else (), table,
                        1 if found and closest else NOMINAL, (), own, generic, draws,
                        "a size that makes it what it is could as well be nil, or has a sign that it cannot have")
    best, row = choose(possible, table, least)
    beside = generic_extension(context, best[0].model, best[0].left)
    pieces = without_each(context, best[0].model)
    table = extend_errors(table, context.split, context.nominal, [*pieces, *([beside] if beside is not None else [])])
    first = len(models)
    without = tuple(range(first, first + len(pieces)))
    more = first + len(pieces) if beside is not None else row
    decision = Decision("named", tuple(best), table, row, without, more, beside or best[0].model, draws)
    if not matters(table, row, NOMINAL, least, draws):
        if generic is not None and matters(table, own, NOMINAL, least, draws):
            return replace(decision, verdict="unexplained", generic=own, terms=generic,
                           why="the error that terms without a name take away stays with it")
        if whole > EDGE:
            return replace(decision, verdict="unexplained", why=shortfall(table, row, least))
        small = table.lowers(row, NOMINAL, 0.0, draws) >= SURE and bool(np.all(table.agreement[row] > 0.0))
        return replace(decision, verdict="none", best=tuple(best) if small else ())
    left = table.error(row) - min(table.error(more), table.error(own) if own else np.inf)
    if (whole - table.error(row)) < SUFFICES * (whole - table.error(row) + max(left, 0.0)):
        return replace(decision, verdict="unexplained", why="terms without a name take away more of the error than it")
    if matters(table, more, row, least, draws):
        return replace(decision, verdict="partial")
    return decision


def shortlisted(options: Sequence[Explanation]) -> list[Explanation]:
    """The likeliest explanations, of each number of effects at least two."""
    ranked = sorted(options, key=lambda o: -o.gain)
    counts = sorted({len(o.model.effects) for o in options})
    first = [o for n in counts for o in [o for o in ranked if len(o.model.effects) == n][:2]]
    return [*first, *(o for o in ranked if not any(o is f for f in first))][: max(SHORTLIST, len(first))]


def admissible(explanation: Explanation) -> bool:
    """Whether each of its effects is there, of a sign that it can have."""
    return all(presence(explanation.model, float(np.sqrt(explanation.left.scatter))))


def choose(possible: Sequence[tuple[Explanation, int]], table: ErrorTable, least: float
           ) -> tuple[list[Explanation], int]:
    """The fewest effects whose error is within what matters of the least, and what cannot be told from them."""
    lowest = min(table.error(k) for _, k in possible)
    near = [(o, k) for o, k in possible if table.error(k) <= lowest + least]
    fewest = min(len(o.model.effects) for o, _ in near)
    best = indistinguishable_set([o for o, _ in near if len(o.model.effects) == fewest])
    return best, next(k for o, k in near if o is best[0])


def matters(table: ErrorTable, model: int, than: int, least: float, draws: NDArray[np.intp]) -> bool:
    """Whether `model` surely has less rms error than `than` by `least`, and is likelier on every run."""
    if model == than:
        return False
    surely = np.mean([table.error(than, d) - table.error(model, d) > least for d in draws]) >= SURE
    return bool(surely and np.all(table.agreement[model] > table.agreement[than]))


def shortfall(table: ErrorTable, model: int, least: float) -> str:
    """Why a `model` of a large error does not matter: the error does not fall by `least`, or not for sure."""
    return UNCHANGED if table.error(NOMINAL) - table.error(model) < least else UNSURE


def without_each(context: DiagnosisContext, model: Model) -> list[Model]:
    """The model less each of its effects in turn; the nominal one stands for none."""
    pairs = list(zip(model.effects, model.sizes()))
    if len(pairs) < 2:
        return []
    out = []
    for k in range(len(pairs)):
        try:
            out.append(refit(context.split, model, [*pairs[:k], *pairs[k + 1 :]]))
        except (FitError, np.linalg.LinAlgError):
            return []
    return out

