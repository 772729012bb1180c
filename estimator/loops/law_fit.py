r"""`LawFit`: the law of a joint's loop in several runs, and what readings and loop do otherwise.

In each run the input is w = k (c - q) + b with a gain and a constant of its own. A fault corrects input, command or
angle; its sizes are common to all runs. With s_r the rms residual of run r as a share of its input, and f what a law
errs by without any fault, -2 log L = sum_r N_r log (s_r^2 + f^2), each run having a noise level of its own. The law
holds between readings of the controller, without the mechanics of the leg. So it shows a fault of a reading that the
leg's own model, or its feedback, hides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import stdtr

from daq import FloatArray
from estimator.loops.law_faults import LawFault
from estimator.loops.law_run import LawRun

LEAST_SHARE = 0.02
"""Share of the input, as rms values, up to which a law holds: registers, averages and their times differ by a per cent.
"""
SUFFICES = 0.5
"""Share of the mean square residual that a fault must explain."""
RIVAL = 0.95
"""Share of what the likeliest fault explains from which another explains as much, if it leaves at most EDGE times the
residual."""
EDGE = 1.5
ALPHA = 0.05
"""Probability of a fault by chance, over all that are tried."""
MOST_FAULTS = 3
BLOCK_S, LEAST_BLOCKS = 2.0, 4
FLOOR = 0.5 * LEAST_SHARE
"""Error of a law that is no fault and no noise, as a share of the input; it is added to the residual of every run."""
Found = tuple[tuple[LawFault, FloatArray], ...]
"""Faults with their sizes."""


@dataclass(frozen=True)
class LawFit:
    """The law with some faults."""

    runs: tuple[LawRun, ...]
    faults: Found

    @cached_property
    def fits(self) -> list[tuple[float, float]]:
        """Gain, and the mean square residual as a share of the input's, of each run."""
        return [_regressed(run, self.faults) for run in self.runs]

    @property
    def gains(self) -> FloatArray:
        """Gain of each run (R,) [N m/rad]."""
        return np.array([gain for gain, _ in self.fits])

    @property
    def shares(self) -> FloatArray:
        """Mean square residual of each run (R,) over that of its input."""
        return np.array([share for _, share in self.fits])

    @property
    def share(self) -> float:
        """The residual of all runs together as a share of their input, as rms values."""
        spans = np.array([run.span for run in self.runs])
        return float(np.sqrt(np.sum(spans * self.shares) / np.sum(spans)))

    @property
    def deviance(self) -> float:
        """-2 log likelihood up to a constant."""
        counts = np.array([run.used.sum() for run in self.runs])
        return float(np.sum(counts * np.log(self.shares + FLOOR**2)))


def corrected(run: LawRun, faults: Found) -> LawRun:
    """The run without the faults."""
    for fault, size in faults:
        run = fault.correct(run, size)
    return run


def _regressed(run: LawRun, faults: Found) -> tuple[float, float]:
    last = corrected(run, faults)
    given, error = last.input[run.used], last.error[run.used]
    error, given = error - error.mean(), given - given.mean()
    span = float(given @ given)
    if not (np.isfinite(error).all() and span > 0.0 and error @ error > 0.0):
        return 0.0, 1.0
    gain = float(error @ given) / float(error @ error)
    return gain, max(1.0 - gain * float(error @ given) / span, 0.0)


def fitted(runs: Sequence[LawRun], known: Found, fault: LawFault) -> LawFit:
    """The law with the `known` faults and the likeliest sizes of one more."""
    from scipy.optimize import minimize

    scale = max(float(np.abs(run.input).max()) for run in runs) ** -2 if fault.by_input else 1.0
    tried = []

    def at(size: FloatArray) -> LawFit:
        return LawFit(tuple(runs), (*known, (fault, np.clip(size, fault.low, fault.most) * scale)))

    def deviance(size: FloatArray) -> float:
        return at(size).deviance

    for start in fault.starts:
        begin = np.array(start)
        simplex = np.vstack([begin, *(begin + 0.5 * abs(begin[k]) * np.eye(begin.size)[k] for k in range(begin.size))])
        settings: dict[str, Any] = {"method": "Nelder-Mead", "options": {
            "initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-3, "maxiter": 80}}
        found = minimize(deviance, begin, **settings)
        tried.append(at(found.x))
    return min(tried, key=lambda one: one.deviance)


def blocks(runs: Sequence[LawRun]) -> list[tuple[int, slice]]:
    """Number of the run, and samples, of each block of about BLOCK_S: errors further apart count as independent."""
    found = []
    for k, run in enumerate(runs):
        count = max(1, round(len(run.input) / (BLOCK_S * run.rate_hz)))
        edges = np.linspace(0, len(run.input), count + 1).astype(int)
        found += [(k, slice(int(a), int(b))) for a, b in pairwise(edges) if run.used[a:b].any()]
    return found


def error_of(fit: LawFit) -> tuple[FloatArray, int]:
    """(k,) standard deviation of the last fault's sizes by leaving out each block (jackknife, Tukey 1958), and the
    number of blocks."""
    fault, whole = fit.faults[-1]
    left = blocks(fit.runs)
    if len(left) < LEAST_BLOCKS:
        return np.full(whole.shape, np.inf), len(left)
    largest = max(float(np.abs(run.input).max()) for run in fit.runs)
    near = replace(fault, starts=(tuple(whole * largest**2 if fault.by_input else whole),))
    each = np.array([fitted(_without(fit.runs, *one), fit.faults[:-1], near).faults[-1][1] for one in left])
    squares = np.sum((each - each.mean(axis=0)) ** 2, axis=0)
    return np.sqrt((len(left) - 1) / len(left) * squares), len(left)


def _without(runs: Sequence[LawRun], which: int, where: slice) -> list[LawRun]:
    used = runs[which].used.copy()
    used[where] = False
    less = [replace(run, used=used) if k == which else run for k, run in enumerate(runs)]
    return [run for run in less if run.used.any()]


def p_value(size: FloatArray, std: FloatArray, freedom: int, tried: int) -> float:
    """Probability by chance of the size that is furthest from zero, by Student's t, with so many effects tried."""
    t = float(np.max(np.abs(size) / np.maximum(std, 1e-12)))
    return float(min(1.0, 2.0 * stdtr(max(freedom, 1), -t) * tried * size.size))
