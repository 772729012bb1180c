"""`decide`: the accepted explanation and its residual, by errors on the held-out runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.assessment import assess
from estimator.diagnosis.context import DiagnosisContext, Explanation, keys_of, seated
from estimator.diagnosis.decision_rule import EDGE, MOST_EFFECTS, SUFFICES, SURE, WIDTH
from estimator.diagnosis.error_budget import generic_extension
from estimator.diagnosis.error_table import (
    ErrorTable,
    choose_rows,
    extend_errors,
    known_errors,
    measure_errors,
    with_floor,
)
from estimator.diagnosis.model_comparison import indistinguishable_set
from estimator.diagnosis.noise_floor import noise_floor
from estimator.diagnosis.presence import admissible
from estimator.diagnosis.refit import Model, deviance, refit
from estimator.diagnosis.rotation import Turn, rotate
from estimator.effects import GenericReading, GenericTorque
from estimator.errors import FitError
from estimator.verdicts import Verdict

NOMINAL = 0
"""Row of the nominal model in the table of errors."""

GENERIC_ALONE = "generic terms reduce the error, but it does not"
IMITATES = "one further effect or generic term explains more of the readings than it does"
UNCHANGED = "it does not reduce the free-run error of the held-out runs"
UNSURE = ("it reduces the free-run error of the held-out runs, but not significantly, or not on every run, or without "
          "a larger likelihood")


@dataclass(frozen=True)
class Decision:
    """The accepted explanation, by the errors in `table`."""

    verdict: Verdict
    """Not `one_of`, which `named` becomes with several `best`."""
    best: tuple[Explanation, ...]
    """Accepted explanations, the likeliest first; for `unexplained` the closest, for `none` a present but small one."""
    table: ErrorTable
    row: int
    """Row of the first of `best` in the table; NOMINAL where there is none"""
    without: tuple[int, ...]
    """Row of the same without each of its effects, where it has several"""
    with_generic: int
    """Row of the same with generic terms; its own where none is significant"""
    own: int
    """Row of the nominal model with generic terms; NOMINAL where there are none"""
    terms: Model | None
    """The model with generic terms whose first one tells where the residual is"""
    draws: NDArray[np.intp]
    why: str = ""
    """Why the closest explanation is not accepted."""
    turns: tuple[Turn, ...] = ()
    """Rotations over the other runs, where the held-out ones were inconclusive."""
    possible: tuple[tuple[Explanation, int], ...] = ()
    """Admissible explanations and their rows in the table of the held-out runs"""
    unturned: Decision | None = None
    """The same on the held-out runs alone, where the split rotated."""
    judged: Decision | None = None
    """The same with its best explanation before the verdict was passed; None where a name was refused."""

    @property
    def compared(self) -> tuple[tuple[tuple[str, ...], float], ...]:
        """Keys of the effects and error of every model of listed effects alone, the least error first."""
        errors: dict[tuple[str, ...], float] = {}
        for row, model in enumerate(self.table.models):
            keys = tuple(sorted(e.key for e in model.named))
            if keys and not any(isinstance(e, GenericTorque | GenericReading) for e in model.named):
                errors[keys] = min(self.table.error(row), errors.get(keys, np.inf))
        return tuple(sorted(errors.items(), key=lambda one: one[1]))


def decide(context: DiagnosisContext, generic: Model | None, options: Sequence[Explanation], material: float,
           rng: np.random.Generator, known: Sequence[ErrorTable] = ()) -> Decision | None:
    """The verdict by errors on the confirm runs, which no fit has used; some of the errors are `known` already.

    None where neither a listed effect nor a generic term could be fitted. Raises `FitError` where every free run
    diverges.
    """
    shortlist = by_error(shortlisted(options))
    if not shortlist and generic is None:
        return None
    models = [context.nominal, *(o.model for o in shortlist), *([generic] if generic is not None else [])]
    possible = [(o, k) for k, o in enumerate(shortlist, 1) if admissible(o)]
    table = measure_together(context, models, [NOMINAL, *(k for _, k in possible)], rng, known)
    draws = table.draws(rng)
    own = len(models) - 1 if generic is not None else NOMINAL
    if not possible:
        table = over_floor(table, generic or context.nominal, rng)
        structure = is_material(table, own, NOMINAL, material, draws)
        why = "a defining size is not significant, or has an impossible sign"
        asked = Decision("none", (), table, NOMINAL, (), NOMINAL, own, generic if structure else None, draws)
        if table.error(NOMINAL) <= EDGE:
            return replace(asked, judged=asked)
        return replace(asked, verdict="unexplained", best=tuple(shortlist[:1]) if structure else (),
                       row=int(structure), terms=generic, why=why)
    begin = Decision("named", (), table, NOMINAL, (), NOMINAL, own, generic, draws, possible=tuple(possible))
    asked = pruned(context, ask(context, begin, choose(possible, table, material, draws), possible, rng), possible,
                   material, rng)
    found = passed(asked, generic, material)
    # a large residual must show on all runs, not on the held-out ones only
    if found.verdict == "partial" or (found.verdict != "named"
                                      and is_open(asked.table, asked.row, NOMINAL, material, draws)):
        turned = turn_runs(context, asked, rng)
        found = found if turned is None else passed(turned[0], generic, material)
    if found.verdict != "named":
        return found
    second = second_cause(possible, asked, material)
    if second is None:
        return found
    more = turn_runs(context, ask(context, asked, second, possible, rng), rng, [asked.row])
    if more is None:
        return found
    both, place = more
    if not is_material(both.table, both.row, place[asked.row], material, both.draws):
        return found
    both = passed(both, generic, material)
    return both if both.verdict in ("named", "partial") else found


def ask(context: DiagnosisContext, begin: Decision, what: tuple[Sequence[Explanation], int],
        possible: Sequence[tuple[Explanation, int]], rng: np.random.Generator) -> Decision:
    """`begin` with explanations that cannot be told apart, and errors of the first without each effect and with generic
    terms.

    `what` has the explanations and the row of the first. Units are the noise floor of the largest model.
    """
    (best, row), table = what, begin.table
    extended = generic_extension(context, best[0].model, best[0].left)
    pieces = without_each(context, best[0].model)
    first = len(table.models)
    table = extend_errors(table, [*pieces, *([extended] if extended is not None else [])])
    table = over_floor(table, extended or best[0].model, rng)
    return replace(begin, best=tuple(best), table=table, row=row, without=tuple(range(first, first + len(pieces))),
                   with_generic=first + len(pieces) if extended is not None else row, terms=extended or best[0].model)


def pruned(context: DiagnosisContext, asked: Decision, possible: Sequence[tuple[Explanation, int]], material: float,
           rng: np.random.Generator) -> Decision:
    """`asked` without effects whose removal does not raise the error by a material amount, the least of them first.

    What explains an error within the noise floor stays whole: there a set says that there are several small faults.
    """
    while asked.without and asked.table.error(NOMINAL) > EDGE:
        table, best = asked.table, asked.best[0]
        row = min(asked.without, key=table.error)
        if table.error(row) - table.error(asked.row) > material * table.error(row):
            break
        model = table.models[row]
        loss = (deviance(model) - deviance(best.model)) / best.left.scatter
        smaller = assess(context, [Explanation(model, best.gain - loss, by_run=best.by_run)])[0]
        same = [(o, k) for o, k in possible if len(o.model.effects) == len(model.effects)
                and keys_of(o) != keys_of(smaller)]
        what = likeliest([(smaller, row), *same], table, material, NOMINAL, asked.draws)
        asked = ask(context, asked, what, possible, rng)
    return asked


def over_floor(table: ErrorTable, model: Model, rng: np.random.Generator) -> ErrorTable:
    """`table` in units of the noise floor of `model`, with its coloured disturbances; unchanged where that diverges."""
    try:
        return with_floor(table, noise_floor(model), rng.integers(2**63, size=int(table.runs.max()) + 1))
    except (FitError, np.linalg.LinAlgError):
        return table


def second_cause(possible: Sequence[tuple[Explanation, int]], asked: Decision, material: float
                 ) -> tuple[list[Explanation], int] | None:
    """Likeliest explanations with one more effect than `asked`, and the row of the first; None without any.

    The effect must be possibly material: the error falls by as much, but not significantly on the held-out runs.
    """
    table, row = asked.table, asked.row
    count, held = len(asked.best[0].model.effects) + 1, [keys_of(o) for o in asked.best]
    more = [(o, k) for o, k in possible if len(o.model.effects) == count and any(h < keys_of(o) for h in held)
            and table.error(row) - table.error(k) > material * table.error(row)
            and is_open(table, k, row, material, asked.draws)]
    return likeliest(more, table, material, row, asked.draws) if more else None


def turn_runs(context: DiagnosisContext, asked: Decision, rng: np.random.Generator, also: Sequence[int] = ()
              ) -> tuple[Decision, dict[int, int]] | None:
    """`asked` with errors on all runs, each held out once, and old row -> new row of its table and of `also`.

    None where a model cannot be fitted or simulated.
    """
    table = asked.table
    held = [k for k, m in enumerate(table.models) if m is table.unit.reference or m is table.unit.smoother]
    rows = list(dict.fromkeys([NOMINAL, asked.row, *asked.without, asked.with_generic, asked.own, *also, *held]))
    turned = rotate(context.split, choose_rows(table, rows), rng)
    if turned is None:
        return None
    place = {k: rows.index(k) for k in rows}
    return replace(asked, table=turned[0], row=place[asked.row], without=tuple(place[k] for k in asked.without),
                   with_generic=place[asked.with_generic], own=place[asked.own], draws=turned[0].draws(rng),
                   turns=turned[1], unturned=asked), place


def passed(asked: Decision, generic: Model | None, material: float) -> Decision:
    """The verdict of `judge`, with what was judged."""
    return replace(judge(asked, generic, material), judged=asked)


def judge(asked: Decision, generic: Model | None, material: float) -> Decision:
    """The verdict on the best explanation of `asked`, by its table alone.

    `generic` is the nominal model with generic terms.
    """
    table, row, more, own, draws = asked.table, asked.row, asked.with_generic, asked.own, asked.draws
    whole = table.error(NOMINAL)
    structure = is_material(table, own, NOMINAL, material, draws)
    nothing = replace(asked, verdict="none", terms=generic if structure else None)
    if not is_material(table, row, NOMINAL, material, draws):
        if whole > EDGE:
            return (replace(asked, verdict="unexplained", terms=generic, why=GENERIC_ALONE) if structure else
                    replace(asked, verdict="unexplained", why=shortfall(table, row, material)))
        small = table.lowers(row, NOMINAL, 0.0, draws, NOMINAL) >= SURE and bool(np.all(table.agreement[row] > 0.0))
        return nothing if small else without_cause(nothing)
    left = table.error(row) - min(table.error(more), table.error(own) if own else np.inf)
    why = ""
    if (whole - table.error(row)) < SUFFICES * (whole - table.error(row) + max(left, 0.0)):
        why = "generic terms reduce the error more than it does"
    elif table.error(row) > 1.0 + material and table.excess(row) > SUFFICES * table.excess(NOMINAL):
        why = "it explains less than half of the error"
    if why:
        return unnamed(asked, generic, material, why)
    if whole <= EDGE and not all(is_material(table, row, k, material, draws) for k in asked.without):
        return nothing  # several faults, not each of which is material alone
    beyond = table.error(row) > max(EDGE, 1.0 + material * whole)
    if beyond or is_material(table, more, row, material, draws, NOMINAL):  # of the whole
        return replace(asked, verdict="partial")
    return asked


def unnamed(asked: Decision, generic: Model | None, material: float, why: str) -> Decision:
    """`asked`, its name refused for the reason `why`: `unexplained`, or `none` where the error is within the noise."""
    if asked.table.error(NOMINAL) > EDGE:
        return replace(asked, verdict="unexplained", why=why, judged=None)
    structure = is_material(asked.table, asked.own, NOMINAL, material, asked.draws)
    return without_cause(replace(asked, verdict="none", terms=generic if structure else None, judged=None))


def without_cause(asked: Decision) -> Decision:
    """`asked` without an explanation."""
    return replace(asked, best=(), row=NOMINAL, without=())


def is_open(table: ErrorTable, model: int, than: int, material: float, draws: NDArray[np.intp]) -> bool:
    """Whether it is inconclusive that `model` reduces the error of `than` by a material amount.

    The runs must be likelier with `model`.
    """
    could = table.lowers(model, than, material, draws, than) > 1.0 - SURE
    return bool(could and table.agreement[model].sum() > table.agreement[than].sum())


def measure_together(context: DiagnosisContext, models: Sequence[Model], smoothers: Sequence[int],
                     rng: np.random.Generator, known: Sequence[ErrorTable] = ()) -> ErrorTable:
    """Errors of `models`, the nominal one first, in units of the noise of the first that can be simulated.

    The smoother of one of `smoothers` supplies the pivot angle. Errors in `known` tables are reused. Raises `FitError`
    if no model can be simulated.
    """
    table = known_errors(known, models)
    if table is not None:
        return table
    seeds = rng.integers(2**63, size=len(context.split.confirm))
    for reference in models[1:]:
        try:
            return measure_errors(models, reference, seeds, smoothers)
        except FitError:
            continue
    return measure_errors(models, models[NOMINAL], seeds, smoothers)


def shortlisted(options: Sequence[Explanation]) -> list[Explanation]:
    """The likeliest explanations, of each number of effects at least `WIDTH`, and each set of effects once."""
    every = sorted(options, key=lambda o: -o.gain)
    ranked = [o for k, o in enumerate(every) if not any(keys_of(o) == keys_of(e) for e in every[:k])]
    first = first_of_each(ranked)
    return [*first, *(o for o in ranked if not any(o is f for f in first))][: MOST_EFFECTS * WIDTH]


def first_of_each(options: Sequence[Explanation]) -> list[Explanation]:
    """The first of each number of effects, the fewest effects first."""
    counts = sorted({len(o.model.effects) for o in options})
    return [o for n in counts for o in seated([o for o in options if len(o.model.effects) == n], WIDTH)]


def by_error(options: Sequence[Explanation]) -> list[Explanation]:
    """Explanations by rising error of free runs on the discover runs; inadmissible ones last.

    The first gives the noise that is the unit: the likeliest can be a small fault of a sensor, which takes for noise
    what the simulation lacks.
    """
    return sorted(options, key=lambda o: (not admissible(o), o.error))


def choose(possible: Sequence[tuple[Explanation, int]], table: ErrorTable, material: float, draws: NDArray[np.intp]
           ) -> tuple[list[Explanation], int]:
    """The smallest set of effects that no larger set improves by a material amount, with its equivalents, and its row.

    A larger set is compared with the best smaller one. If no improvement is significant, the errors decide.
    """
    def surely(model: int, than: int) -> bool:
        return is_material(table, model, than, material, draws)

    def likely(model: int, than: int) -> bool:
        return table.error(than) - table.error(model) > material * table.error(than)

    for better in (surely, likely):
        best: list[Explanation] = []
        row = NOMINAL
        for count in sorted({len(o.model.effects) for o, _ in possible}):
            found, k = likeliest([(o, k) for o, k in possible if len(o.model.effects) == count], table, material, row,
                                 draws)
            if better(k, row):
                best, row = found, k
        if best:
            return best, row
    fewest = min(len(o.model.effects) for o, _ in possible)
    return likeliest([(o, k) for o, k in possible if len(o.model.effects) == fewest], table, material, NOMINAL, draws)


def likeliest(among: Sequence[tuple[Explanation, int]], table: ErrorTable, material: float, than: int,
              draws: NDArray[np.intp]) -> tuple[list[Explanation], int]:
    """The likeliest of those that do not surely err materially more than the best, with its equivalents, and its row.

    Material is a share of the error of the model `than`.
    """
    lowest = min((k for _, k in among), key=table.error)
    best = indistinguishable_set([o for o, k in among if table.lowers(lowest, k, material, draws, than) < SURE])
    return best, next(k for o, k in among if o is best[0])


def is_material(table: ErrorTable, model: int, than: int, material: float, draws: NDArray[np.intp],
            of: int | None = None) -> bool:
    """Whether error(than) - error(model) > material * error(of), significantly; `of` is by default `than`.

    In addition no run's error may rise by as much, and the runs together must be likelier with `model`.
    """
    of = than if of is None else of
    falls = table.error(than) - table.error(model) > material * table.error(of)
    if model == than or not falls or table.raises(model, than, material, of):
        return False
    return bool(table.lowers(model, than, material, draws, of) >= SURE
                and table.agreement[model].sum() > table.agreement[than].sum())


def shortfall(table: ErrorTable, model: int, material: float) -> str:
    """Why `model` is not material: the error does not fall by `material`, or not significantly."""
    falls = table.error(NOMINAL) - table.error(model) > material * table.error(NOMINAL)
    return UNSURE if falls else UNCHANGED


def without_each(context: DiagnosisContext, model: Model) -> list[Model]:
    """The model without each of its effects; empty for fewer than two effects."""
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

