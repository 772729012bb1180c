"""Unknown friction torque near rest, and the maximum-likelihood friction smoothing velocity.

Friction law: F s(v), s = v / sqrt(v^2 + v_s^2), smoothing velocity v_s. At rest friction balances any torque up to F,
so near rest F (1 - |s|), with REST_SPREAD v_s in s, counts as torque noise. It has one value for each zero crossing of
the velocity, so the variance of its samples is multiplied by their number.

v_s is estimated like noise levels, by expectation and maximisation (Dempster, Laird and Rubin 1977), from the torque's
residual and its variance by the latents.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq import BoolArray, FloatArray
from estimator.model import smooth_sign

REST_SPREAD = 5.0
"""Speeds below about this multiple of the smoothing velocity may be rest: sensor noise moves the estimated speed."""
RATIOS = np.array([1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0, 45.0, 64.0])
"""Smoothing velocities that are compared, over the one that the mechanism states; none is smaller."""
REJECTED = 3.84
"""Twice the log-likelihood that a speed must lie below the best to be too sharp for the data: chi-squared with one
degree of freedom, 95 %."""
MOST_SAMPLES = 20_000
"""Samples, evenly taken, by which they are compared."""


def held_variance(v: FloatArray, level: float, scale: float) -> FloatArray:
    """(N,) variance [N^2 m^2] of the unknown friction torque at rates v (N,): (F (1 - |s|))^2.

    F is `level` [N m]; s has the smoothing velocity REST_SPREAD times `scale` [rad/s].
    """
    return np.asarray((level * (1.0 - np.abs(smooth_sign(v, REST_SPREAD * scale)))) ** 2)


def crossing_samples(v: FloatArray, scale: float, ends: NDArray[np.int64]) -> FloatArray:
    """(N,) number of samples of the zero crossing that each of v (N,) belongs to; 1 outside.

    `ends` are those of the segments that v consists of.
    """
    inside = np.abs(v) < REST_SPREAD * scale
    size = np.diff(_zero_crossings(inside, ends))
    return np.where(inside, np.repeat(size, size), 1).astype(float)


def draw_held(v: FloatArray, level: float, scale: float, ends: NDArray[np.int64], rng: np.random.Generator
              ) -> FloatArray:
    """(N,) random friction torque [N m] at rates v (N,), with `held_variance`: one draw for each zero crossing."""
    bounds = _zero_crossings(np.abs(v) < REST_SPREAD * scale, ends)
    share = np.repeat(rng.normal(size=bounds.size - 1), np.diff(bounds))
    return np.asarray(share * np.sqrt(held_variance(v, level, scale)))


def _zero_crossings(inside: BoolArray, ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bounds of the zero crossings, where `inside` (N,), and of the samples between them."""
    change = np.flatnonzero(np.diff(inside)) + 1
    return np.unique(np.concatenate([[0], change, ends]))


def likeliest_smoothing(v: FloatArray, level: float, stated: float, now: float, sigma: float, residual: FloatArray,
                    spread: FloatArray) -> float:
    """Smallest smoothing velocity [rad/s], of RATIOS times `stated`, about as likely as the best.

    `residual` (N,) is the joint's torque residual with smoothing velocity `now`, `spread` (N,) its variance by the
    latents, `sigma` the torque's noise, all [N m].
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
