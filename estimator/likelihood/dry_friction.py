"""What dry friction leaves open near rest, and over which speed its sign is rounded off: the likeliest.

The model says F s(qd), s a rounded sign. A joint at rest holds any torque up to its Coulomb level F; near rest real
joints creep, wind up and let go over speeds that no rig file states. The difference, at most F (1 - |s|) with s rounded
REST_SPREAD times as widely, counts as noise of the torque there. What friction does while a joint passes through rest
is one draw, however many samples see it, so the variance of each is multiplied by their number.

The speed of rounding is found as noise levels are, by expectation and maximisation (Dempster, Laird and Rubin 1977):
given the torque's residual and what is uncertain of it, the speed for which both are likeliest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.model import smooth_sign

REST_SPREAD = 5.0
"""Speeds below about this many times the rounding of sign(qd) may be rest: the estimated speed of a joint that
sticks is not zero but what its sensors' noise makes it."""
RATIOS = np.array([1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0, 45.0, 64.0])
"""Speeds of rounding that are compared, in that which a mechanism states: a joint is never taken for sharper."""
REJECTED = 3.84
"""Twice the log-likelihood that a speed must lie below the best to be too sharp for the data: chi-squared with one
degree of freedom, 95 %."""
MOST_SAMPLES = 20_000
"""Samples, evenly taken, by which they are compared."""


def held_variance(v: FloatArray, level: float, scale: float) -> FloatArray:
    """(N,) variance [N^2 m^2] of the torque that friction of `level` [N m] may hold at rates v (N,), its sign rounded
    off over `scale` [rad/s]."""
    return np.asarray((level * (1.0 - np.abs(smooth_sign(v, REST_SPREAD * scale)))) ** 2)


def crossing_samples(v: FloatArray, scale: float, ends: NDArray[np.int64]) -> FloatArray:
    """(N,) samples of the passage through rest that each of v (N,) belongs to; 1 beside them.

    `ends` are those of the stretches that v consists of.
    """
    inside = np.abs(v) < REST_SPREAD * scale
    size = np.diff(_passages(inside, ends))
    return np.where(inside, np.repeat(size, size), 1).astype(float)


def draw_held(v: FloatArray, level: float, scale: float, ends: NDArray[np.int64], rng: np.random.Generator
              ) -> FloatArray:
    """(N,) torque [N m] that friction of `level` may hold at rates v (N,), with `held_variance`: one draw a
    passage through rest."""
    bounds = _passages(np.abs(v) < REST_SPREAD * scale, ends)
    share = np.repeat(rng.normal(size=bounds.size - 1), np.diff(bounds))
    return np.asarray(share * np.sqrt(held_variance(v, level, scale)))


def _passages(inside: NDArray[np.bool_], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bounds of the passages through rest, where `inside` (N,), and of what lies between them."""
    change = np.flatnonzero(np.diff(inside)) + 1
    return np.unique(np.concatenate([[0], change, ends]))


def likeliest_smoothing(v: FloatArray, level: float, stated: float, now: float, sigma: float, residual: FloatArray,
                    spread: FloatArray) -> float:
    """Least speed [rad/s], of RATIOS times the one `stated`, that fits one joint's friction about as well as any.

    `residual` (N,) is that of its torque with the sign rounded over `now`, `spread` (N,) its variance by the latents,
    `sigma` the torque's noise, all [N m].
    """
    every = slice(None, None, max(1, v.size // MOST_SAMPLES))
    v, residual, spread = v[every], residual[every], spread[every]
    before = smooth_sign(v, now)

    def unlikely(scale: float) -> float:
        variance = sigma**2 + held_variance(v, level, scale)
        r = residual + level * (smooth_sign(v, scale) - before)
        return float(np.sum(np.log(variance) + (r * r + spread) / variance))

    tried = [float(f"{stated * ratio:.3g}") for ratio in RATIOS]
    found = np.array([unlikely(scale) for scale in tried])
    return tried[int(np.argmax(found < found.min() + REJECTED))]
