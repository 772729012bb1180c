"""Springs, inertias, play, stops and the base."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter

from estimator.effects.base import Effect, Perturbation, Points, SensorEffect, Shape, Size, TorqueEffect, View
from estimator.mechanism import Mechanism

FloatArray = NDArray[np.float64]


class JointStiffness(TorqueEffect):
    """k q - c: a spring at the joint, c = k q0 its torque at the zero angle."""

    name = "joint_stiffness"
    sizes = (Size("stiffness", "N m/rad", 0.05), Size("preload", "N m", 0.01))
    sentence = "a spring acts at the joint (cable, seal, hose)"
    reference = "linear spring"
    experiment = "static holds over the whole range of the joint"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * at.q[self.joint or 0] - size[1]


class RotorInertia(TorqueEffect):
    """J q2dd: the geared rotor, felt in its own joint's equation only."""

    name = "rotor_inertia"
    sizes = (Size("inertia", "kg m^2", 0.001),)
    sentence = "the motor's rotor adds inertia at its joint (gear ratio squared)"
    reference = "Spong 1987"
    experiment = "fast motion of the joint with the other one at large and small speed"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * at.a[self.joint or 0]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if any(p.term == "rotor" and p.at == (self.joint,) for p in mechanism.parameters):
            return "declared in the rig: it is a parameter of the nominal model"
        return "" if self.joint in actuated and mechanism.n > 1 else "no motor at this joint, or inertia absorbs it"


class EndStopContact(TorqueEffect):
    """One-sided spring and damper beyond an angle; a negative angle is a stop on the other side."""

    name = "end_stop_contact"
    sizes = (Size("stiffness", "N m/rad", 0.5),)
    shapes = (Shape("angle_share", "1", (-0.9, -0.8, -0.65, 0.65, 0.8, 0.9)),)
    sentence = "the joint touches a stop at the end of its range"
    reference = "Hunt and Crossley 1975 (linearised)"
    experiment = "slow approach to both ends of the range"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        q = at.q[j]
        side = np.sign(size[1])
        reach = abs(view.reach[j, 1 if side > 0 else 0])
        depth = side * q - abs(size[1]) * reach
        rounded = 0.5 * (depth + np.sqrt(depth * depth + 1e-6))
        return size[0] * side * rounded


class JointElasticity(SensorEffect):
    """The encoder, on the motor, reads the link's angle plus the gear's twist T / k under the torque T."""

    name = "joint_elasticity"
    sizes = (Size("compliance", "rad/(N m)", 0.002),)
    sentence = "the gear twists under torque: the encoder on the motor does not show the link's angle"
    reference = "Spong 1987, quasi-static: below the resonance"
    experiment = "a chirp up to the resonance; static torque steps against a blocked link"
    per_joint = True

    def readings(self, view: View, size: FloatArray) -> dict[str, FloatArray]:
        j = self.joint or 0
        return {f"encoder{j + 1}": size[0] * smoothed(view.torque(j), view)}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if self.joint in actuated else "the joint carries no measured torque"


class Backlash(SensorEffect):
    """The encoder, on the motor, sits at one side or the other of a gap, by the sign of the torque."""

    name = "backlash"
    sizes = (Size("gap", "rad", 0.002),)
    shapes = (Shape("contact_torque", "N m", (0.02, 0.1)),)
    sentence = "the gear has play: the link lies at one or the other side of a gap"
    reference = "Nordin and Gutman 2002"
    experiment = "slow torque reversals across zero with the link held by gravity"
    per_joint = True

    def readings(self, view: View, size: FloatArray) -> dict[str, FloatArray]:
        j = self.joint or 0
        return {f"encoder{j + 1}": 0.5 * size[0] * np.tanh(smoothed(view.torque(j), view) / size[1])}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if self.joint in actuated else "the joint carries no measured torque"


class BaseCompliance(Effect):
    """The stand yields sideways: x_b of M x_b'' + D x_b' + K x_b = -d^2/dt^2 (g1 sin th1 + g2 sin th2).

    Its acceleration enters both equations of motion and the accelerometer; 1/M is the size, the mode the shape.
    """

    name = "base_compliance"
    sizes = (Size("mobility", "1/kg", 0.01),)
    shapes = (Shape("frequency", "Hz", (2.0, 4.0, 7.0, 12.0, 20.0)),)
    sentence = "the stand moves: the pivot is not fixed"
    reference = "one horizontal mode, damping ratio 0.05"
    experiment = "taps on the stand, and a chirp through its mode"
    damping = 0.05

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        m, s = view.mechanism, view.samples
        t = m.transform
        theta, thetad, thetadd = (np.tensordot(t, x, axes=1) for x in (s.q, s.v, s.a))
        gravity = [(k, p.at[0]) for k, p in enumerate(m.parameters) if p.term == "gravity"]
        moment = sum(view.beta[k] * (np.cos(theta[i]) * thetadd[i] - np.sin(theta[i]) * thetad[i] ** 2)
                     for k, i in gravity)
        omega = 2 * np.pi * size[1]
        b, a = bilinear([-1.0, 0.0, 0.0], [1.0, 2 * self.damping * omega, omega**2], 1.0 / view.dt_s)
        base = np.empty(theta.shape[1])
        for where in view.stretches():
            base[where] = lfilter(b, a, np.asarray(moment)[where])
        base *= size[0]
        links = np.zeros_like(s.q)
        for k, i in gravity:
            links[i] = view.beta[k] * np.cos(theta[i]) * base
        torque = t.T @ links
        q1 = s.q[0]
        return Perturbation(view.to_gauss(torque), torque,
                            {"accel_x": base * np.cos(q1), "accel_y": base * np.sin(q1)})

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if any(p.term == "gravity" for p in mechanism.parameters) else "no gravity term in the model"


def smoothed(x: FloatArray, view: View) -> FloatArray:
    """x (N,) averaged over three samples within each stretch: sample noise of a torque is not its twist."""
    out = x.copy()
    for where in view.stretches():
        part = x[where]
        out[where][1:-1] = (part[:-2] + part[1:-1] + part[2:]) / 3.0
    return out
