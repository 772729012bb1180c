"""Demands on the study: each demand with the measured figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from estimator import METHODS
from studies.biped3.study import CASES, FLOOR
from studies.biped3.table import LABELS, Cell, Table

CLEAN = (1, 2, 3)
"""Cases in which angles are good enough for the floor to be in reach."""
REGULAR = (1, 2, 3, 4)
WHOLE_RUNS = 1000
FAILING = 5
"""The case in which the paper's method 'ceases to be reliable'."""


class Claim(NamedTuple):
    """One demand; `met` as measured."""

    demand: str
    measured: str
    met: bool


def claims(table: Table) -> list[Claim]:
    """Those that the cases and methods of this study can speak of."""
    found = [_leads(table), _failures(table), _floor(table),
             _each(table, REGULAR, "squared error of each parameter at most 1.3 of its Cramér-Rao bound, {}",
                   lambda cell: f"mean {cell.mean_mse_over_bound:.3f}, worst {max(cell.mse_over_bound):.3f}",
                   lambda cell: max(cell.mse_over_bound) <= 1.3),
             _each(table, REGULAR, "95 % intervals hold the truth in 93 to 97 % of runs, {}",
                   lambda cell: f"{100.0 * cell.coverage:.1f} %", lambda cell: 0.93 <= cell.coverage <= 0.97),
             _each(table, (FAILING,), "at most 1 % failed simulations of MLE in {}",
                   lambda cell: f"{cell.failed} of {cell.runs}", lambda cell: cell.failed <= 0.01 * cell.runs)]
    return [claim for claim in [*found, _time(table)] if claim is not None]


def _mle(table: Table, cases: tuple[int, ...]) -> list[Cell]:
    return [cell for cell in table.cells if cell.method == "mle" and cell.case in cases]


def _each(table: Table, cases: tuple[int, ...], demand: str, show: Callable[[Cell], str],
          met: Callable[[Cell], bool]) -> Claim | None:
    """A demand on the mle of every one of `cases` that the study holds."""
    cells = _mle(table, cases)
    if not cells:
        return None
    return Claim(demand.format(in_words([cell.case for cell in cells])), "; ".join(show(cell) for cell in cells),
                 all(met(cell) for cell in cells))


def in_words(cases: Sequence[int]) -> str:
    """1, 2, 3 as 'cases 1 to 3'."""
    if len(cases) == 1:
        return f"case {cases[0]}"
    run = len(cases) > 2 and list(cases) == list(range(cases[0], cases[-1] + 1))
    return f"cases {cases[0]} to {cases[-1]}" if run else f"cases {', '.join(map(str, cases[:-1]))} and {cases[-1]}"


def runner_up(table: Table, case: int) -> Cell | None:
    """The best of the other methods of the paper."""
    others = [c for c in table.cells if c.case == case and c.method in METHODS and c.method != "mle"
              and np.isfinite(c.mean)]
    return min(others, key=lambda cell: cell.mean, default=None)


def lead(table: Table, case: int) -> float:
    """Difference of the runner-up's mean error from that of mle in standard errors, run by run where neither failed."""
    second = runner_up(table, case)
    if second is None or (case, "mle") not in table.errors:
        return np.nan
    gap = table.errors[case, second.method] - table.errors[case, "mle"]
    gap = gap[np.isfinite(gap)]
    return float(np.mean(gap) / np.std(gap, ddof=1) * np.sqrt(gap.size)) if gap.size > 1 else np.nan


def _leads(table: Table) -> Claim | None:
    cells = _mle(table, (*REGULAR, FAILING))
    pairs = [(cell, second) for cell in cells if (second := runner_up(table, cell.case)) is not None]
    if not pairs:
        return None
    shown = "; ".join(_ahead(table, cell, second) for cell, second in pairs)
    return Claim(f"MLE has the lowest mean error, {in_words([cell.case for cell, _ in pairs])}",
                 f"error of the next best: {shown}", all(cell.mean < second.mean for cell, second in pairs))


def _ahead(table: Table, cell: Cell, second: Cell) -> str:
    factor = second.mean / cell.mean
    if factor >= 10.0:
        return f"{LABELS[second.method]} {factor:.0f} times"
    return f"{LABELS[second.method]} {factor:.2f} times ({lead(table, cell.case):.1f} standard errors apart)"


def _failures(table: Table) -> Claim | None:
    cells = _mle(table, REGULAR)
    if not cells:
        return None
    failed, runs = sum(cell.failed for cell in cells), sum(cell.runs for cell in cells)
    return Claim(f"no failed simulation of MLE, {in_words([cell.case for cell in cells])}",
                 f"{failed} of {runs}", failed == 0)


def _time(table: Table) -> Claim | None:
    """Only of the whole study, of at least as many runs as the paper's."""
    cells = [cell for cell in table.cells if cell.method in (*METHODS, FLOOR)]
    if len(cells) < len(CASES) * (len(METHODS) + 1) or min(cell.runs for cell in cells) < WHOLE_RUNS:
        return None
    spent = sum(cell.seconds for cell in cells)
    return Claim(f"the whole study, {len(CASES)} cases by {len(METHODS)} methods, in 10 minutes on 2 cores",
                 f"{spent:.0f} s of processor time, floor included", spent <= 2 * 600.0)


def _floor(table: Table) -> Claim | None:
    pairs = [(cell, floor) for cell in _mle(table, CLEAN) if (floor := table.cell(cell.case, FLOOR)) is not None]
    if not pairs:
        return None
    ratios = [cell.mean / floor.mean for cell, floor in pairs]
    return Claim(f"mean error of MLE at most 2 times the floor, {in_words([cell.case for cell, _ in pairs])}",
                 "; ".join(f"{ratio:.2f}" for ratio in ratios), max(ratios) <= 2.0)
