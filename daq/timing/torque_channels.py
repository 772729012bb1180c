"""The drive's own torque against that of a second shunt: gain, offset and delay, by instrumental variables.

Both channels are noisy, so least squares of one on the other gives too small a gain. The command is free of their
noise, and drives both: with it and its rate as instruments z = (1, c, dc/dt) of

    second(t) = offset + gain * drive(t - delay),    linearised    second = offset + gain d - gain delay dd/dt,

where all three have gone through one low pass without delay, so that a shift by part of a step and a derivative are
exact enough. The estimate solves  Z^T X theta = Z^T y  and is consistent (Söderström and Stoica, Instrumental Variable
Methods for System Identification, 1983). Intervals come from leaving out one block of the record at a time (jackknife).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.dataset import Dataset, FloatArray

COLUMNS = ("tau2_nm", "tau2_shunt_nm", "tau2_cmd_nm")
BLOCKS = 20
LEAST_SAMPLES = 400
ROUNDS = 4
FARTHEST_S = 0.05
CUTOFF_HZ, ORDER = 8.0, 2
"""Of the low pass, a Butterworth forwards and backwards; a tenth of the rate where that is less."""
CLEAR_NM = 1e-3
"""Standard deviation of a command that moves nothing."""


class Figure(NamedTuple):
    """A value and the half of its 95 % interval."""

    value: float
    half: float


class TorqueChannels(NamedTuple):
    """The second shunt's torque against the drive's."""

    gain: Figure
    offset_nm: Figure
    delay_s: Figure
    """Second late against the drive's, when positive."""
    residual_nm: float
    """RMS of what is left between them."""


def compare_torque_channels(run: Dataset) -> TorqueChannels | None:
    """Second shunt against the drive; None where a channel is missing or the command does not move it."""
    if any(name not in run for name in COLUMNS):
        return None
    from scipy.signal import butter, sosfiltfilt  # a second that only runs with two channels wait for

    drive, second, command = (run[name] for name in COLUMNS)
    whole = np.isfinite(drive) & np.isfinite(second) & np.isfinite(command)
    if whole.sum() < LEAST_SAMPLES or float(np.std(command[whole])) < CLEAR_NM:
        return None
    here = slice(int(np.argmax(whole)), whole.size - int(np.argmax(whole[::-1])))
    time_s = run.time_s[here]
    low_pass = butter(ORDER, min(CUTOFF_HZ, 0.1 * run.rate_hz), fs=run.rate_hz, output="sos")
    drive, second, command = (sosfiltfilt(low_pass, np.interp(time_s, run.time_s[whole], x[whole]))
                              for x in (drive, second, command))
    whole = whole[here]
    delay = 0.0
    for _ in range(ROUNDS):
        theta, leave_one, residual = _estimate(drive, _at(second, time_s, delay), command, run.dt_s, whole)
        delay -= float(theta[2] / theta[1])
        if not np.isfinite(delay) or abs(delay) > FARTHEST_S:
            return None
    spread = _half(np.column_stack([leave_one[:, :2], -leave_one[:, 2] / leave_one[:, 1]]))
    return TorqueChannels(Figure(float(theta[1]), spread[1]), Figure(float(theta[0]), spread[0]),
                          Figure(delay, spread[2]), residual)


def _at(values: FloatArray, time_s: FloatArray, late_s: float) -> FloatArray:
    """The values so much later; the ends keep the last one."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(time_s, values)(np.minimum(np.maximum(time_s + late_s, time_s[0]), time_s[-1]))


def _estimate(drive: FloatArray, second: FloatArray, command: FloatArray, dt_s: float,
              whole: np.ndarray) -> tuple[FloatArray, FloatArray, float]:
    """(offset, gain, -gain * delay), the same with one block left out (blocks, 3), and the residual's rms."""
    one = np.ones_like(drive)
    table = np.column_stack([one, drive, np.gradient(drive, dt_s)])
    tools = np.column_stack([one, command, np.gradient(command, dt_s)])
    table, tools, second = table[whole], tools[whole], second[whole]
    rows = np.array_split(np.arange(second.size), BLOCKS)
    left = np.array([tools[r].T @ table[r] for r in rows])
    right = np.array([tools[r].T @ second[r] for r in rows])
    theta = np.linalg.lstsq(left.sum(axis=0), right.sum(axis=0), rcond=None)[0]
    each = np.array([np.linalg.lstsq(left.sum(axis=0) - a, right.sum(axis=0) - b, rcond=None)[0]
                     for a, b in zip(left, right)])
    return theta, each, float(np.sqrt(np.mean((second - table @ theta) ** 2)))


def _half(leave_one: FloatArray) -> list[float]:
    """Half of the 95 % interval of each column, from estimates (blocks, n) with one block left out."""
    from scipy.special import stdtrit

    n = leave_one.shape[0]
    variance = (n - 1) / n * ((leave_one - leave_one.mean(axis=0)) ** 2).sum(axis=0)
    half: list[float] = (float(stdtrit(n - 1, 0.975)) * np.sqrt(variance)).tolist()
    return half
