"""Springs, inertias, play and stops."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from daq import FloatArray
from estimator.effects.base import (
    CONSTANT,
    Effect,
    Perturbation,
    Points,
    Shape,
    Size,
    TorqueEffect,
    View,
)
from estimator.model import Mechanism, smooth_sign
from estimator.signals import Channel, encoder_of, torque_of


class JointStiffness(TorqueEffect):
    """k q - c: a spring at the joint, c = k q0 its torque at the zero angle."""

    name = "joint_stiffness"
    equivalence_class = CONSTANT
    distinguishing_size = 0
    positive = 1
    sizes = (Size("stiffness", "N m/rad", 0.05), Size("preload", "N m", 0.01))
    sentence = "a spring acts at the joint (cable, seal, hose)"
    reference = "linear spring"
    experiment = "static holds over the whole range of the joint"
    plans = ("ramps",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * at.q[self.joint or 0] - size[1]


class RotorInertia(TorqueEffect):
    """J q2dd: the geared rotor, felt in its own joint's equation only."""

    name = "rotor_inertia"
    positive = 1
    sizes = (Size("inertia", "kg m^2", 0.001),)
    sentence = "the motor's rotor adds inertia at its joint (gear ratio squared)"
    reference = "Spong 1987"
    experiment = "fast motion of the joint with the other one at large and small speed"
    depends_on = "a"
    plans = ("fast",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * at.a[self.joint or 0]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if any(p.term == "rotor" and p.at == (self.joint,) for p in mechanism.parameters):
            return "declared in the rig: it is a parameter of the nominal model"
        return "" if self.joint in actuated and mechanism.n > 1 else "no motor at this joint, or inertia absorbs it"


class EndStopContact(TorqueEffect):
    """k max(q - q0, 0), smoothed: a one-sided spring beyond the angle q0; q0 < 0 is a stop on the other side."""

    name = "end_stop_contact"
    positive = 1
    sizes = (Size("stiffness", "N m/rad", 0.5),)
    shapes = (Shape("angle_share", "1", (-0.9, -0.8, -0.65, 0.65, 0.8, 0.9), above=1.1, below=1.3),)
    strict = True
    """A stop that begins before half of the range is a hardening spring. One at its very end is never touched: there
    the smoothed law adds a constant torque."""
    sentence = "the joint touches a stop at the end of its range"
    reference = "Hunt and Crossley 1975 (linearised)"
    experiment = "slow approach to both ends of the range"
    plans = ("ramps",)
    by_hand = "approach the stops by hand: a plan keeps away from them"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        q = at.q[j]
        side = np.sign(size[1])
        reach = abs(view.angle_range[j, 1 if side > 0 else 0])
        depth = side * q - abs(size[1]) * reach
        smoothed = 0.5 * (depth + np.sqrt(depth * depth + 1e-6))
        return size[0] * side * smoothed


MOTOR = (Size("motor_viscous", "N m s/rad", 0.005, 0.05), Size("motor_coulomb", "N m", 0.01, 0.1),
         Size("motor_inertia", "kg m^2", 1e-4, 0.003))


class GearEffect(Effect):
    """A gear whose encoder is on the motor: it reads the link plus the gear's twist under the torque through it.

    Friction and inertia of the motor act on its own side, whose motion a record shows: there the torque latent is what
    comes through the gear, and the motor's torque that, friction at the encoder's rate and the inertia's share at its
    acceleration. Without a record, both act at the link's rate.
    """

    per_joint = True
    instant = True
    defining = 1

    @abstractmethod
    def twist(self, through: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) encoder less link [rad] under the torque `through` the gear (N,), and its derivative by that."""

    def motor(self, size: FloatArray) -> FloatArray:
        """Viscous, Coulomb and inertia of the motor's side."""
        return size[len(self.sizes) - len(MOTOR) : len(self.sizes)]

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        j = self.joint or 0
        s = view.samples
        if view.measured is not None:
            return Perturbation(readings={torque_of(j): self.drive_loss(view, size)[j],
                                          encoder_of(j): self.twist(s.u[j], size)[0]})
        friction = view.parameter("viscous", j) * s.v[j] + view.parameter("coulomb", j) * s.sign[j]
        gauss, samples = np.zeros_like(view.gauss.a), np.zeros_like(s.a)
        gauss[j], samples[j] = self.law(view.gauss, size, view), self.law(s, size, view)
        return Perturbation(gauss, samples, {encoder_of(j): self.twist(s.u[j] - friction - samples[j], size)[0]})

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return np.asarray(self.motor(size)[2] * at.a[self.joint or 0])

    def simulated(self, beta: FloatArray, size: FloatArray, mechanism: Mechanism) -> FloatArray:
        out = beta.copy()
        for value, term in zip(self.motor(size), ("viscous", "coulomb")):
            for i, p in enumerate(mechanism.parameters):
                if p.at == (self.joint or 0,) and p.term == term:
                    out[i] += value
        return out

    def by_torque(self, view: View, size: FloatArray) -> Mapping[Channel, FloatArray]:
        j = self.joint or 0
        return {encoder_of(j): self.twist(view.samples.u[j], size)[1]}

    def drive_loss(self, view: View, size: FloatArray) -> Mapping[int, FloatArray]:
        j = self.joint or 0
        if view.measured is None:
            return {}
        rate = view.measured.rate[j]
        viscous, coulomb, inertia = self.motor(size)
        return {j: viscous * rate + coulomb * smooth_sign(rate, view.mechanism.velocity_scales[j])
                + inertia * view.measured.acceleration[j]}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if mechanism.n == 1 and not has_imu:
            return "nothing but the encoder on its motor sees this joint"
        return "" if self.joint in actuated else "the joint carries no measured torque"


class JointElasticity(GearEffect):
    """reading = q + T / k: the gear twists under the torque T through it."""

    name = "joint_elasticity"
    positive = 1
    sizes = (Size("compliance", "rad/(N m)", 0.002), *MOTOR)
    sentence = "the gear twists under torque: the encoder on the motor does not show the link's angle"
    reference = "Spong 1987, quasi-static: below the motor's resonance"
    experiment = "a chirp up to the resonance; static torque steps against a blocked link"
    depends_on = "u"
    plans = ("fast",)
    by_hand = "add torque steps against a blocked link"

    def twist(self, through: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        return size[0] * through, np.full_like(through, size[0])


class Backlash(GearEffect):
    """reading = q + (gap / 2) tanh(T / T_c): the link lies at one side of the gap, by the torque T through it."""

    name = "backlash"
    positive = 1
    sizes = (Size("gap", "rad", 0.002), *MOTOR)
    shapes = (Shape("contact_torque", "N m", (0.06, 0.1, 0.2), below=16.0),)
    sentence = "the gear has play: the link lies at one or the other side of a gap"
    reference = "Nordin and Gutman 2002"
    experiment = "slow torque reversals across zero with the link held by gravity"
    depends_on = "u"
    plans = ("slow", "ramps")

    def relaxed(self, size: FloatArray, slack: float) -> FloatArray:
        contact = abs(size[-1])
        return np.append(size[:-1], max(contact, min(slack * contact, max(self.shapes[0].grid))))

    def twist(self, through: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        side = np.tanh(through / size[-1])
        return 0.5 * size[0] * side, 0.5 * size[0] / size[-1] * (1.0 - side**2)
