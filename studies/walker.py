"""One step of the three-link walker of Grizzle, Abba and Plestan (2001): the simulated robot of section V.

Controller: virtual constraints of that paper, torso held at `TORSO_RAD` and the swing leg mirroring the stance
leg, enforced by input-output linearisation with critically damped error dynamics. The controller is sampled:
its torque is computed at each sample from the state and held until the next (zero-order hold), so the torque
record drives the walker open loop without any loss.

Initial state: just after an impact (`impact`, rigid and without slip) of the gait that repeats itself under this
controller (`periodic_rate`).

Angles of a `Step` are the paper's: q1 stance leg from upright, q2 and q3 swing leg and torso relative to it,
every link counted from its lower end upwards, so a swing leg that hangs straight down has q1 + q2 = pi. The
motors, and so the torque noise, act between torso and stance leg (u1) and torso and swing leg (u2): B of
section V, tau2 = -u2, tau3 = u1 + u2. `in_motor_angles` gives the same motion in the angles that the motors
turn, where the noise of the two torques is independent and beta is the same.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from daq import FloatArray
from estimator.model import Mechanism, biped3
from studies.rk4_free_run import advance

MASS, HIP, TORSO, LEG, TORSO_LENGTH, GRAVITY = 5.0, 15.0, 10.0, 1.0, 0.5, 9.8
"""m, M_H, M_T [kg], r, l [m], g [m/s2]: the numerical example of Grizzle et al.; (57) lumps hip and torso."""
IMPACT_RAD, TORSO_RAD = np.pi / 8.0, np.pi / 6.0
"""Stance angle at which the swing leg lands, torso lean held: theta1d and theta3d of the same example."""
BANDWIDTH = 10.0
"""Natural frequency of the constraint errors [rad/s]: slow against the 100 Hz of the hold."""
PERIOD_S, DURATION_S = 0.01, 0.68
SUBSTEPS = 20
"""Integration steps a sample; the trajectory's error is below 1e-10 rad (tests/studies/test_walker.py)."""
UNACTUATED = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
"""Generalised torque of (tau2, tau3); the stance foot carries none."""
CONSTRAINTS = np.array([[2.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
"""Rows of y = H q - y_d: theta1 + theta2 - pi, and theta3 - TORSO_RAD."""
TARGETS = np.array([np.pi, TORSO_RAD])
CONSTRAINT_TANGENT = np.array([1.0, -2.0, -1.0])
"""Direction of motion along which y stays constant."""


def true_parameters() -> FloatArray:
    """beta (8,) of (58) for the masses and lengths of (57)."""
    m3, lc3 = HIP + TORSO, TORSO * TORSO_LENGTH / (HIP + TORSO)
    i3 = HIP * lc3**2 + TORSO * (TORSO_LENGTH - lc3) ** 2
    half = 0.5 * LEG
    return np.array([
        LEG**2 * (MASS + m3) + half**2 * MASS, MASS * half**2, i3 + m3 * lc3**2, LEG * half * MASS, LEG * lc3 * m3,
        GRAVITY * (LEG * (MASS + m3) + half * MASS), GRAVITY * half * MASS, GRAVITY * lc3 * m3])


MOTOR_ANGLES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 1.0]])
"""q1, torso against stance leg, torso against swing leg, from q1, q2, q3."""


def motor_mechanism() -> Mechanism:
    """`biped3` in the angles that its motors turn; the same beta (8,)."""
    paper = biped3()
    return replace(paper, transform=paper.transform @ np.linalg.inv(MOTOR_ANGLES))


class Step(NamedTuple):
    """One step as a record; N samples `PERIOD_S` apart, torque held from each sample to the next."""

    time_s: FloatArray
    """(N,)"""
    q: FloatArray
    """(N, 3) [rad]"""
    qd: FloatArray
    """(N, 3) [rad/s]"""
    qdd: FloatArray
    """(N, 3) just after the sample, under the torque held from it on [rad/s2]."""
    torque: FloatArray
    """(N, 3) [N m]; column 0, the stance foot, is zero."""

    def in_motor_angles(self) -> Step:
        """The same motion in the coordinates of `motor_mechanism`."""
        m = MOTOR_ANGLES
        torque = np.asarray(self.torque @ np.linalg.inv(m), dtype=np.float64)
        return Step(self.time_s, self.q @ m.T, self.qd @ m.T, self.qdd @ m.T, torque)


def control(mechanism: Mechanism, beta: FloatArray, q: FloatArray, qd: FloatArray,
            bandwidth: float = BANDWIDTH) -> FloatArray:
    """Torque (3,) that makes y'' = -2 w y' - w^2 y for the virtual constraints y, at one state (3,), (3,)."""
    inverse = np.linalg.inv(mechanism.inertia_matrix(q, beta))
    wanted = -2.0 * bandwidth * (CONSTRAINTS @ qd) - bandwidth**2 * (CONSTRAINTS @ q - TARGETS)
    drift = CONSTRAINTS @ inverse @ mechanism.bias_torque(q, qd, beta)
    torque: FloatArray = UNACTUATED @ np.linalg.solve(CONSTRAINTS @ inverse @ UNACTUATED, wanted + drift)
    return torque


def impact(qd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """State (3,), (3,) after the swing leg lands with the constraints met and rates qd (3,): legs change roles.

    Rigid, without slip or rebound (Grizzle et al., section II-C): the foot's impulse F changes the rates of the
    floating walker by D_e (v+ - v-) = E^T F with E v+ = 0 at the landing foot.
    """
    theta = np.array([IMPACT_RAD, np.pi - IMPACT_RAD, TORSO_RAD])
    rates = np.array([qd[0], qd[0] + qd[1], qd[0] + qd[2]])
    sin, cos = np.sin(theta), np.cos(theta)
    # positions as rows over (theta1, theta2, theta3, foot x, foot z); z up, a link points along (sin, cos)
    def along(link: int, length: float) -> FloatArray:
        out = np.zeros((2, 5))
        out[:, link] = length * np.array([cos[link], -sin[link]])
        return out

    foot = np.hstack([np.zeros((2, 3)), np.eye(2)])
    hip = foot + along(0, LEG)
    points = [(MASS, foot + along(0, 0.5 * LEG)), (HIP, hip), (MASS, hip + along(1, 0.5 * LEG)),
              (TORSO, hip + along(2, TORSO_LENGTH))]
    inertia = sum((m * j.T @ j for m, j in points), np.zeros((5, 5)))
    landing = hip + along(1, LEG)
    before = np.concatenate([rates, np.zeros(2)])
    system = np.block([[inertia, -landing.T], [landing, np.zeros((2, 2))]])
    after = np.linalg.solve(system, np.concatenate([inertia @ before, np.zeros(2)]))
    stance, swing, torso = theta[1] - np.pi, theta[0] + np.pi, theta[2]
    rate = after[[1, 0, 2]]
    return (np.array([stance, swing - stance, torso - stance]),
            np.array([rate[0], rate[1] - rate[0], rate[2] - rate[0]]))


def walk(q0: FloatArray, qd0: FloatArray, samples: int, bandwidth: float = BANDWIDTH,
         continuous: bool = False) -> Step:
    """`samples` samples of the controlled walker from the state (3,), (3,).

    With `continuous` the controller acts at every instant, and the record's torque is what it gave at the samples;
    otherwise it is held from each sample to the next.
    """
    mechanism, beta = biped3(), true_parameters()
    q, qd, torque = (np.zeros((samples, 3)) for _ in range(3))
    q[0], qd[0] = q0, qd0
    for k in range(samples):
        torque[k] = control(mechanism, beta, q[k], qd[k], bandwidth)
        if k + 1 < samples and continuous:
            q[k + 1], qd[k + 1] = _advance_controlled(mechanism, beta, q[k], qd[k], bandwidth)
        elif k + 1 < samples:
            q[k + 1], qd[k + 1] = advance(mechanism, beta, q[k], qd[k], torque[k], PERIOD_S, SUBSTEPS)
    qdd = mechanism.forward_dynamics(q, qd, torque, beta)
    return Step(np.asarray(PERIOD_S * np.arange(samples), dtype=np.float64), q, qd, qdd, torque)


def _advance_controlled(mechanism: Mechanism, beta: FloatArray, q: FloatArray, qd: FloatArray,
                        bandwidth: float) -> tuple[FloatArray, FloatArray]:
    """State (3,), (3,) a sample later under a controller that acts at every instant. Classical Runge-Kutta."""
    h = PERIOD_S / SUBSTEPS

    def acceleration(angle: FloatArray, rate: FloatArray) -> FloatArray:
        return mechanism.forward_dynamics(angle, rate, control(mechanism, beta, angle, rate, bandwidth), beta)

    for _ in range(SUBSTEPS):
        a1 = acceleration(q, qd)
        v2 = qd + 0.5 * h * a1
        a2 = acceleration(q + 0.5 * h * qd, v2)
        v3 = qd + 0.5 * h * a2
        a3 = acceleration(q + 0.5 * h * v2, v3)
        v4 = qd + h * a3
        a4 = acceleration(q + h * v3, v4)
        q = q + h / 6.0 * (qd + 2.0 * v2 + 2.0 * v3 + v4)
        qd = qd + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return q, qd


def after_impact(rate_radps: float) -> tuple[FloatArray, FloatArray]:
    """State (3,), (3,) just after a step that met the constraints and landed with this stance rate [rad/s]."""
    return impact(rate_radps * CONSTRAINT_TANGENT)


@lru_cache(maxsize=1)
def periodic_rate() -> float:
    """Stance rate [rad/s] at landing that the controlled walker returns to after one step: its own gait."""
    mechanism, beta = biped3(), true_parameters()

    def change(rate: float) -> float:
        q, qd = after_impact(rate)
        for _ in range(200):
            last, last_rate = q, qd
            q, qd = advance(mechanism, beta, q, qd, control(mechanism, beta, q, qd), PERIOD_S, 2)
            if q[0] >= IMPACT_RAD:
                share = (IMPACT_RAD - last[0]) / (q[0] - last[0])
                return float(last_rate[0] + share * (qd[0] - last_rate[0])) - rate
        return -rate

    return float(brentq(change, 1.4, 2.0, xtol=1e-6))


@lru_cache(maxsize=1)
def one_step() -> Step:
    """The record of the study: the first `DURATION_S` after an impact of the periodic gait (a step takes 0.83 s)."""
    return walk(*after_impact(periodic_rate()), round(DURATION_S / PERIOD_S) + 1)


def one_step_continuous(bandwidth: float, continuous: bool = True, first: int = 0) -> Step:
    """`DURATION_S` from sample `first` on, from the initial state of `one_step`, under another controller."""
    samples = round(DURATION_S / PERIOD_S) + 1
    step = walk(*after_impact(periodic_rate()), first + samples, bandwidth, continuous)
    return Step(step.time_s[:samples], *(values[first:] for values in step[1:]))
