"""`budget`: shares of the mean squared free-run error, by cause."""

from __future__ import annotations

import numpy as np

from daq import FloatArray, IndexArray
from estimator.diagnosis.error_table import ErrorTable
from estimator.diagnosis.result import BudgetRow
from estimator.diagnosis.verdict import Answer


def budget(table: ErrorTable, answer: Answer | None) -> tuple[BudgetRow, ...]:
    """Shares of the mean squared error: of each effect of the `answer`, of what is left, and of noise alone. What
    several effects take away together is shared out by what is missing without each. Empty where there is nothing
    beyond noise."""

    row, without = (0, ()) if answer is None else (answer.row, answer.without)

    def shares(blocks: IndexArray | None) -> FloatArray:
        """(2, rows) of the error beyond noise, and of the whole error."""
        excess, whole, after = table.excess(0, blocks), table.error(0, blocks) ** 2, table.error(row, blocks) ** 2
        if excess <= 0.0:
            return np.full((2, 3 + len(without or ([row] if row else []))), np.nan)
        each = np.array([max(table.error(k, blocks) ** 2 - after, 1e-12) for k in without])
        split = each / each.sum() if len(each) else np.ones(int(row > 0))
        closed, explained = (whole - after) / excess, max(whole - after, 0.0)
        floor = min(1.0, whole - explained)
        return np.array([[1.0, *closed * split, 1.0 - closed, 1.0 / excess],
                         [1.0, *explained / whole * split, 1.0 - (explained + floor) / whole, floor / whole]])

    point = shares(None)
    if np.isnan(point).any():
        return ()
    low, high = np.nanquantile([shares(d) for d in table.draws], [0.025, 0.975], axis=0)
    named = () if answer is None else answer.best[0].model.effects
    parts = [("nominal", None), *(("cause", e) for e in named), ("remainder", None), ("noise", None)]
    return tuple(BudgetRow(what, float(value[0]), (float(a[0]), float(b[0])), None if e is None else e.name,
                           None if e is None else e.joint_number, float(value[1]),
                           (float(a[1]), float(b[1])))
                 for (what, e), value, a, b in zip(parts, point.T, low.T, high.T))
