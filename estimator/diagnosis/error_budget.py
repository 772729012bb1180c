"""Share of each cause in the free-run error of the held-out runs.

Generic terms, fitted to the residual, show how much of it could be explained at all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext, p_of
from estimator.diagnosis.decision_rule import GENERIC_TERMS
from estimator.diagnosis.error_table import ErrorTable
from estimator.diagnosis.refit import Model, refit
from estimator.diagnosis.result import BudgetRow
from estimator.diagnosis.search import start_size
from estimator.errors import FitError
from estimator.score import ALPHA, ScoreTests

GENERIC_STEPS = 12


def budget(table: ErrorTable, row: int, without: Sequence[int], model: Model | None,
           draws: NDArray[np.intp]) -> tuple[BudgetRow, ...]:
    """Shares of the mean squared error beyond noise alone: of each effect of `model`, whose errors stand in `row`, of
    what is left, and what noise alone would be. What several effects take away together is shared out by what is
    missing `without` each. Empty where there is nothing beyond noise."""

    def shares(blocks: NDArray[np.intp] | None) -> FloatArray:
        excess = table.excess(0, blocks)
        if excess <= 0.0:
            return np.full(3 + len(without or ([row] if row else [])), np.nan)
        closed = (table.error(0, blocks) ** 2 - table.error(row, blocks) ** 2) / excess
        each = np.array([max(table.error(k, blocks) ** 2 - table.error(row, blocks) ** 2, 1e-12) for k in without])
        causes = closed * each / each.sum() if len(each) else np.array([closed] if row else [])
        return np.array([1.0, *causes, 1.0 - closed, 1.0 / excess])

    point = shares(None)
    if np.isnan(point).any():
        return ()
    spread = np.array([shares(d) for d in draws])
    low, high = np.nanquantile(spread, [0.025, 0.975], axis=0)
    named = model.named if model is not None and row else ()
    parts = [("nominal", None), *(("cause", e) for e in named), ("remainder", None), ("noise", None)]
    return tuple(BudgetRow(what, float(value), (float(a), float(b)), None if e is None else e.name,
                           None if e is None or e.joint is None else e.joint + 1)
                 for (what, e), value, a, b in zip(parts, point, low, high))


def generic_extension(context: DiagnosisContext, model: Model, left: ScoreTests) -> Model | None:
    """`model` with the generic terms of the largest gain on its residual, fitted together.

    None where no term is significant, or where they cannot be fitted.
    """
    chosen: list[int] = []
    for _ in range(GENERIC_TERMS):
        known = left.gain(_columns(context, chosen)) if chosen else 0.0
        gains = {i: left.gain(_columns(context, [*chosen, i])) - known
                 for i in range(context.named, context.trials) if i not in chosen}
        best = max(gains, key=lambda i: gains[i])
        if gains[best] < context.material(context.split.discover) or (not chosen and p_of(context, left, best) > ALPHA):
            break
        chosen.append(best)
    if not chosen:
        return None
    start = list(zip(model.effects, model.sizes()))
    start += [(context.candidates[i].effect, start_size(context, left, i)) for i in chosen]
    for count in range(len(start), len(model.effects), -1):  # fewer where all together do not converge
        try:
            return refit(model, start[:count], GENERIC_STEPS)
        except (FitError, np.linalg.LinAlgError):
            continue
    return None


def _columns(context: DiagnosisContext, which: Sequence[int]) -> NDArray[np.intp]:
    return np.concatenate([context.columns[i] for i in which])
