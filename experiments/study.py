"""The simulation study of section V: many noisy records of one walker step, fitted by every method.

Work is cut into blocks of `BLOCK` runs of one case and method. A run's noise depends on the seed, the case and the
run's number alone, so results do not depend on how the work was cut, where it ran or how often it was interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.dataset import Dataset
from estimator.errors import FitError
from estimator.fit_each import fit_each
from estimator.options import FitOptions
from experiments.free_run import free_runs
from experiments.walker import MOTOR_ANGLES, Step, motor_mechanism, one_step, true_parameters

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
BLOCK = 50
TORQUE_VARIANCE = 0.1
"""sigma_u^2 of both motors [N^2 m^2]"""
PASSIVE_NM = 0.03
"""Standard deviation that stands for the stance foot's exact zero [N m]: a tenth of the motors' noise. MLE does not
hinge on it (tests/test_study.py)."""
FLOOR = "floor"
"""Least squares on the true states: only torque noise is left."""
METHODS = ("mle", "wls", "rls", "hekf")


class Case(NamedTuple):
    """One column of Table II."""

    number: int
    angle_variance: float
    """of the absolute angle [rad^2]"""
    half_power: float
    """of the 5th-order Butterworth filter, share of the Nyquist rate"""
    spacing: int
    """n_cd"""


CASES = (Case(1, 1e-10, 1.0, 2), Case(2, 1e-8, 0.5, 3), Case(3, 1e-6, 0.25, 5), Case(4, 1e-4, 0.1, 7),
         Case(5, 1e-3, 0.1, 7))
"""Table II; the paper gives no filter for its fifth case, which here has that of case 4."""


@dataclass(frozen=True)
class Block:
    """Runs first .. first + count - 1 of one case by one method."""

    case: Case
    method: str
    first: int
    count: int
    seed: int

    @property
    def name(self) -> str:
        """Of the file that keeps its result."""
        return f"case{self.case.number}-{self.method}-seed{self.seed}-runs{self.first}-{self.first + self.count}"


@dataclass(frozen=True)
class BlockResult:
    """What came out, one entry a run."""

    beta: FloatArray
    """(R, 8), NaN where the fit failed"""
    std: FloatArray
    """(R, 8)"""
    error: FloatArray
    """(R,) summed squared angle error of the free run [rad^2], NaN where it failed"""
    converged: BoolArray
    failed: BoolArray
    """(R,) no fit, or a free run that could not be carried to its end"""
    seconds: float
    """spent on the whole block, fits and free runs"""


def blocks(cases: Sequence[Case], methods: Sequence[str], runs: int, seed: int) -> list[Block]:
    """All work of a study; cheap methods first, so that a table soon has something in every column."""
    return [Block(case, method, first, min(BLOCK, runs - first), seed)
            for method in sorted(methods, key=[FLOOR, "wls", "rls", "hekf", "mle"].index)
            for case in cases for first in range(0, runs, BLOCK)]


def noisy_record(step: Step, case: Case, seed: int, run: int) -> Dataset:
    """One run: the absolute angle by (55), (56), torques by (15), relative angles free of noise as in the paper."""
    rng = np.random.default_rng([seed, case.number, run])
    n = len(step.time_s)
    torque = step.torque[:, 1:] + np.sqrt(TORQUE_VARIANCE) * rng.normal(size=(n, 2))
    columns = {"q1_rad": step.q[:, 0] + np.sqrt(case.angle_variance) * rng.normal(size=n),
               "q2_rad": step.q[:, 1], "q3_rad": step.q[:, 2], "tau2_nm": torque[:, 0], "tau3_nm": torque[:, 1]}
    return Dataset(f"case {case.number}, run {run}", 1.0 / (step.time_s[1] - step.time_s[0]), step.time_s, columns)


def case_options(case: Case) -> FitOptions:
    """Everything the paper assumes known: noise levels, and the filter of Table II."""
    noise = {"encoder1_rad": float(np.sqrt(case.angle_variance)), "encoder2_rad": 0.0, "encoder3_rad": 0.0,
             "torque_nm": float(np.sqrt(TORQUE_VARIANCE)), "passive_nm": PASSIVE_NM}
    return FitOptions(sensors="encoder", hold="zero", noise=noise, half_power=case.half_power, spacing=case.spacing,
                      filter_order=5)


def run_block(block: Block) -> BlockResult:
    """Make the records, fit them, and simulate every model from the true state under the true torque."""
    started = time.perf_counter()
    step, mechanism = one_step().in_motor_angles(), motor_mechanism()
    records = [noisy_record(step, block.case, block.seed, run) for run in range(block.first, block.first + block.count)]
    beta = np.full((block.count, mechanism.p), np.nan)
    std, converged = np.full_like(beta, np.nan), np.zeros(block.count, dtype=bool)
    if block.method == FLOOR:
        beta, std = _floor(step, records)
        converged[:] = True
    else:
        for k, outcome in enumerate(fit_each(records, mechanism, case_options(block.case), block.method)):
            if not isinstance(outcome, FitError):
                beta[k], std[k], converged[k] = outcome.beta, outcome.std, outcome.converged
    free = free_runs(mechanism, beta, step.q[0], step.qd[0], step.torque, 1.0 / records[0].rate_hz)
    angles = (free.q - step.q) @ np.linalg.inv(MOTOR_ANGLES).T
    error = np.where(free.failed, np.nan, np.sum(angles**2, axis=(1, 2)))
    return BlockResult(beta, std, error, converged, free.failed, time.perf_counter() - started)


def _floor(step: Step, records: Sequence[Dataset]) -> tuple[FloatArray, FloatArray]:
    """Least squares (28) on the true states and accelerations, all rows weighted alike, and its true spread."""
    mechanism = motor_mechanism()
    z = mechanism.regressor(step.q, step.qd, step.qdd).reshape(-1, mechanism.p)
    solver = np.linalg.pinv(z)
    torque = np.stack([np.column_stack([np.zeros(len(r)), r["tau2_nm"], r["tau3_nm"]]).ravel() for r in records])
    variance = np.tile([0.0, TORQUE_VARIANCE, TORQUE_VARIANCE], len(step.time_s))
    std = np.sqrt((solver**2 * variance).sum(axis=1))
    return torque @ solver.T, np.tile(std, (len(records), 1))


def truth() -> FloatArray:
    """beta (8,) that every run should find."""
    return true_parameters()
