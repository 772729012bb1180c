"""The leg of `timed_leg` in two engines that are neither MuJoCo nor ours: Pinocchio and PyBullet.

Pinocchio gives accelerations by its articulated-body algorithm, which Runge-Kutta of fourth order integrates. PyBullet
steps by its own semi-implicit Euler rule. Friction is a torque in both.
"""

import importlib
import importlib.util
from typing import NamedTuple, Protocol

import numpy as np

from daq import Dataset, FloatArray
from tests.support import runge_kutta
from tests.support.mujoco_leg import GRAVITY, Leg
from tests.support.timed_leg import DAMPING, SLIP_RADPS, STEP_HZ, STIFFNESS, Timing, logged, planned

MODULES = {"pinocchio": "pinocchio", "bullet": "pybullet"}
"""Engine to the module that it comes in; the packages are `pin` and `pybullet`, extra `engines`."""


class Step(NamedTuple):
    """A step of an engine from q, v (2,) under a torque at the knee."""

    q: FloatArray
    v: FloatArray
    a: FloatArray
    """(2,) acceleration at its start"""


class Engine(Protocol):
    def step(self, q: FloatArray, v: FloatArray, torque: float) -> Step: ...


def missing() -> list[str]:
    """Engines that are not installed."""
    return [name for name, module in MODULES.items() if importlib.util.find_spec(module) is None]


def friction(leg: Leg, v: FloatArray) -> FloatArray:
    """(2,) torque against the motion [N m]."""
    return np.array(leg.viscous) * v + np.array(leg.coulomb) * np.tanh(v / SLIP_RADPS)


class Pinocchio:
    """Two revolute joints about -y; links hang along -z."""

    def __init__(self, leg: Leg) -> None:
        self.leg, self._pin = leg, importlib.import_module("pinocchio")
        pin = self._pin
        self._model = pin.Model()
        self._model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
        axis = pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))
        parent = 0
        for place, mass, centre, inertia in ((0.0, leg.m1, leg.c1, leg.i1), (leg.l1, leg.m2, leg.c2, leg.i2)):
            parent = self._model.addJoint(parent, axis, pin.SE3(np.eye(3), np.array([0.0, 0.0, -place])), f"j{parent}")
            body = pin.Inertia(mass, np.array([0.0, 0.0, -centre]), inertia * np.eye(3))
            self._model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        self._data = self._model.createData()

    def acceleration(self, q: FloatArray, v: FloatArray, torque: FloatArray) -> FloatArray:
        """(2,) under torques (2,) at both joints."""
        return np.array(self._pin.aba(self._model, self._data, q, v, torque))

    def step(self, q: FloatArray, v: FloatArray, torque: float) -> Step:
        drive = np.array([0.0, torque])
        return Step(*runge_kutta.step(lambda q, v: self.acceleration(q, v, drive - friction(self.leg, v)), q, v,
                                      1.0 / STEP_HZ))


class Bullet:
    """The same as a multibody without motors, damping and contacts."""

    def __init__(self, leg: Leg) -> None:
        self.leg, self._b = leg, importlib.import_module("pybullet")
        b = self._b
        self._client = b.connect(b.DIRECT)
        b.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=self._client)
        b.setTimeStep(1.0 / STEP_HZ, physicsClientId=self._client)
        still = [[0.0, 0.0, 0.0, 1.0]] * 2
        self._body = b.createMultiBody(
            baseMass=0.0, linkMasses=[leg.m1, leg.m2], linkCollisionShapeIndices=[-1, -1],
            linkVisualShapeIndices=[-1, -1], linkPositions=[[0.0, 0.0, 0.0], [0.0, 0.0, -leg.l1]],
            linkOrientations=still, linkInertialFramePositions=[[0.0, 0.0, -leg.c1], [0.0, 0.0, -leg.c2]],
            linkInertialFrameOrientations=still, linkParentIndices=[0, 1], linkJointTypes=[b.JOINT_REVOLUTE] * 2,
            linkJointAxis=[[0.0, -1.0, 0.0]] * 2, physicsClientId=self._client)
        for link, inertia in enumerate((leg.i1, leg.i2)):
            b.changeDynamics(self._body, link, localInertiaDiagonal=[inertia] * 3, linearDamping=0.0,
                             angularDamping=0.0, jointDamping=0.0, physicsClientId=self._client)
            b.setJointMotorControl2(self._body, link, b.VELOCITY_CONTROL, force=0.0, physicsClientId=self._client)

    def step(self, q: FloatArray, v: FloatArray, torque: float) -> Step:
        b, drive = self._b, np.array([0.0, torque]) - friction(self.leg, v)
        b.setJointMotorControlArray(self._body, [0, 1], b.TORQUE_CONTROL, forces=drive.tolist(),
                                    physicsClientId=self._client)
        b.stepSimulation(physicsClientId=self._client)
        states = b.getJointStates(self._body, [0, 1], physicsClientId=self._client)
        after = np.array([state[1] for state in states])
        return Step(np.array([state[0] for state in states]), after, (after - v) * STEP_HZ)

    def close(self) -> None:
        """Let go of the world."""
        self._b.disconnect(self._client)


def engine_of(name: str, leg: Leg) -> Engine:
    """`pinocchio` or `bullet` with this leg in it, at rest."""
    return Pinocchio(leg) if name == "pinocchio" else Bullet(leg)


def record(name: str, leg: Leg, rng: np.random.Generator, timing: Timing, *, log_hz: float, seconds: float = 10.0,
           counts: int = 16384, run: str = "run") -> Dataset:
    """One run of a leg in an engine under a controller with these ticks, logged at `log_hz`."""
    plan, engine = planned(rng, timing, seconds), engine_of(name, leg)
    substeps, grid = round(STEP_HZ / timing.tick_hz), 2 * np.pi / counts
    rows, command = np.empty((plan.size * substeps, 7)), np.zeros(plan.size)
    q, v, before = np.zeros(2), np.zeros(2), 0.0
    for k, wanted in enumerate(plan):
        command[k] = wanted
        if timing.loop == "pd":
            read = float(np.round(q[1] / grid) * grid)
            command[k] = STIFFNESS * (wanted - read) - DAMPING * (read - before) * timing.tick_hz * bool(k)
            before = read
        for i in range(k * substeps, (k + 1) * substeps):
            after = engine.step(q, v, float(command[k]))
            rows[i] = [*q, *v, *after.a, command[k]]
            q, v = after.q, after.v
    if isinstance(engine, Bullet):
        engine.close()
    return logged(leg, rng, timing, rows, command, counts=counts, log_hz=log_hz, name=run)
