"""Bases of effects on what the IMU, an encoder or the torque's sensor reads."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from daq import FloatArray
from estimator.effects.base import SensorEffect, View
from estimator.model import Mechanism
from estimator.signals import Channel, encoder_of, total

NO_ENCODER = "this joint has no encoder on this path"
TRIED = 361
"""Angles of a turn at which an encoder's error is looked at."""


class ImuEffect(SensorEffect):
    """Base: needs the IMU path."""

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if has_imu else "no IMU on this path"

    @staticmethod
    def link_rate(view: View) -> FloatArray:
        """(N,) absolute rate of the first IMU's link at the samples."""
        return total(view.samples.v, view.mechanism.joints_to(view.mechanism.imus[0].link))


class EncoderEffect(SensorEffect):
    """Base: the joint's own encoder reads wrong."""

    per_joint = True

    @abstractmethod
    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        """Error (N,) at angle q (N,) [rad]."""

    def possible(self, size: FloatArray) -> bool:
        """Whether the reading grows with the angle: one that turns back is another angle's, not this encoder's error.
        """
        turn = np.linspace(-np.pi, np.pi, TRIED)
        return bool(np.all(np.diff(turn + self.error(turn, size)) > 0.0))

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        j = self.joint or 0
        return {encoder_of(j): self.error(view.samples.q[j], size)}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return NO_ENCODER if has_imu and self.joint == 0 else ""


class TorqueSensorEffect(SensorEffect):
    """Base of what is wrong with the measured torque; without a joint it acts on every driven joint alike."""

    per_joint = False

    def shown_at(self, mechanism: Mechanism) -> int:
        return mechanism.actuated[-1] if self.joint is None else self.joint

    def driven(self, view: View) -> list[int]:
        return list(view.mechanism.actuated) if self.joint is None else [self.joint]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if actuated else "no joint carries a measured torque"
