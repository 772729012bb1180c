"""A leg of MuJoCo whose knee is a position servo, logged with its command and without its torque."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from daq import Dataset, parse_rig
from experiments.session import driven
from tests.support.mujoco_leg import Leg, multisine

COUNTS = 4096
STEP_S = 1e-3


@dataclass(frozen=True)
class ServoFaults:
    """What the loop does otherwise than its gain, damping and limit say."""

    delay_s: float = 0.0
    gain: float = 1.0
    """Factor of gain and damping."""
    integral: float = 0.0
    """[N m/(rad s)]"""
    limit: float = np.inf
    """[N m]"""
    sag: float = 0.0
    """The torque falls to 1 / (1 + sag |u|) of what is wanted [1/(N m)]."""
    dead_band: float = 0.0
    """[rad]"""
    step: float = 0.0
    """Of the command [rad]"""
    velocity_filter_s: float = 0.0
    command_filter_s: float = 0.0
    """Time constants of low passes of first order"""
    encoder_scale: float = 0.0
    """The loop hears angle and rate times one plus this, and they are logged so."""
    log_scale: float = 0.0
    """The log has the angle that the loop hears times one plus this."""


def follow(leg: Leg, rng: np.random.Generator | int, *, gain: float, damping: float = 0.0, limit: float = np.inf,
           amplitude: float = 0.8, seconds: float = 15.0, rate_hz: float = 100.0, rounding: float = 0.02,
           loop_hz: float = 1000.0, faults: ServoFaults = ServoFaults(), high: float = 2.0,
           law: Callable[..., tuple[float, float]] | None = None,
           name: str = "run") -> Dataset:
    """The servo gives gain (cmd - q) - damping qd within +-limit, by its own encoder of COUNTS a turn.

    `law` adds torques on pivot and knee by both angles, both rates and the servo's torque. `rng` may be a seed.
    """
    model, rng = leg.model(STEP_S), np.random.default_rng(rng)
    data = mujoco.MjData(model)
    n, sub, every = int(seconds * rate_hz), round(1.0 / (rate_hz * STEP_S)), round(1.0 / (loop_hz * STEP_S))
    ticks = np.arange(n * sub) * STEP_S
    command = multisine(rng, ticks, amplitude, high=high)
    servo = Servo(gain, damping, limit, faults, round(faults.delay_s / (STEP_S * every)), every * STEP_S)
    rows, grid, coulomb, torque = np.empty((n, 3)), 2.0 * np.pi / COUNTS, np.array(leg.coulomb), 0.0
    heard = np.array([1.0, 1.0 + faults.encoder_scale])
    for k in range(n * sub):
        read = heard * np.round(data.qpos / grid) * grid
        if k % sub == 0:
            rows[k // sub] = *read, command[k]
        if k % every == 0:
            torque = servo.torque(command[k], read[1], heard[1] * float(data.qvel[1]))
        data.qfrc_applied[:] = -coulomb * np.tanh(data.qvel / rounding)
        data.qfrc_applied[1] += torque
        if law is not None:
            data.qfrc_applied[:] += law(*data.qpos.tolist(), *data.qvel.tolist(), torque)
        mujoco.mj_step(model, data)
    rows[:, 1] *= 1.0 + faults.log_scale
    columns = dict(zip(("q1_rad", "q2_rad", "q2_cmd_rad"), np.ascontiguousarray(rows.T)))
    return Dataset(name, rate_hz, np.arange(n) / rate_hz, columns)


class Servo:
    """A position controller that works from tick to tick."""

    def __init__(self, gain: float, damping: float, limit: float, faults: ServoFaults, late: int, period_s: float
                 ) -> None:
        self.gain, self.damping, self.limit, self.faults, self.period_s = gain, damping, limit, faults, period_s
        self.queue: deque[float] = deque(maxlen=late + 1)
        self.summed = 0.0
        self.rate, self.goal = 0.0, float("nan")

    def torque(self, command: float, angle: float, rate: float) -> float:
        """[N m] at a tick."""
        f = self.faults
        self.queue.append(command)
        goal = self.queue[0]
        self.rate = rate + self._kept(f.velocity_filter_s) * (self.rate - rate)
        self.goal = goal if self.goal != self.goal else goal + self._kept(f.command_filter_s) * (self.goal - goal)
        goal, rate = self.goal, self.rate
        if f.step:
            goal = round(goal / f.step) * f.step
        error = goal - angle
        self.summed += error * self.period_s
        if f.dead_band:
            error = np.sign(error) * max(abs(error) - f.dead_band, 0.0)
        wanted = f.gain * (self.gain * error - self.damping * rate) + f.integral * self.summed
        most = min(self.limit, f.limit)
        wanted = float(np.clip(wanted, -most, most))
        return wanted / (1.0 + f.sag * abs(wanted))

    def _kept(self, time_constant_s: float) -> float:
        return float(np.exp(-self.period_s / time_constant_s)) if time_constant_s else 0.0


def with_torque(run: Dataset, servo: str) -> Dataset:
    """`run` with the torque by the law under `[servo]` of a rig file."""
    return driven(run, parse_rig(f'[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\n{servo}'))
