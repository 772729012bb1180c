"""Zeros of encoders: where a joint that hangs reads another angle than 0, in all runs or in each another.

A wrong zero adds d(Z beta)/dq times the zero to the torque of each run. Least squares of (28) estimates zeros and beta
together; the zeros are subtracted before any fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import Dataset, FloatArray
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.fitting import design_rows, free_mask, weighted_least_squares
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import SignalSet, angle_column, differentiate, lowpass, split_signals

SLOW_HZ = 3.0
"""Most of a cutoff: gravity's torque is as slow as the motion. (Measured on two arms: the same zeros with 1 to 10 Hz,
on grids of 25 to 200 Hz, within 10 mrad; none with 30 Hz, where accelerations are noise.)"""
STEPS = 10
CONVERGED_RAD = 1e-4
"""Zeros are found when a step moves none by more."""
PROBE_RAD = 1e-4
"""Angle over which (Z beta) is differenced."""
ALPHA = 1e-3
"""p-value of a joint, times the joints asked, below which its zeros differ."""
LEAST_FALL = 0.1
"""Least share of a joint's torque residual that they then take away. (Measured: p from 3e-7 to 1e-5 and 41 to 50 %
on two real arms; p < 1e-3 on 2 of 104 legs with other faults, with 2 % at most.)"""
FEWEST_RUNS = 4
"""Of two or three, the halves agree by chance too often."""
SHOWN_RAD, SURE_STD = 0.01, 5.0
"""Gravity shows a zero whose standard deviation is below the first. What runs have in common is taken off where it
exceeds so many standard deviations."""
PARTS, AGREE = 4, 2.0
"""Parts of the runs, and the multiple of its largest departure in one of them that it exceeds, too."""
WRONG_RAD = 0.015
"""A zero is taken off though nobody asked if it is beyond five times what one that is set by hand may be off."""


@dataclass(frozen=True)
class Zeros:
    """Zero of each encoder in each run: reading less angle."""

    joints: tuple[int, ...]
    """0-based"""
    values: FloatArray
    """(runs, joints) [rad, or m on a slide]"""
    std: FloatArray
    """(runs, joints), white noise of the filtered equations taken for granted"""


@dataclass(frozen=True)
class Differing:
    """Evidence that encoders' zeros differ from run to run, for each joint whose zero does."""

    joints: tuple[int, ...]
    """0-based"""
    spread: FloatArray
    """(joints,) standard deviation between the runs [rad, or m on a slide]"""
    p_value: FloatArray
    """(joints,) probability that the halves of a run agree so much better than the runs if no zero differs"""
    left: FloatArray
    """(n,) torque residual of least squares without the zeros over that with them"""


def find_differing(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> Differing | None:
    """Joints whose zeros differ from run to run; None where nothing says so, or too few runs could.

    Each run's halves have zeros of their own. If these scatter as much within runs as between them, they are but what
    the model gets wrong; an analysis of variance tells.
    """
    joints = list(options.encoders_of(mechanism.n))
    if len(datasets) < FEWEST_RUNS or not joints:
        return None
    from scipy.special import fdtrc

    try:
        found = find_zeros(_parts(datasets, 2), mechanism, options, joints).values.reshape(len(datasets), 2, -1)
        between = 2.0 * np.var(found.mean(axis=1), axis=0, ddof=1)
        within = 0.5 * np.mean((found[:, 1] - found[:, 0]) ** 2, axis=0)
        p = fdtrc(len(datasets) - 1, len(datasets), between / np.maximum(within, 1e-300))
        there = p * len(joints) <= ALPHA
        if not there.any():
            return None
        differ = [j for j, one in zip(joints, there) if one]
        left = _left(datasets, mechanism, options, find_zeros(datasets, mechanism, options, differ))
    except FIT_ERRORS:
        return None
    if left.min() > 1.0 - LEAST_FALL:
        return None
    return Differing(tuple(differ), np.std(found.mean(axis=1)[:, there], axis=0, ddof=1), p[there], left)


def find_hanging(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, joints: Sequence[int]
                 ) -> Zeros | None:
    """Zeros of `joints` in each run, with what all runs have in common where all parts of them agree on that; None
    where gravity does not show it."""
    try:
        whole, parts = (find_zeros(runs, mechanism, options, joints, common=True)
                        for runs in (datasets, _parts(datasets, PARTS)))
    except (*FIT_ERRORS, ValueError):
        return None
    if whole.std.max() >= SHOWN_RAD:
        return None
    mean = whole.values.mean(axis=0)
    apart = np.abs(parts.values.reshape(len(datasets), PARTS, -1).mean(axis=0) - mean).max(axis=0)
    sure = np.abs(mean) > np.maximum(SURE_STD * whole.std.max(axis=0), AGREE * apart)
    own, common = (replace(whole, values=np.broadcast_to(x, whole.values.shape))
                   for x in (whole.values - mean, np.where(sure, mean, 0.0)))
    # a constant torque, estimated with it, may have its effect: then the zero alone makes a fit worse
    worse = _left(subtract(datasets, mechanism, own), mechanism, options, common).max() > 1.0 + LEAST_FALL
    return own if worse else replace(whole, values=own.values + common.values)


def find_wrong(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions
               ) -> tuple[Zeros, FloatArray] | None:
    """Zeros of the joints that hang elsewhere than at 0, and the torque residual (n,) less these over that with them;
    None for none."""
    joints = list(options.encoders_of(mechanism.n))
    zeros = find_hanging(datasets, mechanism, options, joints) if joints else None
    wrong = [] if zeros is None else [j for j, zero in zip(joints, zeros.values.mean(axis=0)) if abs(zero) > WRONG_RAD]
    zeros = find_hanging(datasets, mechanism, options, wrong) if wrong else None
    if zeros is None:
        return None
    left = _left(datasets, mechanism, options, zeros)
    return (zeros, left) if left.min() < 1.0 - LEAST_FALL else None


def _parts(datasets: Sequence[Dataset], count: int) -> list[Dataset]:
    """Each run in so many parts."""
    return [data.part(slice(k * len(data) // count, (k + 1) * len(data) // count)) for data in datasets
            for k in range(count)]


def _left(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, zeros: Zeros) -> FloatArray:
    """(n,) torque residual of slow least squares less the zeros, over that with them."""
    before, after = (_residual_rms(runs, mechanism, options)
                     for runs in (datasets, subtract(datasets, mechanism, zeros)))
    return np.asarray(after / np.maximum(before, 1e-300))


def differing_text(differing: Differing, unit: str = "rad") -> str:
    """One sentence: what differs, how sure that is, what to declare; `unit` is the joints'."""
    joints = ", ".join(f"joint {j + 1} by {spread:.2g} {unit} (p = {p:.1g})"
                       for j, spread, p in zip(differing.joints, differing.spread, differing.p_value))
    shares = " and ".join(f"{100 * share:.0f} %" for share in differing.left)
    declared = ", ".join(str(j + 1) for j in differing.joints)
    return (f"the encoders' zeros differ from run to run, {joints} by the two halves of each run; without them least "
            f"squares leaves {shares} of the torque that it leaves with them: declare encoder_zero = [{declared}] "
            "under [terms], and what else is missing shows better")


def _slow(options: FitOptions, rate_hz: float) -> FitOptions:
    """`options` with a cutoff at which zeros are sought."""
    return replace(options, cutoff_hz=min(SLOW_HZ, options.cutoff(rate_hz)))


def _residual_rms(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FloatArray:
    """(n,) rms torque residual of slow least squares at each joint."""
    slow = _slow(options, datasets[0].rate_hz)
    design = design_rows(split_signals(datasets, mechanism, slow), mechanism, slow)
    free, beta = free_mask(mechanism, slow)
    beta, _, _ = weighted_least_squares(design.z, design.torque, free, beta, design.samples_per_dof)
    left: FloatArray = np.sqrt(np.mean((design.torque - design.z @ beta) ** 2, axis=0))
    return left


def find_zeros(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, joints: Sequence[int],
               beta: FloatArray | None = None, common: bool = False) -> Zeros:
    """Zeros of `joints` in each run: for a known `beta` (p,), or together with beta and with mean zero over the runs.

    What is `common` to all runs may have the same effect as a constant in a driven joint's torque, which is then
    estimated, too: the standard deviations say whether gravity tells them apart. Raises
    `FitError` where a joint has no encoder on this path, or where the search does not converge.
    """
    runs = [split_signals([data], mechanism, options) for data in datasets]
    options = _slow(options, runs[0][0].rate_hz)
    for j in joints:
        if not np.isfinite(runs[0][0].angles[:, j]).all():
            raise FitError(f"encoder_zero names joint {j + 1}, which has no encoder on the {options.sensors} path")
    count, width = len(runs), len(joints)
    free, start = free_mask(mechanism, options)
    if beta is not None:
        free, start = np.zeros_like(free), beta
    # orthonormal columns of sum zero
    spread = np.eye(count) if common or beta is not None else np.linalg.qr(np.eye(count) - 1.0 / count)[0][:, :-1]
    values = np.zeros((count, width))
    if not spread.size:  # one run says nothing of a difference between runs
        return Zeros(tuple(joints), values, values)
    per_dof = max(1.0, 0.5 * runs[0][0].rate_hz / options.cutoff(runs[0][0].rate_hz))
    known, parts = start, width * spread.shape[1]
    for step in range(STEPS):
        equations = [_equations(run, mechanism, options, known, joints, zero, own, common)
                     for run, zero, own in zip(runs, values, spread)]
        sought = step > 0 or beta is not None  # before beta is known, (Z beta) has no slope
        constants = equations[0][0].shape[2] - start.size - parts
        mask = np.concatenate([free, np.full(parts, sought), np.ones(constants, bool)])
        found, covariance, _ = weighted_least_squares(np.concatenate([z for z, _ in equations]),
                                                      np.concatenate([tau for _, tau in equations]), mask,
                                                      np.append(start, np.zeros(parts + constants)), per_dof)
        known = found[: start.size]
        change = spread @ found[start.size : start.size + parts].reshape(width, -1).T
        values = values + change
        if sought and np.max(np.abs(change)) < CONVERGED_RAD:
            inner = slice(start.size, start.size + parts)
            own = covariance[inner, inner].reshape(width, spread.shape[1], width, -1)
            std = np.sqrt(np.einsum("rk,jkjl,rl->rj", spread, own, spread))
            if not std.all():  # directions that no equation knows of have neither step nor variance
                break
            return Zeros(tuple(joints), values, std)
    raise FitError("the encoders' zeros are not to be found: the motion does not show them, or the model is far off")


def subtract(datasets: Sequence[Dataset], mechanism: Mechanism, zeros: Zeros) -> tuple[Dataset, ...]:
    """The runs with their zeros taken off, of angles and of their commands."""
    out = []
    for data, own in zip(datasets, zeros.values):
        moved = {name: data[name] - zero for j, zero in zip(zeros.joints, own)
                 for name in (angle_column(mechanism, j), f"q{j + 1}_cmd_rad") if name in data}
        out.append(replace(data, columns={**data.columns, **moved}))
    return tuple(out)


def zeros_text(datasets: Sequence[Dataset], zeros: Zeros) -> str:
    """One sentence: what was taken off, by joint and run."""
    tables = [f"joint {j + 1}: " + ", ".join(f"{data.name} {1e3 * value:.1f} +- {1e3 * std:.1f}"
                                             for data, value, std in zip(datasets, own, spread))
              for j, own, spread in zip(zeros.joints, zeros.values.T, zeros.std.T)]
    every = ", another in every run," if len(datasets) > 1 else ""
    return f"encoders' zeros{every} are taken off [1e-3 rad or m]; {'; '.join(tables)}"


def _equations(run: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions, beta: FloatArray,
               joints: Sequence[int], zero: FloatArray, own: FloatArray, common: bool) -> tuple[FloatArray, FloatArray]:
    """Filtered [Z, -d(Z beta)/dq own] (m, n, p + joints * k) and torque (m, n) of one run less its `zero`.

    A zero in excess by o makes the true angle the reading less o; `own` (k,) are the weights in it of what is sought.
    Of what is `common` to runs, columns of constant torques of the driven joints follow.
    """
    offsets = [j for j in mechanism.actuated if common and f"torque_offset_{j + 1}" not in mechanism.names]
    left, right = [], []
    for s in run:
        angles = s.angles.copy()
        angles[:, list(joints)] -= zero
        cutoff = options.cutoff(s.rate_hz)
        motion = differentiate(replace(s, angles=angles), mechanism, min(4.0 * cutoff, 0.4 * s.rate_hz),
                               options.filter_order)
        columns = [mechanism.regressor(*motion)]
        for j in joints:
            step = PROBE_RAD * np.eye(mechanism.n)[j]
            up, down = (mechanism.regressor(motion.q + way * step, motion.qd, motion.qdd) @ beta for way in (1.0, -1.0))
            columns.append((down - up)[:, :, None] / (2.0 * PROBE_RAD) * own)
        columns.append(np.broadcast_to(np.eye(mechanism.n)[:, offsets], (len(angles), mechanism.n, len(offsets))))
        edge = min(len(angles) // 10, int(0.5 * s.rate_hz / cutoff))
        inner = slice(edge, len(angles) - edge)
        left.append(lowpass(np.concatenate(columns, axis=2), cutoff, s.rate_hz, options.filter_order)[inner])
        right.append(lowpass(s.torque, cutoff, s.rate_hz, options.filter_order)[inner])
    return np.concatenate(left), np.concatenate(right)
