"""A study's runs as the numbers of Table III, with the paper's, the floor and the Cramer-Rao bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from daq import FloatArray
from studies.biped3.bound import exact_bound
from studies.biped3.protocol import OURS, Protocol
from studies.biped3.study import (
    CASES,
    FLOOR,
    KNOWN_WLS,
    PAPERS_MLE,
    Block,
    BlockResult,
    Case,
    error_of_differences,
    error_of_truth,
    truth,
)
from studies.walker import motor_mechanism

LABELS = {"mle": "MLE", PAPERS_MLE: "MLE of the paper", "wls": "WLS-FCD",
          KNOWN_WLS: "WLS-FCD, known weights", "rls": "RLS", "hekf": "HEKF", FLOOR: "floor"}
SCHEMA = "legid.monte-carlo/1"
FALSE_MINIMUM = 1e-2
"""An estimate whose sum of squares is higher than the truth's by more than this sits in a false minimum."""
PAPER: dict[str, tuple[tuple[float, float, int], ...]] = {
    "mle": ((1.242, 0.009, 0), (1.231, 0.010, 0), (1.195, 0.011, 0), (1.149, 2.567, 2)),
    "wls": ((1.753, 0.016, 0), (1.884, 0.055, 0), (2.480, 5.023, 0), (6e4, 1.9e12, 132)),
    "hekf": ((6.804, 455.9, 25), (214.1, 1e7, 228), (1e3, 2e8, 246), (196.1, 2.98e6, 160)),
    "rls": ((1.245, 0.009, 0), (0.5952, 0.0279, 0), (0.5136, 0.1169, 0), (7.1788, 173.1557, 4)),
}
PAPER[PAPERS_MLE], PAPER[KNOWN_WLS] = PAPER["mle"], PAPER["wls"]
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
    mse_over_bound: tuple[float, ...]
    """(8,) mean squared error of each parameter over its Cramer-Rao bound"""
    bias_over_bound: tuple[float, ...]
    """(8,) mean error of each parameter over the bound's standard deviation"""
    median_over_truth: tuple[float, ...]
    """(8,) median estimate of each parameter over its true value"""
    coverage_by_parameter: tuple[float, ...]
    """(8,) share of the runs whose 95 % interval holds the truth"""
    mse_over_bound_all_directions: float
    """tr(C^-1 M) / 8: the mean squared error M over the bound C, averaged over directions instead of parameters"""
    likelihood_ratio: float
    """mean of `studies.biped3.likelihood`, 8 for an efficient estimator; NaN for methods other than mle"""
    joint_coverage: float
    """share of the runs whose 95 % likelihood region holds the truth"""
    false_minima: int
    """runs whose estimate explains the record worse than the truth does"""
    seconds: float
    """of processor time, all workers together"""

    @property
    def mean_mse_over_bound(self) -> float:
        """Averaged over the parameters."""
        return float(np.mean(self.mse_over_bound))

    @property
    def coverage(self) -> float:
        """Share of all parameters of all runs whose 95 % interval holds the truth."""
        return float(np.mean(self.coverage_by_parameter))

    @property
    def standard_error(self) -> float:
        """Standard error of `mean`."""
        return float(np.sqrt(self.variance / max(self.runs - self.failed, 1)))


@dataclass(frozen=True)
class Table:
    """A whole study."""

    seed: int
    runs: int
    cells: tuple[Cell, ...]
    errors: Mapping[tuple[int, str], FloatArray]
    """(case, method) to the errors (R,) of all runs, NaN where one failed."""
    differences: Mapping[int, float]
    """Case to the error of WLS-FCD on the record without noise [rad^2]; NaN where that failed."""
    protocol: Protocol = OURS

    @cached_property
    def true_error(self) -> float:
        """Error of the true parameters under the protocol's own replay [rad^2]."""
        return error_of_truth(self.protocol)

    def cell(self, case: int, method: str) -> Cell | None:
        """None where the study did not hold it."""
        return next((c for c in self.cells if c.case == case and c.method == method), None)

    @property
    def seconds(self) -> float:
        """Seconds of processor time, all workers together."""
        return sum(cell.seconds for cell in self.cells)

    @property
    def cases(self) -> list[Case]:
        return [case for case in CASES if any(c.case == case.number for c in self.cells)]

    @property
    def methods(self) -> list[str]:
        """In the paper's order, the floor last."""
        order = ("mle", PAPERS_MLE, "wls", KNOWN_WLS, "hekf", "rls", FLOOR)
        return [m for m in order if any(c.method == m for c in self.cells)]


def bound(case: Case, protocol: Protocol = OURS) -> FloatArray:
    """The Cramer-Rao bound (8, 8) of one record of a case, torque held between samples."""
    return exact_bound(motor_mechanism(), truth(), protocol.step(), case.angle_variance, protocol.torque_variance)


def make_table(results: Mapping[Block, BlockResult], seed: int, protocol: Protocol = OURS) -> Table:
    """Sum up the blocks of a study."""
    groups: dict[tuple[int, str], list[tuple[Block, BlockResult]]] = {}
    for block, result in results.items():
        groups.setdefault((block.case.number, block.method), []).append((block, result))
    cells, errors = [], {}
    bounds = {case.number: bound(case, protocol) for case in CASES
              if any(number == case.number for number, _ in groups)}
    for (number, method), parts in sorted(groups.items()):
        found = [result for _, result in sorted(parts, key=lambda part: part[0].first)]
        errors[number, method] = np.concatenate([r.error for r in found])
        cells.append(_cell(number, method, found, bounds[number]))
    differences = {case.number: error_of_differences(case, protocol) for case in CASES if case.number in bounds}
    return Table(seed, max((c.runs for c in cells), default=0), tuple(cells), errors, differences, protocol)


def _cell(number: int, method: str, found: list[BlockResult], smallest: FloatArray) -> Cell:
    error = np.concatenate([r.error for r in found])
    good = error[np.isfinite(error)]
    off = np.concatenate([r.beta for r in found]) - truth()
    std = np.concatenate([r.std for r in found])
    ratio = np.concatenate([r.likelihood_ratio for r in found])
    ratio = ratio[np.isfinite(ratio)]
    fitted = np.isfinite(off).all(axis=1)
    off, std = off[fitted], std[fitted]
    nothing = np.full((1, len(smallest)), np.nan)
    moment = off.T @ off / len(off) if len(off) else np.diag(nothing[0])
    spread = np.sqrt(np.diag(smallest))
    inside = (np.abs(off) <= float(norm.ppf(0.975)) * std).astype(float) if len(off) else nothing

    def each(values: FloatArray) -> tuple[float, ...]:
        return tuple(float(value) for value in values)

    return Cell(
        case=number, method=method, runs=error.size, mean=_mean(good),
        variance=float(np.var(good, ddof=1)) if good.size > 1 else np.nan,
        median=float(np.median(good)) if good.size else np.nan,
        failed=sum(int(r.failed.sum()) for r in found),
        not_converged=sum(int((~r.converged).sum()) for r in found),
        mse_over_bound=each(np.diag(moment) / spread**2),
        bias_over_bound=each((off if len(off) else nothing).mean(axis=0) / spread),
        median_over_truth=each(1.0 + np.median(off if len(off) else nothing, axis=0) / truth()),
        coverage_by_parameter=each(inside.mean(axis=0)),
        mse_over_bound_all_directions=float(np.trace(np.linalg.solve(smallest, moment)) / len(smallest)),
        likelihood_ratio=_mean(ratio),
        joint_coverage=_mean(ratio < float(chi2.ppf(0.95, len(smallest)))),
        false_minima=int(np.sum(ratio < -FALSE_MINIMUM)),
        seconds=sum(r.seconds for r in found))


def _mean(values: NDArray[np.float64] | NDArray[np.bool_]) -> float:
    return float(np.mean(values)) if values.size else np.nan


def table_document(table: Table, wall_s: float, machine: str = "") -> dict[str, Any]:
    """`legid.monte-carlo/1`; `wall_s` counts this call alone, `processor_s` all work, also that of earlier calls."""
    rows = []
    for cell in table.cells:
        row = asdict(cell) | {"coverage": cell.coverage, "standard_error": cell.standard_error,
                              "mean_excess": cell.mean - table.true_error}
        printed = PAPER.get(cell.method, ())
        if cell.case <= len(printed):
            mean, variance, failed = printed[cell.case - 1]
            row["paper"] = {"mean": mean, "variance": variance, "failed": failed, "runs": 1000}
        floor = table.cell(cell.case, FLOOR)
        if floor is not None and cell.method != FLOOR:
            row["mean_over_floor"] = cell.mean / floor.mean
        rows.append(row)
    cases = [{**case._asdict(), "error_of_differences_without_noise": table.differences[case.number],
              "bound_std": np.sqrt(np.diag(bound(case, table.protocol))).tolist()} for case in table.cases]
    return {"schema": SCHEMA, "model": "biped3", "seed": table.seed, "runs": table.runs,
            "protocol": table.protocol.name, "true_parameters_error": table.true_error, "wall_s": wall_s,
            "processor_s": table.seconds, "machine": machine, "truth": truth().tolist(), "cases": cases,
            "results": rows}
