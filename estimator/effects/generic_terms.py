"""Generic terms: residuals that no effect of the library explains, as functions of the state.

They test whether the residual is white. A verdict is accepted only if neither a listed effect nor a generic term is
significant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from daq import FloatArray
from estimator.effects.base import Effect, Perturbation, Points, Size, TorqueEffect, View
from estimator.model import Mechanism
from estimator.signals import IMU_CHANNELS, Channel, encoder_of

Law = Callable[[Points, int], FloatArray]
Reading = Callable[[View], FloatArray]

TORQUE_LAWS: dict[str, Law] = {
    "cos q": lambda at, j: np.cos(at.q[j]),
    "q^3": lambda at, j: at.q[j] ** 3,
    "v^2": lambda at, j: at.v[j] ** 2,
    "v^3": lambda at, j: at.v[j] ** 3,
    "q v": lambda at, j: at.q[j] * at.v[j],
    "q^2 v": lambda at, j: at.q[j] ** 2 * at.v[j],
    "q sign v": lambda at, j: at.q[j] * at.sign[j],
    "|q| sign v": lambda at, j: np.abs(at.q[j]) * at.sign[j],
    "slow v": lambda at, j: at.v[j] * np.exp(-((at.v[j] / 0.5) ** 2)),
    "other's v": lambda at, j: at.v[1 - j] if len(at.v) > 1 else at.v[j] ** 5,
    "other's sign": lambda at, j: at.sign[1 - j] if len(at.v) > 1 else at.v[j] ** 4,
    "other's q": lambda at, j: at.q[1 - j] if len(at.v) > 1 else at.q[j] ** 2,
    "time": lambda at, j: at.time_s + 0.0 * at.q[j],
    "session": lambda at, j: at.session_s + 0.0 * at.q[j],
    "session sign v": lambda at, j: at.session_s * at.sign[j] * 0.01,
    "u^2": lambda at, j: at.u[-1] ** 2,
    "low u": lambda at, j: np.tanh(at.u[-1] / 0.1),
    "a^2": lambda at, j: at.a[j] ** 2 * 0.01,
}
WAVES = (2, 4, 8)
"""Per rad: what depends on the angle is resolved to about 0.4 rad, as a force and as friction."""


def _wave(k: int, turned: bool, rubs: bool) -> Law:
    wave = np.cos if turned else np.sin
    return lambda at, j: wave(k * at.q[j]) * (at.sign[j] if rubs else 1.0)


TORQUE_LAWS |= {f"{'cos' if turned else 'sin'} {k}q{' sign v' if rubs else ''}": _wave(k, turned, rubs)
                for k in WAVES for turned in (False, True) for rubs in (False, True)}
READINGS: dict[str, Reading] = {
    "q1": lambda v: v.samples.q[0], "v1": lambda v: v.samples.v[0], "a1": lambda v: v.samples.a[0],
    "v1^2": lambda v: v.samples.v[0] ** 2, "u": lambda v: v.samples.u[-1], "q2": lambda v: v.samples.q[-1],
    "v2": lambda v: v.samples.v[-1], "a2": lambda v: v.samples.a[-1], "u^2": lambda v: v.samples.u[-1] ** 2,
    "q1^2": lambda v: v.samples.q[0] ** 2, "time": lambda v: v.samples.time_s,
    "sign v1": lambda v: v.samples.sign[0], "v1^3": lambda v: v.samples.v[0] ** 3,
    "|q2|": lambda v: np.abs(v.samples.q[-1]), "q2^3": lambda v: v.samples.q[-1] ** 3,
}


TOLERANCES = {"gyro": 0.003, "accel_x": 0.01, "accel_y": 0.01, "encoder": 2e-4}
"""Kind of channel -> standard deviation of a generic term in it [SI]: about the noise of one sample."""


class GenericTorque(TorqueEffect):
    """size * law(motion) on one joint."""

    sizes = (Size("size", "N m", 0.01, tolerance=0.0015),)
    sentence = reference = experiment = ""

    def __init__(self, joint: int, label: str, law: Law) -> None:
        super().__init__(joint)
        self.label, self._law = label, law

    name = "unnamed_torque"

    @property
    def key(self) -> str:
        return f"{self.label}@{(self.joint or 0) + 1}"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * self._law(at, self.joint or 0)

    def felt(self, count: int) -> Iterable[int]:
        return range(count)


class GenericReading(Effect):
    """size * law(motion) on one sensor."""

    sizes = (Size("size", "1", 0.01),)
    sentence = reference = experiment = ""
    name = "unnamed_reading"

    def __init__(self, channel: Channel, label: str, law: Reading) -> None:
        super().__init__(None)
        self.channel, self.label, self._law = channel, label, law
        self.sizes = (self.sizes[0]._replace(tolerance=TOLERANCES[channel.kind]),)  # type: ignore[misc]

    @property
    def key(self) -> str:
        return f"{self.label} in {self.channel}"

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        return Perturbation(readings={self.channel: size[0] * self._law(view)})


def battery(mechanism: Mechanism, has_imu: bool, encoders: Sequence[int] | None = None) -> list[Effect]:
    """All generic terms that this rig can test; `encoders` as for `library`."""
    effects: list[Effect] = [GenericTorque(j, label, law) for j in range(mechanism.n)
                             for label, law in TORQUE_LAWS.items()]
    readable = range(mechanism.n) if encoders is None else encoders
    channels = [*IMU_CHANNELS, *map(encoder_of, readable[-1:])] if has_imu else [encoder_of(j) for j in readable]
    effects += [GenericReading(c, label, law) for c in channels for label, law in READINGS.items()]
    return effects
