"""An independent leg whose controller, log and drive each keep their own time.

Runge-Kutta of fourth order at 8 kHz. A controller sets a torque at its ticks, the drive applies it later by a delay,
and a log keeps every so-many-th tick. Nothing of the estimator's motion model, and no other engine, is in here.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from scipy.signal import lfilter

from daq import Dataset, FloatArray
from tests.support.mujoco_leg import GRAVITY, Leg, multisine

STEP_HZ = 8000
SLIP_RADPS = 0.003
"""Velocity over which dry friction turns."""
STIFFNESS, DAMPING = 6.0, 0.25
"""Of the PD loop [N m/rad, N m s/rad]."""


@dataclass(frozen=True)
class Timing:
    """How a torque is made and logged."""

    tick_hz: float = 200.0
    """Of the controller."""
    log_every: int = 1
    """Ticks from one row of the log to the next."""
    delay_s: float = 0.0
    """From the tick until the torque acts."""
    between: str = "zero"
    """zero: held from tick to tick; ramp: a straight line between ticks; average: held, and the log has its mean over
    the past row."""
    loop: str = "open"
    """open: a multisine; pd: a multisine is followed by a PD loop on the encoder."""
    imu_age_s: float = 0.0
    """How late the IMU is stamped, ..."""
    imu_cutoff_hz: float = 0.0
    """... in addition to its low pass of first order; 0: none."""


@numba.njit(cache=True)
def _slope(x: Any, u: float, b: Any, spring: float, out: Any) -> None:
    q1, q2, v1, v2 = x
    c, s = np.cos(q2), np.sin(q2)
    d11, d12, d22 = b[0] + b[1] + 2 * b[2] * c, b[1] + b[2] * c, b[1]
    knee = b[4] * GRAVITY * np.sin(q1 + q2)
    t1 = b[2] * s * (2 * v1 * v2 + v2 * v2) - b[3] * GRAVITY * np.sin(q1) - knee - b[5] * v1 \
        - b[7] * np.tanh(v1 / SLIP_RADPS) - spring * q1
    t2 = u - b[2] * s * v1 * v1 - knee - b[6] * v2 - b[8] * np.tanh(v2 / SLIP_RADPS)
    det = d11 * d22 - d12 * d12
    out[0], out[1] = v1, v2
    out[2], out[3] = (d22 * t1 - d12 * t2) / det, (d11 * t2 - d12 * t1) / det


@numba.njit(cache=True)
def _run(plan: Any, substeps: int, delay: int, ramp: bool, pd: bool, grid: float, b: Any, spring: float) -> Any:
    """Rows (N substeps, 7) of q, v, accelerations, acting torque at every step, and commands (N,)."""
    count = plan.size
    rows, command = np.empty((count * substeps, 7)), np.zeros(count)
    x, k1, k2, k3, k4 = np.zeros(4), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    h = 1.0 / STEP_HZ
    before = 0.0
    for k in range(count):
        if pd:
            read = np.round(x[1] / grid) * grid
            rate = (read - before) / (substeps * h) if k else 0.0
            before = read
            command[k] = STIFFNESS * (plan[k] - read) - DAMPING * rate
        else:
            command[k] = plan[k]
        for i in range(substeps):
            acting = np.zeros(2)
            for e in range(2):  # at the step's start and just before its end
                late = k * substeps + i + 0.999 * e - delay
                m = int(np.floor(late / substeps))
                now = command[min(max(m, 0), k)]
                if ramp and m + 1 < count:
                    f = late / substeps - m
                    ahead = plan[m + 1] if not pd and m + 1 >= 0 else command[min(max(m + 1, 0), k)]
                    now += f * (ahead - now)
                acting[e] = now
            middle = 0.5 * (acting[0] + acting[1])
            _slope(x, acting[0], b, spring, k1)
            rows[k * substeps + i, :4], rows[k * substeps + i, 4:6] = x, k1[2:]
            rows[k * substeps + i, 6] = acting[0]
            _slope(x + 0.5 * h * k1, middle, b, spring, k2)
            _slope(x + 0.5 * h * k2, middle, b, spring, k3)
            _slope(x + h * k3, acting[1], b, spring, k4)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return rows, command


def record(leg: Leg, rng: np.random.Generator, timing: Timing, *, seconds: float = 10.0, amplitude: float = 1.0,
           counts: int = 16384, torque: float = 0.01, gyro: float = 0.005, accel: float = 0.05, spring: float = 0.0,
           name: str = "run") -> Dataset:
    """One run at the rate of the log, columns by the contract; `spring` [N m/rad] acts at the pivot."""
    plan = planned(rng, timing, seconds, amplitude)
    rows, command = _run(plan, round(STEP_HZ / timing.tick_hz), round(timing.delay_s * STEP_HZ),
                         timing.between == "ramp", timing.loop == "pd", 2 * np.pi / counts, leg.beta(), spring)
    return logged(leg, rng, timing, rows, command, counts=counts, noise=(torque, gyro, accel), name=name)


def planned(rng: np.random.Generator, timing: Timing, seconds: float, amplitude: float = 1.0) -> FloatArray:
    """A value for each tick: of the torque [N m], or of the angle that a loop follows [rad]."""
    time = np.arange(int(seconds * timing.tick_hz)) / timing.tick_hz
    peak = amplitude if timing.loop == "open" else 0.6
    return multisine(rng, time, peak, high=3.0) * np.minimum(1.0, time / 0.5)


def logged(leg: Leg, rng: np.random.Generator, timing: Timing, rows: FloatArray, command: FloatArray, *,
           counts: int = 16384, noise: tuple[float, float, float] = (0.01, 0.005, 0.05), log_hz: float | None = None,
           name: str = "run") -> Dataset:
    """The log of a motion, `rows` as `_run` returns them; noise of torque, gyro and accelerometer. `log_hz` need not be
    a part of the ticks: a row then has the last command."""
    rate_hz, substeps = log_hz or timing.tick_hz / timing.log_every, round(STEP_HZ / timing.tick_hz)
    step = np.arange(0, len(rows), round(STEP_HZ / rate_hz))
    at = step // substeps
    shown = command[at]
    if timing.between == "average":
        late = np.concatenate([np.zeros(1), np.cumsum(command)])
        shown = (late[at] - late[np.maximum(at - timing.log_every, 0)]) / timing.log_every
    felt = np.column_stack([rows[:, 2], leg.lever * rows[:, 4] + GRAVITY * np.sin(rows[:, 0]),
                            -leg.lever * rows[:, 2] ** 2 - GRAVITY * np.cos(rows[:, 0])])
    if timing.imu_cutoff_hz:
        keep = np.exp(-2 * np.pi * timing.imu_cutoff_hz / STEP_HZ)
        felt = lfilter([1 - keep], [1, -keep], felt - felt[0], axis=0) + felt[0]
    aged = np.clip(step - round(timing.imu_age_s * STEP_HZ), 0, len(rows) - 1)
    q1, q2, grid = rows[step, 0], rows[step, 1], 2 * np.pi / counts
    gyros, across, along = felt[aged].T
    n = at.size
    columns = {
        "q1_rad": np.round(q1 / grid) * grid, "q2_rad": np.round(q2 / grid) * grid,
        "tau2_nm": shown + noise[0] * rng.normal(size=n), "gyro_radps": gyros + noise[1] * rng.normal(size=n),
        "accel_x_mps2": across + noise[2] * rng.normal(size=n), "accel_y_mps2": along + noise[2] * rng.normal(size=n)}
    return Dataset(name, rate_hz, step / STEP_HZ, columns)
