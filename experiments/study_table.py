"""A study's runs as the numbers of Table III, beside the paper's print, the floor and the Cramer-Rao bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from experiments.study import CASES, FLOOR, METHODS, TORQUE_VARIANCE, Block, BlockResult, Case, truth
from experiments.study_bound import exact_bound
from experiments.walker import motor_mechanism, one_step

FloatArray = NDArray[np.float64]
SCHEMA = "legid.monte-carlo/1"
PAPER: dict[str, tuple[tuple[float, float, int], ...]] = {
    "mle": ((1.242, 0.009, 0), (1.231, 0.010, 0), (1.195, 0.011, 0), (1.149, 2.567, 2)),
    "wls": ((1.753, 0.016, 0), (1.884, 0.055, 0), (2.480, 5.023, 0), (6e4, 1.9e12, 132)),
    "hekf": ((6.804, 455.9, 25), (214.1, 1e7, 228), (1e3, 2e8, 246), (196.1, 2.98e6, 160)),
    "rls": ((1.245, 0.009, 0), (0.5952, 0.0279, 0), (0.5136, 0.1169, 0), (7.1788, 173.1557, 4)),
}
"""Table III as printed: mean, variance, failed simulations of cases 1 to 4."""


@dataclass(frozen=True)
class Cell:
    """One method in one case."""

    case: int
    method: str
    runs: int
    mean: float
    """of the summed squared angle errors of the runs that did not fail [rad^2]"""
    variance: float
    median: float
    failed: int
    not_converged: int
    mse_over_bound: float
    """tr(C^-1 M) / p: mean squared parameter error M of all runs over the bound C, averaged over directions"""
    worst_over_bound: float
    """the same for the single parameter where it is largest"""
    coverage: float
    """share of all parameters of all runs whose 95 % interval holds the truth"""
    seconds: float
    """of computing, all workers together"""


@dataclass(frozen=True)
class Table:
    """A whole study."""

    seed: int
    runs: int
    cells: tuple[Cell, ...]
    errors: Mapping[tuple[int, str], FloatArray]
    """(case, method) to the errors (R,) of all runs, NaN where one failed."""

    def cell(self, case: int, method: str) -> Cell | None:
        """None where the study did not hold it."""
        return next((c for c in self.cells if c.case == case and c.method == method), None)

    @property
    def cases(self) -> list[Case]:
        return [case for case in CASES if any(c.case == case.number for c in self.cells)]

    @property
    def methods(self) -> list[str]:
        """In the paper's words, the floor last."""
        return [m for m in (*METHODS, FLOOR) if any(c.method == m for c in self.cells)]


def bound(case: Case) -> FloatArray:
    """The Cramer-Rao bound (8, 8) of one record of a case."""
    return exact_bound(motor_mechanism(), truth(), one_step().in_motor_angles(), case.angle_variance, TORQUE_VARIANCE)


def make_table(results: Mapping[Block, BlockResult], seed: int) -> Table:
    """Sum up the blocks of a study."""
    groups: dict[tuple[int, str], list[tuple[Block, BlockResult]]] = {}
    for block, result in results.items():
        groups.setdefault((block.case.number, block.method), []).append((block, result))
    cells, errors = [], {}
    bounds = {case.number: bound(case) for case in CASES if any(number == case.number for number, _ in groups)}
    for (number, method), parts in sorted(groups.items()):
        found = [result for _, result in sorted(parts, key=lambda part: part[0].first)]
        errors[number, method] = np.concatenate([r.error for r in found])
        cells.append(_cell(number, method, found, bounds[number]))
    return Table(seed, max((c.runs for c in cells), default=0), tuple(cells), errors)


def _cell(number: int, method: str, found: list[BlockResult], smallest: FloatArray) -> Cell:
    error = np.concatenate([r.error for r in found])
    good = error[np.isfinite(error)]
    off = np.concatenate([r.beta for r in found]) - truth()
    std = np.concatenate([r.std for r in found])
    fitted = np.isfinite(off).all(axis=1)
    moment = off[fitted].T @ off[fitted] / max(int(fitted.sum()), 1)
    inside = np.abs(off[fitted]) <= float(norm.ppf(0.975)) * std[fitted]
    return Cell(
        number, method, error.size, float(np.mean(good)) if good.size else np.nan,
        float(np.var(good, ddof=1)) if good.size > 1 else np.nan, float(np.median(good)) if good.size else np.nan,
        int(sum(int(r.failed.sum()) for r in found)), int(sum(int((~r.converged).sum()) for r in found)),
        float(np.trace(np.linalg.solve(smallest, moment)) / len(smallest)),
        float(np.max(np.diag(moment) / np.diag(smallest))), float(np.mean(inside)) if fitted.any() else np.nan,
        float(sum(r.seconds for r in found)))


def table_document(table: Table, wall_s: float) -> dict[str, Any]:
    """`legid.monte-carlo/1`."""
    rows = []
    for cell in table.cells:
        row = asdict(cell)
        printed = PAPER.get(cell.method, ())
        if cell.case <= len(printed):
            mean, variance, failed = printed[cell.case - 1]
            row["paper"] = {"mean": mean, "variance": variance, "failed": failed, "runs": 1000}
        floor = table.cell(cell.case, FLOOR)
        if floor is not None and cell.method != FLOOR:
            row["mean_over_floor"] = cell.mean / floor.mean
        rows.append(row)
    return {"schema": SCHEMA, "model": "biped3", "seed": table.seed, "runs": table.runs, "wall_s": wall_s,
            "cases": [case._asdict() for case in table.cases], "results": rows}
