"""An independent leg for tests: MuJoCo's dynamics and sensors, nothing of the estimator's.

The physical parameters are seeded; `record` returns a `Dataset` with the noise of a real rig.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from daq import Dataset, FloatArray

GRAVITY = 9.81
XML = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -{g}" integrator="RK4"/>
  <worldbody>
    <body name="upper" pos="0 0 0">
      <joint name="pivot" type="hinge" axis="0 -1 0" damping="{d1}" frictionloss="0"/>
      <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="{i1} {i1} {i1}"/>
      <site name="imu" pos="0 0 -{lever}"/>
      <body name="lower" pos="0 0 -{l1}">
        <joint name="knee" type="hinge" axis="0 -1 0" damping="{d2}" frictionloss="0"/>
        <inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="{i2} {i2} {i2}"/>
      </body>
    </body>
  </worldbody>
  <sensor><accelerometer site="imu"/><gyro site="imu"/></sensor>
</mujoco>
"""


@dataclass(frozen=True)
class Leg:
    """Physical parameters of a leg [SI], and the nine of the contract computed from them by hand."""

    m1: float = 1.3
    l1: float = 0.30
    c1: float = 0.16
    i1: float = 0.012
    m2: float = 0.8
    c2: float = 0.15
    i2: float = 0.007
    viscous: tuple[float, float] = (0.02, 0.03)
    coulomb: tuple[float, float] = (0.03, 0.05)
    lever: float = 0.20

    def beta(self) -> np.ndarray:
        return np.array([
            self.i1 + self.m1 * self.c1**2 + self.m2 * self.l1**2, self.i2 + self.m2 * self.c2**2,
            self.m2 * self.l1 * self.c2, self.m1 * self.c1 + self.m2 * self.l1, self.m2 * self.c2,
            *self.viscous, *self.coulomb])

    def model(self, step: float) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(XML.format(
            step=step, g=GRAVITY, d1=self.viscous[0], d2=self.viscous[1], m1=self.m1, c1=self.c1, i1=self.i1,
            l1=self.l1, m2=self.m2, c2=self.c2, i2=self.i2, lever=self.lever))


def random_leg(rng: np.random.Generator | int) -> Leg:
    """A leg of a plausible size; `rng` may be a seed."""
    scale = np.random.default_rng(rng).uniform(0.8, 1.25, 8)
    return Leg(m1=1.3 * scale[0], l1=0.3 * scale[1], c1=0.16 * scale[2], i1=0.012 * scale[3], m2=0.8 * scale[4],
               c2=0.15 * scale[5], i2=0.007 * scale[6],
               viscous=(0.02 * scale[7], 0.03), coulomb=(0.03, 0.05 * scale[0]), lever=0.2)


def recorded(seed: int, count: int, seconds: float = 10.0) -> tuple[Leg, list[Dataset]]:
    """A leg, and so many runs of it."""
    rng = np.random.default_rng(seed)
    leg = random_leg(rng)
    return leg, [record(leg, rng, seconds=seconds, name=f"run{k}") for k in range(count)]


def scaled(runs: list[Dataset], column: str, factor: float) -> list[Dataset]:
    """Runs whose column reads `factor` times as much."""
    return [replace(run, columns={**run.columns, column: factor * run[column]}) for run in runs]


def multisine(rng: np.random.Generator, time: np.ndarray, amplitude: float, low: float = 0.1,
              high: float = 3.0) -> np.ndarray:
    """Random-phase multisine with peak `amplitude`."""
    f: FloatArray = np.arange(low, high, 1.0 / (time[-1] - time[0]))
    phase = rng.uniform(0, 2 * np.pi, f.shape)
    x: FloatArray = np.sin(2 * np.pi * f[:, None] * time + phase[:, None]).sum(axis=0)
    return amplitude * x / np.max(np.abs(x))


def record(leg: Leg, rng: np.random.Generator | int, *, seconds: float = 20.0, rate_hz: float = 100.0,
           amplitude: float = 1.2, gyro: float = 0.005, accel: float = 0.05, torque: float = 0.02,
           counts: int = 8192, hold: str = "linear", step: float = 5e-4, high: float = 3.0,
           friction_velocity: float = 3e-3, tau: np.ndarray | None = None, name: str = "run",
           spring: tuple[float, float] = (0.0, 0.0),
           law: Callable[[float, float, float, float], tuple[float, float]] | None = None) -> Dataset:
    """Simulate, sample and disturb one run; `hold` says how the true torque moves between samples.

    `rng` may be a seed.

    `spring` is (stiffness [N m/rad], rest angle [rad]) of a spring on the pivot; `law` gives torques that act on pivot
    and knee in addition, by both angles and both rates.
    """
    model, rng = leg.model(step), np.random.default_rng(rng)
    data = mujoco.MjData(model)
    n = int(seconds * rate_hz)
    sub = round(1.0 / (rate_hz * step))
    time = np.arange(n) / rate_hz
    if tau is None:
        tau = multisine(rng, time, amplitude, high=high)
    tau_next = np.append(tau[1:], tau[-1])
    rows = np.empty((n, 6))
    applied, qpos, qvel, sensed = data.qfrc_applied, data.qpos, data.qvel, data.sensordata  # views: MuJoCo's own memory
    (dry1, dry2), (stiffness, rest) = leg.coulomb, spring
    for k in range(n):
        now, slope = float(tau[k]), 0.0 if hold == "zero" else float(tau_next[k] - tau[k]) / sub
        for i in range(sub):
            v1, v2 = qvel.tolist()
            applied[:] = (-dry1 * math.tanh(v1 / friction_velocity) - stiffness * (qpos[0] - rest),
                          -dry2 * math.tanh(v2 / friction_velocity) + now + slope * (i + 0.5))
            if law is not None:
                q1, q2 = qpos.tolist()
                applied[:] += law(q1, q2, v1, v2)
            if i == 0:
                mujoco.mj_forward(model, data)
                # MuJoCo: x forward, z up along the link towards the pivot, rotation about -y
                rows[k] = qpos[0], qpos[1], -sensed[4], sensed[0], -sensed[2], now
            mujoco.mj_step(model, data)
    angle1, angle2, w, ax, ay, u = rows.T
    grid = 2 * np.pi / counts
    columns = {
        "q1_rad": np.round(angle1 / grid) * grid, "q2_rad": np.round(angle2 / grid) * grid,
        "tau2_nm": u + torque * rng.normal(size=n), "gyro_radps": w + gyro * rng.normal(size=n),
        "accel_x_mps2": ax + accel * rng.normal(size=n), "accel_y_mps2": ay + accel * rng.normal(size=n)}
    return Dataset(name, rate_hz, time, {k: np.ascontiguousarray(v) for k, v in columns.items()})
