"""Independent planar trees for tests: MuJoCo's dynamics, its gyros and accelerometers on any link, nothing of the
estimator's.

Dry friction is rounded off over `FRICTION_RADPS` and acts inside MuJoCo's integrator, at every stage of a step: held
over a step of half a millisecond it would come a quarter of one late, which intervals of a long chain notice.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from daq import Dataset, FloatArray
from estimator.model import Mechanism
from tests.support.mujoco_leg import GRAVITY, multisine

FRICTION_RADPS = 0.05
SUB = 8
"""Steps of the integrator a sample."""


class Sensor(NamedTuple):
    """An IMU's place; links from 0."""

    link: int
    lever: float


class Noise(NamedTuple):
    """Standard deviations of what a record reads."""

    encoder: float = 1e-4
    gyro: float = 0.005
    accel: float = 0.05
    torque: float = 0.02


USUAL = Noise()


class Tree(NamedTuple):
    """Bodies, base first [SI]; each turns about the end of its parent, the first about a fixed pivot."""

    parent: tuple[int, ...]
    """-1 for the first"""
    mass: FloatArray
    length: FloatArray
    centre: FloatArray
    inertia: FloatArray
    """About each link's centre."""
    viscous: FloatArray
    coulomb: FloatArray
    upright: bool = False
    """All links stand on each other at q = 0, and hang below each other otherwise."""

    @property
    def n(self) -> int:
        return len(self.parent)

    def ancestors(self, link: int) -> list[int]:
        """Links that carry this one, itself left out."""
        above = self.parent[link]
        return [] if above < 0 else [*self.ancestors(above), above]

    def beta(self, mechanism: Mechanism) -> FloatArray:
        """Inertias in absolute angles, first moments and friction of `mechanism`'s parameters, by hand from the bodies.
        """
        beyond = np.array([sum(self.mass[k] for k in range(self.n) if i in self.ancestors(k)) for i in range(self.n)])
        moment = self.mass * self.centre + beyond * self.length
        own = self.inertia + self.mass * self.centre**2 + beyond * self.length**2
        known: dict[tuple[str, tuple[int, ...]], float] = {("viscous", (j,)): self.viscous[j] for j in range(self.n)}
        known |= {("coulomb", (j,)): self.coulomb[j] for j in range(self.n)}
        known |= {("gravity", (i,)): moment[i] * (GRAVITY if self.upright else 1.0) for i in range(self.n)}
        known |= {("inertia", (i, i)): own[i] for i in range(self.n)}
        known |= {("inertia", (i, j)): self.length[i] * moment[j] for j in range(self.n) for i in self.ancestors(j)}
        return np.array([known[p.term, p.at] for p in mechanism.parameters])

    def model(self, step: float, sensors: Sequence[Sensor]) -> mujoco.MjModel:
        """MuJoCo's tree."""
        down = 1.0 if self.upright else -1.0
        sites = [f'<site name="imu{k}" pos="0 0 {down * s.lever}"/>' for k, s in enumerate(sensors)]

        def body(i: int) -> str:
            inside = "".join(body(k) for k in range(self.n) if self.parent[k] == i)
            here = "".join(site for site, s in zip(sites, sensors) if s.link == i)
            at = down * self.length[self.parent[i]] if self.parent[i] >= 0 else 0.0
            return (f'<body pos="0 0 {at}"><joint name="q{i}" type="hinge" axis="0 -1 0" damping="{self.viscous[i]}"/>'
                    f'<inertial pos="0 0 {down * self.centre[i]}" mass="{self.mass[i]}" diaginertia="'
                    f'{self.inertia[i]} {self.inertia[i]} {self.inertia[i]}"/>{here}{inside}</body>')

        read = "".join(f'<accelerometer site="imu{k}"/><gyro site="imu{k}"/>' for k in range(len(sensors)))
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{step}" gravity="0 0 -{GRAVITY}" integrator="RK4"/><worldbody>{body(0)}'
            f"</worldbody><sensor>{read}</sensor></mujoco>")
        assert [model.joint(f"q{i}").qposadr[0] for i in range(self.n)] == list(range(self.n))
        return model


def random_tree(rng: np.random.Generator, parent: Sequence[int], *, length: float = 0.3, mass: float = 1.0,
                viscous: float = 0.3, coulomb: float = 0.1, upright: bool = False) -> Tree:
    """Links of about this size, each of its own."""
    n = len(parent)
    lengths, masses = length * rng.uniform(0.8, 1.25, n), mass * rng.uniform(0.7, 1.4, n)
    return Tree(tuple(parent), masses, lengths, 0.5 * lengths * rng.uniform(0.8, 1.2, n), masses * lengths**2 / 10.0,
                viscous * rng.uniform(0.8, 1.25, n), coulomb * rng.uniform(0.5, 1.5, n), upright)


class Motion(NamedTuple):
    """A simulation at its samples, free of noise."""

    q: FloatArray
    """(N, n) [rad]"""
    qd: FloatArray
    imu: FloatArray
    """(N, S, 3) gyro, accelerometer along the way of the link's end and along the link, of each IMU."""
    tau: FloatArray
    """(N, n) [N m]"""


Feedback = Callable[[FloatArray, FloatArray], FloatArray]
"""From angles and rates (n,) to torque (n,)."""


def move(tree: Tree, tau: FloatArray, rate_hz: float, sensors: Sequence[Sensor] = (),
         start: tuple[Sequence[float], Sequence[float]] | None = None, feedback: Feedback | None = None) -> Motion:
    """The motion under torques (N, n), linear between samples, from rest at zero or from `start` (angles, rates).

    What `feedback` says at one sample acts in full at the next.
    """
    model, tau = tree.model(1.0 / rate_hz / SUB, sensors), tau.copy()
    data = mujoco.MjData(model)
    if start is not None:
        data.qpos[:], data.qvel[:] = start
    count = len(tau)
    q, qd, read = np.empty((count, tree.n)), np.empty((count, tree.n)), np.empty((count, len(sensors), 6))

    def friction(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_passive[:] -= tree.coulomb * data.qvel / np.hypot(data.qvel, FRICTION_RADPS)

    mujoco.set_mjcb_passive(friction)
    try:
        for k in range(count):
            data.qfrc_applied[:] = tau[k]
            mujoco.mj_forward(model, data)
            q[k], qd[k], read[k] = data.qpos, data.qvel, data.sensordata.reshape(-1, 6)
            after = tau[min(k + 1, count - 1)]
            if feedback is not None and k + 1 < count:
                after += feedback(q[k], qd[k])
            for i in range(SUB):
                data.qfrc_applied[:] = tau[k] + (after - tau[k]) * (i + 0.5) / SUB
                mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_passive(None)
    # angles grow about -y, so at q = 0 the end of a hanging link moves along its own x, that of an upright one against
    side = -1.0 if tree.upright else 1.0
    return Motion(q, qd, np.stack([-read[..., 4], side * read[..., 0], -side * read[..., 2]], axis=-1), tau)


def torques(tree: Tree, rng: np.random.Generator, seconds: float, rate_hz: float, share: float,
            driven: Sequence[int], high_hz: float = 2.5) -> FloatArray:
    """(N, n) multisines with peaks of a `share` of what would hold the links beyond a joint out level."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    tau = np.zeros((time.size, tree.n))
    for j in driven:
        beyond = [k for k in range(tree.n) if k == j or j in tree.ancestors(k)]
        level = GRAVITY * sum(tree.mass[k] for k in beyond) * 0.5 * sum(tree.length[k] for k in beyond)
        tau[:, j] = multisine(rng, time, share * level, high=high_hz)
    return tau


def imu_names(number: int) -> tuple[str, str, str]:
    """Columns of the contract, IMUs counted from 0."""
    own = "" if number == 0 else str(number + 1)
    return f"gyro{own}_radps", f"accel{own}_x_mps2", f"accel{own}_y_mps2"


def disturbed(motion: Motion, driven: Sequence[int], rate_hz: float, rng: np.random.Generator,
              noise: Noise = USUAL, name: str = "run") -> Dataset:
    """A record of all encoders, the torques of the joints `driven` and all IMUs, each reading with noise of its own."""
    count, n = motion.q.shape
    columns = {f"q{j + 1}_rad": motion.q[:, j] + noise.encoder * rng.normal(size=count) for j in range(n)}
    columns |= {f"tau{j + 1}_nm": motion.tau[:, j] + noise.torque * rng.normal(size=count) for j in driven}
    for k in range(motion.imu.shape[1]):
        for column, clean, level in zip(imu_names(k), motion.imu[:, k].T, (noise.gyro, noise.accel, noise.accel)):
            columns[column] = clean + level * rng.normal(size=count)
    return Dataset(name, rate_hz, np.arange(count) / rate_hz, columns)
