"""`with_second_opinion`: an `mle` fit held against multiple shooting, and what happens where both disagree.

`mle` takes what a model lacks for white noise of torque and angles. Under coloured errors, or with a declared encoder
noise that is too small, its inertias shrink. Output error over a second (`shooting`) fails differently. Both estimates
use the same data, so their errors depend on each other in a way that nobody knows once the model is wrong; the unit of
their difference is therefore the one of independent errors,

    d_k = |beta_k(mle) - beta_k(shooting)| / sqrt(h_k(mle)^2 + h_k(shooting)^2),    h half of a 95 % interval

which is too large rather than too small (where `mle` is right and efficient the variance of the difference is that of
shooting less that of `mle`: Hausman, Econometrica 46, 1978). Above `MOST_DISAGREEMENT` held-out data decide: both
methods are fitted to one half and predict the other half a second ahead, from states by filtered differences, of no
model. Where that leaves it open, or the gain is below `LEAST_GAIN`, `mle` stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daq import BoolArray, Dataset
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.fitting.admissibility import faults
from estimator.fitting.fit import estimate
from estimator.fitting.identifiability import undetermined
from estimator.fitting.second_ahead import errors_ahead
from estimator.fitting.shooting import ENOUGH_RUNS, SEGMENT_S, Shot, shoot
from estimator.fitting.tolerances import with_tolerances_of, without_tolerances
from estimator.fitting.wls import design_rows, free_mask, weighted_least_squares
from estimator.free_runs import SHORT_S, FittedModel, log_ratio, measured_use
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import MOST_DISAGREEMENT, Combination, Finding, FitResult, HeldOut, SecondOpinion
from estimator.signals import split_signals

LEAST_GAIN = 0.01
"""Share of the held-out error by which shooting must be better at least. In an hour of data a thousandth is
significant, and of two estimates that predict alike it says nothing about which is nearer to the truth."""
RUNS_APART = 4
"""From so many runs on, a half has whole runs; of fewer runs, it has blocks of each."""
BLOCKS = 4
"""Blocks of a run then, of which every other one belongs to a half."""
LEAST_BLOCK_S = 3.0
"""Least length of a block."""
LEAST_SEGMENTS = 6
"""Predicted seconds below which nothing is decided."""


def with_second_opinion(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, result: FitResult
                        ) -> FitResult:
    """`result` of an `mle` on these with a second opinion; of shooting where that predicts held-out data better.

    Unchanged where the fit is by another method or has a prior, did not converge, or where shooting comes to no end.
    """
    if result.method != "mle" or not result.converged or not result.trajectories or options.prior:
        return result
    options = replace(options, hold=result.hold, smoothing_velocity="given",
                      fixed={**options.fixed, **dict.fromkeys(result.at_bound, 0.0)})
    shot = _shoot(datasets, result.mechanism, options, result)
    if shot is None:
        return result
    free, _ = free_mask(mechanism, options)
    opinion = _compared(result, shot, free)
    if opinion.largest <= MOST_DISAGREEMENT:
        return replace(result, second_opinion=opinion)
    found = result.mechanism
    if found.velocity_scale != mechanism.velocity_scale:  # which a fit that is wrong may have found wrongly
        stated = _shoot(datasets, mechanism, options, result)
        if stated is not None and stated.loss < shot.loss:
            shot, found = stated, mechanism
            opinion = _compared(result, shot, free)
    mechanism = found
    opinion = replace(opinion, held_out=_held_out(datasets, mechanism, options))
    if opinion.held_out is None or opinion.held_out.ci95[0] <= LEAST_GAIN:
        return replace(result, second_opinion=opinion)
    try:
        reported = _of_shooting(datasets, mechanism, options, result, shot)
    except FitError:  # no motion under its parameters
        return replace(result, second_opinion=opinion)
    other = replace(opinion, method="mle", beta=result.beta, half_width=result.half_width)
    return replace(reported, second_opinion=other)


def _shoot(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, result: FitResult) -> Shot | None:
    """`shoot_from`; None where it comes to no end."""
    try:
        return shoot_from(datasets, mechanism, options, result)
    except FIT_ERRORS:
        return None


def _compared(result: FitResult, shot: Shot, free: BoolArray) -> SecondOpinion:
    """Comparison of `shot` with `result`, without parameters that either leaves open."""
    mechanism = result.mechanism
    open_ = result.open_parameters | _named(undetermined(mechanism, shot.beta, shot.covariance, free))
    compared = free & np.array([name not in open_ for name in mechanism.names])
    both = np.hypot(result.shown_half_width, shot.half_width)
    likeliest, _ = without_tolerances(result)  # shooting knows of no tolerances either
    apart = np.where(compared, np.abs(likeliest - shot.beta) / np.maximum(both, 1e-300), np.nan)
    return SecondOpinion("shooting", shot.beta, shot.half_width, apart)


def _named(combinations: Sequence[Combination]) -> set[str]:
    """Parameters that take part in what is undetermined."""
    return {name for found in combinations for name, _ in found.amounts}


def shoot_from(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, result: FitResult) -> Shot:
    """Shooting from where an `mle` on the same data ended, or from least squares where that leads nowhere."""
    signals = split_signals(datasets, mechanism, options)
    free, known = free_mask(mechanism, options)
    design = design_rows(signals, mechanism, options)
    slow, _, _ = weighted_least_squares(design.z, design.torque, free, known, design.samples_per_dof)
    q, v = (np.concatenate(parts) for parts in zip(*((t.q, t.qd) for t in result.trajectories), strict=True))
    return shoot(signals, mechanism, result.hold, free, (np.where(free, result.beta, known), slow), q, v)


def _of_shooting(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, result: FitResult, shot: Shot
                 ) -> FitResult:
    """`result` with the estimate of shooting, and the likeliest motion under that."""
    held = dict(zip(mechanism.names, map(float, shot.beta), strict=True))
    free, _ = free_mask(mechanism, options)
    motion = estimate(datasets, mechanism, replace(options, fixed=held), "mle")
    missing = undetermined(mechanism, shot.beta, shot.covariance, free)
    std = np.where([name in _named(missing) for name in mechanism.names], np.inf, np.sqrt(np.diag(shot.covariance)))
    q = np.concatenate([t.q for t in motion.trajectories])
    covariance, budget = with_tolerances_of(result.budget, shot.spread)
    return replace(
        motion, method="shooting", beta=shot.beta, covariance=covariance, budget=budget, iterations=shot.iterations,
        fixed=result.fixed, at_bound=result.at_bound, hold_margin=result.hold_margin, converged=True,
        wall_s=result.wall_s, undetermined=missing, agreement=None,
        findings=(*(one for one in result.findings if one.role != "fault"), *(Finding("fault", "impossible", text)
                                      for text in faults(mechanism, shot.beta, std, q))),
        assumptions=(result.assumptions[0],
                     f"multiple shooting over {SEGMENT_S:g} s: errors of different segments, or of different runs where"
                     f" there are {ENOUGH_RUNS} or more, are independent; within one they may have any colour",
                     "the measured torque is taken as exact: its noise, integrated over a segment, is output error",
                     *result.assumptions[3:]))


def _held_out(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> HeldOut | None:
    """Gain of shooting over `mle` on data that they were not fitted to; None where there is too little."""
    parts = list(datasets) if len(datasets) >= RUNS_APART else [part for data in datasets for part in _blocks(data)]
    errors = []
    for train, test in ((parts[::2], parts[1::2]), (parts[1::2], parts[::2])):
        try:
            first = estimate(train, mechanism, options, "mle")
            second = shoot_from(train, mechanism, options, first)
            held_out = split_signals(test, mechanism, options)
            models = [FittedModel(mechanism, options.hold, one.beta) for one in (first, second)]
            errors.append(errors_ahead(held_out, models, options))
        except FIT_ERRORS:
            return None
    error = np.concatenate(errors, axis=1)
    if error.shape[1] < LEAST_SEGMENTS:
        return None
    ratio, half = log_ratio(error)
    count = error.shape[1]
    return HeldOut(1.0 - math.exp(ratio), (1.0 - math.exp(ratio + half), 1.0 - math.exp(ratio - half)), count,
                   measured_use("simulation", error[1], np.ones(count), np.zeros(count, int), SHORT_S))


def _blocks(data: Dataset) -> list[Dataset]:
    edges = np.linspace(0, len(data), BLOCKS + 1).astype(int)
    parts = [data.part(slice(int(a), int(b))) for a, b in pairwise(edges)]
    return [replace(part, name=f"{data.name}, part {k + 1}") for k, part in enumerate(parts)
            if len(part) >= LEAST_BLOCK_S * data.rate_hz]
