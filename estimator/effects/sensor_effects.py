"""Bases of effects on what the IMU, an encoder or the torque's sensor reads."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.effects.base import Joined, Perturbation, SensorEffect, Shape, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion
from estimator.model import Mechanism
from estimator.signals import Channel, encoder_of, total

NO_ENCODER = "this joint has no encoder on this path"
TRIED = 361
"""Angles of a turn at which an encoder's error is looked at."""
STEP_RAD = 1e-3
"""Of differences of an encoder's error by the angle."""


class ImuEffect(SensorEffect):
    """Base: needs the IMU path."""

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if has_imu else "no IMU on this path"

    @staticmethod
    def link_rate(view: View) -> FloatArray:
        """(N,) absolute rate of the first IMU's link at the samples."""
        return total(view.samples.v, view.mechanism.joints_to(view.mechanism.imus[0].link))


class EncoderEffect(SensorEffect, LoopEffect):
    """Base: the joint's own encoder reads wrong.

    Behind a position loop without a measured torque, the record has the input that the law makes of the logged angle.
    Two faults are possible, and the shape `heard_by_loop` says which. At 1 the encoder is wrong, so that loop and log
    have the same wrong angle. At 0 the log alone is wrong, and the loop hears the true angle.
    """

    per_joint = True
    per_loop = False
    depends_on = "q"
    loop_shapes = (Shape("heard_by_loop", "1", (1.0, 0.0), discrete=True, default=1.0),)
    in_log = "the logged angle is wrong, and the loop hears the true one"
    """`sentence` where the log alone is wrong."""

    def __init__(self, joint: int | None = None, slide: bool = False, by_law: bool = False) -> None:
        super().__init__(joint, slide)
        if by_law:
            self.shapes = self.loop_shapes

    @property
    def parts(self) -> tuple[Joined, ...]:
        return (self,) if self.shapes else ()

    def meaning(self, shape: tuple[float, ...]) -> str:
        """Sentence that says, behind a loop, whether the encoder is wrong or the log alone."""
        if not shape:
            return self.sentence
        return f"{self.sentence}, and the loop hears it" if _is_heard(shape) else self.in_log

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        readings = self.readings(view, size)
        if not self.shapes:
            return Perturbation(readings=readings)
        return replace(LoopEffect.perturb(self, view, size), readings=readings)

    def _lacking(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        """Input by the law as the model has it, less the one that acts.

        The model has that of the logged angle, or in a closed loop that of the true one.
        """
        heard = _is_heard(size)
        if heard != commanded.closed:
            return np.zeros_like(motion[0])
        more = self.acting(commanded, motion, size, view) - commanded.input(*motion)
        return -more if heard else more

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        """(m, ...) input of a loop that hears the wrong angle."""
        q, v, a = motion
        below, at, above = (self.error(q + by, size) for by in (-STEP_RAD, 0.0, STEP_RAD))
        slope, curve = (above - below) / (2.0 * STEP_RAD), (above - 2.0 * at + below) / STEP_RAD**2
        return commanded.input(q + at, (1.0 + slope) * v, (1.0 + slope) * a + curve * v**2)

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


def _is_heard(size: Sequence[float] | FloatArray) -> bool:
    return bool(size[-1] > 0.5)


class TorqueSensorEffect(SensorEffect):
    """Base of what is wrong with the measured torque; without a joint it acts on every driven joint alike."""

    per_joint = False

    def shown_at(self, mechanism: Mechanism) -> int:
        return mechanism.actuated[-1] if self.joint is None else self.joint

    def driven(self, view: View) -> list[int]:
        return list(view.mechanism.actuated) if self.joint is None else [self.joint]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if actuated else "no joint carries a measured torque"
