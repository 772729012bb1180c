"""`cut_steps`: a walker's record as segments of one mechanism, the leg that stands and the one that swings by role.

A record has its joints by leg: `q2_rad` and `tau2_nm` are the hip of leg 1, `q3_rad` and `tau3_nm` that of leg 2. The
mechanism has them by role (`biped3` with `hips`), so as leg 2 stands the two change places. Around each touchdown, when
nobody knows which leg carries the walker, samples are left out: a step is a segment between two gaps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from daq import Dataset, FloatArray
from estimator.errors import FitError
from estimator.signals.filters import white_noise_level
from estimator.signals.segments import STANCE

LEGS = 1, 2
SINCE = "since_touchdown_s"
"""Column that `cut_steps` adds: time since the last touchdown, NaN before the first."""
SMEARED = 1e-3
"""A stance this far from an integer was interpolated between legs, and so were the neighbouring angles."""
AROUND_S, FEWEST = 0.05, 6
"""Of a touchdown, and samples at least, over which angles are parabolas before and after it."""
SEEN = 6.0
"""Standard deviations that the rates' jump must have. (Measured at 200 Hz: 83 at the least of 20 touchdowns, 5.8 at the
most between them.)"""
LEAST_SHARE = 0.25
"""... and of the record's strongest."""
SIGMAS = 3.0
"""Of a touchdown that was found: samples nearer to it are left out."""


@dataclass(frozen=True)
class Touchdowns:
    """When feet landed, and which leg stood from then on."""

    time_s: FloatArray
    """(K,) increasing"""
    open_s: FloatArray
    """(K,) how far the true instant may be off."""
    leg: NDArray[np.int_]
    """(K,) 1 or 2"""


def cut_steps(data: Dataset, open_s: float = 0.0) -> tuple[Dataset, Touchdowns]:
    """`data` by role, without angles where no leg is known to stand, and its touchdowns: those of column `stance`,
    which may be off by `open_s`, or where there is none those that the angles show.

    Raises `FitError` where no touchdown can be told.
    """
    stance, found = stance_of(data, open_s) if STANCE in data else stance_found(data)
    away, swapped = ~np.isin(stance, LEGS), (np.searchsorted(found.time_s, data.time_s) + (found.leg[0] == 1)) % 2 == 1
    columns = dict(data.columns)
    for name in ("q{}_rad", "tau{}_nm"):
        first, second = name.format(2), name.format(3)
        if first in columns and second in columns:
            a, b = columns[first], columns[second]
            columns[first], columns[second] = np.where(swapped, b, a), np.where(swapped, a, b)
    columns |= {f"q{j}_rad": np.where(away, np.nan, columns[f"q{j}_rad"]) for j in (1, 2, 3)}
    last = np.searchsorted(found.time_s, data.time_s, side="right") - 1
    columns[STANCE] = np.where(swapped, 2.0, 1.0)
    columns[SINCE] = np.where(last < 0, np.nan, data.time_s - found.time_s[last])
    return replace(data, columns=columns), found


def stance_of(data: Dataset, open_s: float) -> tuple[FloatArray, Touchdowns]:
    """(N,) 1, 2 or NaN by the column, and its touchdowns."""
    given = data[STANCE].copy()
    whole = np.rint(given)
    given[~(np.abs(given - whole) < SMEARED)] = np.nan
    if not np.isin(whole[np.isfinite(given)], (0, *LEGS)).all():
        raise FitError(f"{data.name}: column {STANCE} holds other numbers than 0, 1 and 2; give the leg that is on the "
                       "ground, 0 where it is none or both")
    known = np.flatnonzero(np.isin(given, LEGS))
    legs = whole[known].astype(int)
    change = np.flatnonzero(np.diff(legs))
    if not change.size:
        raise FitError(f"{data.name}: column {STANCE} never changes from one leg to the other; take [walker] out of "
                       "the rig file for a single step, in the joints of docs/formats.md")
    before, after = data.time_s[known[change]], data.time_s[known[change + 1]]
    touchdowns = Touchdowns(0.5 * (before + after), 0.5 * (after - before) + open_s, legs[change + 1])
    return _stance(data, touchdowns, legs[0]), touchdowns


def stance_found(data: Dataset) -> tuple[FloatArray, Touchdowns]:
    """(N,) 1, 2 or NaN by the touchdowns that the angles show."""
    found = find_touchdowns(data)
    return _stance(data, found, 3 - int(found.leg[0])), found


def _stance(data: Dataset, touchdowns: Touchdowns, first: int) -> FloatArray:
    """(N,) leg by touchdowns; NaN within what they leave open, one sample at least, and where `stance` is NaN or 0."""
    time_s = data.time_s
    legs = np.concatenate([[first], touchdowns.leg])
    out: FloatArray = legs[np.searchsorted(touchdowns.time_s, time_s)].astype(float)
    slack = 1e-6 * data.dt_s
    for when, open_s in zip(touchdowns.time_s, touchdowns.open_s):
        out[np.abs(time_s - when) < open_s - slack] = np.nan
        out[min(int(np.searchsorted(time_s, when)), len(out) - 1)] = np.nan
    if STANCE in data:
        out[~np.isin(np.rint(data[STANCE]), LEGS) | ~(np.abs(data[STANCE] - np.rint(data[STANCE])) < SMEARED)] = np.nan
    return out


def find_touchdowns(data: Dataset) -> Touchdowns:
    """Instants at which a foot landed, from the jump in the rates of all joints.

    Around an instant t each angle is a curve whose slope and curvature jump at t. The t with the largest jump over its
    standard deviation is refined to the least residual. The walker moves towards growing angles, so the foremost leg
    carries it next. Raises `FitError` where no jump is significant, or where one leg lands twice in a row.
    """
    angles = np.stack([data[f"q{j}_rad"] for j in (1, 2, 3)])
    level = np.array([max(white_noise_level(x[np.isfinite(x)]), 1e-12) for x in angles])
    half = max(FEWEST, round(AROUND_S * data.rate_hz))
    if angles.shape[1] <= 2 * half:
        raise FitError(f"{data.name}: is too short to find touchdowns in; give a column {STANCE}")
    jump = np.linalg.pinv(_basis(half, 0.0))[3]
    strength = np.stack([np.correlate(x / s, jump, "valid") for x, s in zip(angles, level)])
    strength = np.nan_to_num(np.sqrt(np.sum(strength**2, axis=0)) / float(np.linalg.norm(jump)))
    peaks = [k for k in np.flatnonzero(strength > max(SEEN, LEAST_SHARE * float(strength.max())))
             if strength[k] == strength[max(0, k - half) : k + half + 1].max()]
    if not peaks:
        raise FitError(f"{data.name}: no touchdown stands out of the angles' noise; give a column {STANCE}")
    refined = [_refined(angles[:, k : k + 2 * half] / level[:, None], half) for k in peaks]
    time_s = np.array([data.time_s[k + half - 1] + (0.5 + at) * data.dt_s for k, (at, _) in zip(peaks, refined)])
    ahead = np.array([1 if angles[1, k + half] > angles[2, k + half] else 2 for k in peaks])
    twice = np.flatnonzero(np.diff(ahead) == 0)
    if twice.size:
        a, b = time_s[twice[0]], time_s[twice[0] + 1]
        raise FitError(f"{data.name}: leg {ahead[twice[0]]} seems to land at {a:.3f} s and again at {b:.3f} s, the "
                       f"other one not between; give a column {STANCE}")
    open_s = np.array([max(SIGMAS * std, 0.1) for _, std in refined]) * data.dt_s
    return Touchdowns(time_s, open_s, ahead)


def _basis(half: int, at: float) -> FloatArray:
    """(2 half, 5) parabola, and one more from `at` on [samples after the middle]."""
    i = np.arange(-half, half) + 0.5
    late = np.maximum(i - at, 0.0)
    return np.column_stack([np.ones_like(i), i, i * i, late, late * late])


@cache
def _curves(half: int) -> tuple[FloatArray, FloatArray]:
    """(81,) instants tried [samples after the middle], and (81, 2 half, 5) orthonormal bases of their curves."""
    tried = np.linspace(-2.0, 2.0, 81)
    return tried, np.linalg.qr(np.stack([_basis(half, at) for at in tried]))[0]


def _refined(angles: FloatArray, half: int) -> tuple[float, float]:
    """Instant of the jump in whitened angles (n, 2 half), in samples after the middle, and its standard deviation."""
    tried, bases = _curves(half)
    left = np.sum((angles.T - bases @ (bases.swapaxes(1, 2) @ angles.T)) ** 2, axis=(1, 2))
    k = min(max(int(np.argmin(left)), 4), len(tried) - 5)
    curve = np.polynomial.Polynomial.fit(tried[k - 4 : k + 5], left[k - 4 : k + 5], 2).convert().coef
    if curve[2] <= 0.0:
        return float(tried[k]), float(tried[-1])
    at = float(np.clip(-0.5 * curve[1] / curve[2], tried[k - 4], tried[k + 4]))
    return at, float(1.0 / np.sqrt(curve[2]))
