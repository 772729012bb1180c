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

from daq import Dataset, FloatArray
from estimator import METHODS, FitError, FitOptions, Method
from estimator.fitting import fit_each
from studies.biped3.likelihood import likelihood_ratio
from studies.biped3.protocol import OURS, TORQUE_VARIANCE, Protocol
from studies.rk4_free_run import free_runs
from studies.walker import MOTOR_ANGLES, Step, motor_mechanism, true_parameters

BoolArray = NDArray[np.bool_]
BLOCK = 50
PAPERS_MLE = "mle-free"
"""The paper's own MLE, with free latents and central differences (`estimator.fitting.mle_free`); on request."""
KNOWN_WLS = "wls-known"
"""WLS with the known Sigma_tau in (29) in place of weights by each joint's residual; on request."""
FLOOR = "floor"
"""Least squares on the true states: only torque noise is left."""


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
    protocol: Protocol = OURS

    @property
    def name(self) -> str:
        """Name of the file that keeps its result."""
        protocol = "" if self.protocol == OURS else f"{self.protocol.name}-"
        return (f"{protocol}case{self.case.number}-{self.method}-seed{self.seed}-"
                f"runs{self.first}-{self.first + self.count}")


@dataclass(frozen=True)
class BlockResult:
    """Results, one entry a run."""

    beta: FloatArray
    """(R, 8), NaN where the fit failed"""
    std: FloatArray
    """(R, 8)"""
    error: FloatArray
    """(R,) summed squared angle error of the free run [rad^2], NaN where it failed"""
    converged: BoolArray
    failed: BoolArray
    """(R,) no fit, or a free run that could not be carried to its end"""
    likelihood_ratio: FloatArray
    """(R,) of the estimate against the truth (`likelihood`); NaN for methods other than mle"""
    seconds: float
    """of the processor spent on the whole block, fits and free runs: other work on the machine does not count"""


def blocks(cases: Sequence[Case], methods: Sequence[str], runs: int, seed: int,
           protocol: Protocol = OURS) -> list[Block]:
    """All work of a study. Every method and case advances alike, so that the time left can be told from the time
    spent; within one round the slowest come first, so that workers end together."""
    slowest = [PAPERS_MLE, "mle", "hekf", "rls", "wls", KNOWN_WLS, FLOOR]
    return [Block(case, method, first, min(BLOCK, runs - first), seed, protocol) for first in range(0, runs, BLOCK)
            for method in sorted(methods, key=slowest.index) for case in reversed(cases)]


def noisy_record(step: Step, case: Case, seed: int, run: int, torque_variance: float = TORQUE_VARIANCE) -> Dataset:
    """One run: the absolute angle by (55), (56), torques by (15), relative angles free of noise as in the paper."""
    rng = np.random.default_rng([seed, case.number, run])
    n = len(step.time_s)
    torque = step.torque[:, 1:] + np.sqrt(torque_variance) * rng.normal(size=(n, 2))
    columns = {"q1_rad": step.q[:, 0] + np.sqrt(case.angle_variance) * rng.normal(size=n),
               "q2_rad": step.q[:, 1], "q3_rad": step.q[:, 2], "tau2_nm": torque[:, 0], "tau3_nm": torque[:, 1]}
    return Dataset(f"case {case.number}, run {run}", 1.0 / (step.time_s[1] - step.time_s[0]), step.time_s, columns)


def noise_free_record(step: Step) -> Dataset:
    """The same columns as they truly are."""
    columns = {"q1_rad": step.q[:, 0], "q2_rad": step.q[:, 1], "q3_rad": step.q[:, 2], "tau2_nm": step.torque[:, 1],
               "tau3_nm": step.torque[:, 2]}
    return Dataset("no noise", 1.0 / (step.time_s[1] - step.time_s[0]), step.time_s, columns)


def case_options(case: Case, method: str = "mle", protocol: Protocol = OURS) -> FitOptions:
    """Everything the paper assumes known: noise levels, and the filter of Table II."""
    noise = {"encoder1_rad": float(np.sqrt(case.angle_variance)), "encoder2_rad": 0.0, "encoder3_rad": 0.0,
             "torque_nm": float(np.sqrt(protocol.torque_variance)), "passive_nm": protocol.passive_nm}
    return FitOptions(sensors="encoder", hold=protocol.hold, noise=noise, half_power=case.half_power,
                      spacing=protocol.samples_apart(case.spacing), filter_order=5,
                      latent="free" if method == PAPERS_MLE else "trajectory",
                      weights="known" if method == KNOWN_WLS else "estimated",
                      torque_half_power=case.half_power if protocol.torque_filtered else None)


def run_block(block: Block) -> BlockResult:
    """Make the records, fit them, and simulate every model from the true state under the true torque."""
    started = time.process_time()
    step = block.protocol.step()
    variance = block.protocol.torque_variance
    records = [noisy_record(step, block.case, block.seed, run, variance)
               for run in range(block.first, block.first + block.count)]
    beta, std, converged = (_floor(step, records, variance) if block.method == FLOOR
                            else _fits(case_options(block.case, block.method, block.protocol), block.method, records))
    error = simulation_errors(step, beta)
    ratio = np.full(block.count, np.nan)
    if block.method == "mle":
        ratio = likelihood_ratio(records, case_options(block.case, protocol=block.protocol), beta, truth(), step)
    return BlockResult(beta, std, error, converged, np.isnan(error), ratio, time.process_time() - started)


def simulation_errors(step: Step, beta: FloatArray) -> FloatArray:
    """(R,) summed squared errors of the paper's three angles over the free runs of beta (R, 8) [rad^2]; NaN: failed."""
    free = free_runs(motor_mechanism(), beta, step.q[0], step.qd[0], step.torque, step.time_s[1] - step.time_s[0])
    angles = (free.q - step.q) @ np.linalg.inv(MOTOR_ANGLES).T
    return np.where(free.failed, np.nan, np.sum(angles**2, axis=(1, 2)))


def error_of_differences(case: Case, protocol: Protocol = OURS) -> float:
    """Error [rad^2] that WLS-FCD leaves on the record without any noise: the bias of its filter and differences."""
    step = protocol.step()
    beta, _, _ = _fits(case_options(case, "wls", protocol), "wls", [noise_free_record(step)])
    return float(simulation_errors(step, beta)[0])


def error_of_truth(protocol: Protocol) -> float:
    """Error [rad^2] of the true parameters: what the protocol's own replay of the torque leaves."""
    return float(simulation_errors(protocol.step(), truth()[None])[0])


OF_FIT: dict[str, Method] = {**{method: method for method in METHODS}, PAPERS_MLE: "mle", KNOWN_WLS: "wls"}
"""Method of the study -> that of the fit."""


def _fits(options: FitOptions, method: str, records: Sequence[Dataset]) -> tuple[FloatArray, FloatArray, BoolArray]:
    """beta, std (R, 8) and convergence (R,); NaN where there is no fit."""
    mechanism = motor_mechanism()
    beta = np.full((len(records), mechanism.p), np.nan)
    std, converged = np.full_like(beta, np.nan), np.zeros(len(records), dtype=bool)
    for k, outcome in enumerate(fit_each(records, mechanism, options, OF_FIT[method])):
        if not isinstance(outcome, FitError):
            beta[k], std[k], converged[k] = outcome.beta, outcome.std, outcome.converged
    return beta, std, converged


def _floor(step: Step, records: Sequence[Dataset], torque_variance: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Least squares (28) on the true states and accelerations, all rows weighted alike, and its true spread."""
    mechanism = motor_mechanism()
    z = mechanism.regressor(step.q, step.qd, step.qdd).reshape(-1, mechanism.p)
    solver = np.linalg.pinv(z)
    torque = np.stack([np.column_stack([np.zeros(len(r)), r["tau2_nm"], r["tau3_nm"]]).ravel() for r in records])
    variance = np.tile([0.0, torque_variance, torque_variance], len(step.time_s))
    std = np.sqrt((solver**2 * variance).sum(axis=1))
    return torque @ solver.T, np.tile(std, (len(records), 1)), np.ones(len(records), dtype=bool)


def truth() -> FloatArray:
    """beta (8,) that every run should find."""
    return true_parameters()
