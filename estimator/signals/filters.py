"""Zero-phase low-pass filtering and central differences (eqs. (19), (34)-(39), (60)-(61) of the paper)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.numerics import compile_kernel

SLOW_SHARE = 0.12
"""Of the rate: what is slower can be moved by parts of a sample, for a spline between samples changes nothing of it."""
WHOLE = 1e-9
"""Parts of a sample that are none: seconds times a rate are seldom whole numbers."""


@cache
def _sections(order: int, share: float) -> FloatArray:
    """(sections, 5) b0, b1, b2, a1, a2 of a Butterworth low pass at this share of the Nyquist rate, each of gain 1.

    By the bilinear transform of its poles, pair by pair. SciPy has all this, but a quarter of a second to import it is
    longer than most fits take.
    """
    k = np.tan(0.5 * np.pi * share)
    angles = np.pi * (2 * np.arange(order // 2) + 1) / (2 * order)
    rows = []
    for damping in 2.0 * np.sin(angles):
        a0, gain = 1.0 + damping * k + k * k, k * k / (1.0 + damping * k + k * k)
        rows.append([gain, 2.0 * gain, gain, 2.0 * (k * k - 1.0) / a0, (1.0 - damping * k + k * k) / a0])
    if order % 2:
        rows.append([k / (1.0 + k), k / (1.0 + k), 0.0, (k - 1.0) / (k + 1.0), 0.0])
    return np.array(rows)


@cache
def _pass() -> Callable[..., None]:
    """The kernel that filters rows y (c, n) by sections (s, 5) in place, from rest."""

    def run(y: Any, sections: Any) -> None:
        for i in range(y.shape[0]):
            for s in range(sections.shape[0]):
                b0, b1, b2, a1, a2 = (sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3], sections[s, 4])
                first, second = 0.0, 0.0
                for k in range(y.shape[1]):
                    x = y[i, k]
                    out = b0 * x + first
                    first = b1 * x - a1 * out + second
                    second = b2 * x - a2 * out
                    y[i, k] = out

    return compile_kernel(run, "f2 f2", exact=True)


def lowpass(x: FloatArray, cutoff_hz: float | None, rate_hz: float, order: int = 4) -> FloatArray:
    """Forward-backward Butterworth along axis 0; x (n, ...). `cutoff_hz` is where each pass has -3 dB.

    No cutoff, or one at or above 0.95 of the Nyquist rate, leaves x as it is. The ends are continued by odd
    reflection, as SciPy's `sosfiltfilt` does. Columns that are zero, such as half of a regressor's, are passed over.
    """
    if cutoff_hz is None or cutoff_hz >= 0.475 * rate_hz:
        return x
    sections = _sections(order, 2.0 * cutoff_hz / rate_hz)
    pad = min(x.shape[0] - 1, int(3 * rate_hz / cutoff_hz))
    flat = x.reshape(x.shape[0], -1).T
    live = flat.any(axis=1)
    y = flat[live]
    y = np.concatenate([2.0 * y[:, :1] - y[:, pad:0:-1], y, 2.0 * y[:, -1:] - y[:, -2:-pad - 2:-1]], axis=1)
    for _ in range(2):  # forward, then backward, each with steady state at its first value
        start = y[:, :1].copy()
        y -= start
        _pass()(y, sections)
        y = np.ascontiguousarray((y + start)[:, ::-1])
    out = np.zeros(flat.shape)
    out[live] = y[:, pad : pad + x.shape[0]]
    return out.T.reshape(x.shape)


def slow_part(x: FloatArray, rate_hz: float) -> FloatArray:
    """Part of x (n, ...) that is slow enough to be moved by parts of a sample."""
    return lowpass(x, SLOW_SHARE * rate_hz, rate_hz)


def shifted(x: FloatArray, samples: float) -> FloatArray:
    """x (n,) so many samples later, by a cubic spline; its ends are held."""
    from scipy.ndimage import shift

    return np.asarray(shift(x, samples, order=3, mode="nearest"), dtype=np.float64)


def added_by_delay(x: FloatArray, slow: FloatArray, samples: float, fast_samples: float | None = None) -> FloatArray:
    """(n,) x so many samples later, less x (n,); the ends of x are held.

    Its `slow_part` moves by parts of a sample. What is fast, noise and a controller's steps, moves by the whole samples
    in `fast_samples`, by default in `samples`: noise that falls between samples is averaged, and an estimate of a delay
    would be drawn to half a sample for it.
    """
    late = samples if fast_samples is None else fast_samples
    whole, fast = np.trunc(late + np.copysign(WHOLE, late)), x - slow
    return shifted(slow, samples) - slow + (shifted(fast, whole) - fast if whole else 0.0)


def causal(x: FloatArray, numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """x (n,) through numerator / denominator, polynomials in 1/z of at most second order, from rest.

    SciPy's `lfilter` does the same, but its import takes 0.4 s.
    """
    b, a = (np.pad(part, (0, 3 - len(part))) / denominator[0] for part in (numerator, denominator))
    y = np.array(x, dtype=np.float64)[None]
    _pass()(y, np.array([[*b, *a[1:]]]))
    return y[0]


def central_difference(x: FloatArray, dt_s: float, spacing: int = 1) -> FloatArray:
    """(x[k+m] - x[k-m]) / (2 m dt) along axis 0, eq. (60); one-sided differences within m of the ends."""
    m = spacing
    if x.shape[0] <= 2 * m:
        return np.gradient(x, dt_s, axis=0)
    out = np.empty_like(x)
    out[m:-m] = (x[2 * m:] - x[: -2 * m]) / (2 * m * dt_s)
    edge = np.gradient(x, dt_s, axis=0, edge_order=2)
    out[:m], out[-m:] = edge[:m], edge[-m:]
    return out


def white_noise_level(x: FloatArray) -> float:
    """Standard deviation of white noise on a smooth signal x (n,), from its third differences.

    Robust: a third difference of white noise has variance 20 sigma^2; the median absolute deviation
    is taken so that a few jumps do not count.
    """
    d = np.diff(x, n=3)
    if d.size == 0:
        return 0.0
    return float(1.4826 * np.median(np.abs(d - np.median(d))) / np.sqrt(20.0))


def encoder_level(angle: FloatArray) -> float:
    """Noise level of an encoder by differences between neighbours: its quantum, or white noise."""
    return max(white_noise_level(angle), quantum(angle) / np.sqrt(12.0))


def quantum(x: FloatArray) -> float:
    """Grid step of a quantised signal x (n,), 0 where the samples show no grid.

    The smallest step between distinct values is a quantum if all steps are whole multiples of it. Values that differ by
    less than 1e-9 of the largest are one.
    """
    values = np.unique(x)
    steps, biggest = np.diff(values), float(np.max(np.abs(values), initial=0.0))
    steps = steps[steps > 1e-9 * biggest]  # a file's digits, and what fades out towards zero, are no steps
    if steps.size < 3:
        return 0.0
    smallest = float(np.min(steps))
    small = steps[steps < 50.0 * smallest]
    ratio = small / smallest
    tolerance = 1e-9 * biggest / smallest + 0.02
    if tolerance < 0.2 and small.size >= 3 and float(np.max(np.abs(ratio - np.rint(ratio)))) < tolerance:
        return smallest
    return 0.0
