"""`GearEffect`: base of what a gear does between the encoder on its motor and the link."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from daq import FloatArray
from estimator.effects.base import LawEffect, Perturbation, Points, Size, View
from estimator.model import Mechanism, smooth_sign
from estimator.signals import Channel, encoder_of, torque_of

MOTOR = (Size("motor_viscous", "N m s/rad", 0.005, 0.05, 0.003), Size("motor_coulomb", "N m", 0.01, 0.1, 0.003),
         Size("motor_inertia", "kg m^2", 1e-4, 0.003, 1e-4))


class GearEffect(LawEffect):
    """A gear whose encoder is on the motor: it reads the link plus the gear's twist under the torque through it.

    Friction and inertia of the motor act on its own side, whose motion a record shows. With a record the torque latent
    is what comes through the gear. The motor's torque is that, friction at the encoder's rate and the inertia's share
    at its acceleration. A simulation has no record: the torque latent is the motor's, and both act at the link's rate.
    """

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
        """beta (p,) of a simulation without a record, friction of the motor's side included."""
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
        """Joint to the motor's torque (N,) beyond the torque latent; empty without a record."""
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
