"""Zero-phase low-pass filtering and central differences (eqs. (19), (34)-(39), (60)-(61) of the paper)."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from daq import FloatArray


@cache
def _sections(order: int, share: float) -> tuple[FloatArray, FloatArray]:
    """Second-order sections of a Butterworth low pass at this share of the Nyquist rate, and their state in a step."""
    sos = np.asarray(butter(order, share, output="sos"), dtype=np.float64)
    return sos, np.asarray(sosfilt_zi(sos), dtype=np.float64)[:, None]


def lowpass(x: FloatArray, cutoff_hz: float | None, rate_hz: float, order: int = 4) -> FloatArray:
    """Forward-backward Butterworth along axis 0; x (n, ...). `cutoff_hz` is where each pass has -3 dB.

    No cutoff, or one at or above 0.95 of the Nyquist rate, leaves x as it is. The ends are continued by odd
    reflection, as SciPy's `sosfiltfilt` does, which finds the filter's state anew each time. Columns that are zero,
    such as half of a regressor's, are passed over.
    """
    if cutoff_hz is None or cutoff_hz >= 0.475 * rate_hz:
        return x
    sos, state = _sections(order, 2.0 * cutoff_hz / rate_hz)
    pad = min(x.shape[0] - 1, int(3 * rate_hz / cutoff_hz))
    flat = x.reshape(x.shape[0], -1).T
    live = flat.any(axis=1)
    y = flat[live]
    y = np.concatenate([2.0 * y[:, :1] - y[:, pad:0:-1], y, 2.0 * y[:, -1:] - y[:, -2:-pad - 2:-1]], axis=1)
    for _ in range(2):  # forward, then backward
        y = sosfilt(sos, y, zi=state * y[:, :1])[0][:, ::-1]
    out = np.zeros(flat.shape)
    out[live] = y[:, pad : pad + x.shape[0]]
    return out.T.reshape(x.shape)


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
    """What differences between neighbours show of an encoder's error: its quantum, or white noise."""
    return max(white_noise_level(angle), quantum(angle) / np.sqrt(12.0))


def quantum(x: FloatArray) -> float:
    """Grid step of a quantised signal x (n,), 0 where the samples show no grid.

    The smallest step between distinct values is a quantum if all steps are whole multiples of it.
    """
    steps = np.diff(np.unique(x))
    if steps.size < 3:
        return 0.0
    smallest = float(np.min(steps))
    biggest = float(np.max(np.abs(x)))
    small = steps[steps < 50.0 * smallest]
    ratio = small / smallest
    rounding = 1e-9 * biggest / smallest + 0.02
    if rounding < 0.2 and small.size >= 3 and float(np.max(np.abs(ratio - np.rint(ratio)))) < rounding:
        return smallest
    return 0.0
