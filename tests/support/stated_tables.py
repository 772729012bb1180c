"""Tables of free-run errors that are written down, and families of models in their rows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimator.diagnosis.decision_rule import DRAWS
from estimator.diagnosis.error_table import ErrorTable
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.verdict import Answer, Family
from tests.support.stated_fits import explained

BLOCKS, RUNS = 20, 2
COLUMNS = (("q1_rad", 1.0), ("q2_rad", 1.0), ("q2_rad", np.inf))


def table_of(*errors: float, agreement: Sequence[Sequence[float]] | None = None, spread: float = 0.5,
             blocks: int = BLOCKS) -> ErrorTable:
    """Models whose rms errors are `errors` in units of noise alone, with the same scatter from block to block.

    Each is likelier than those before, on both runs, by default.
    """
    common = np.random.default_rng(0).gamma(1.0 / spread**2, spread**2, (1, blocks, len(COLUMNS)))
    values = np.array(errors)[:, None, None] ** 2 * common / common.mean()
    told = np.array(agreement if agreement is not None else [[10.0 * k] * RUNS for k in range(len(errors))], float)
    draws = np.random.default_rng(1).integers(0, blocks, (DRAWS, blocks), dtype=np.intp)
    return ErrorTable(COLUMNS, values, told, np.repeat(np.arange(RUNS), blocks // RUNS), draws,
                      np.full(len(COLUMNS), 1e-6), np.ones(len(COLUMNS)))


def scaled(table: ErrorTable, model: int, factor: float, blocks: slice | int = slice(None)) -> ErrorTable:
    """`table` with errors of a model in some blocks `factor` times as large."""
    values = table.values.copy()
    values[model, blocks] *= factor**2
    return replace(table, values=values)


def family_of(*best: Explanation, own: int = 0, more: int = 1, without: tuple[int, ...] = (), imitates: bool = False
              ) -> Family:
    """The answer in row 1, by default a drag, with its generic terms in row `more`; `own` are the nominal model's."""
    return Family(own, Answer(best or (explained(900.0, "drag"),), 1, without, more, imitates))
