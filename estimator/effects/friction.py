"""Friction beyond viscous and Coulomb."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import CONSTANT, Points, Shape, Size, StateEffect, TorqueEffect, View
from estimator.model import Mechanism


class StribeckFriction(TorqueEffect):
    """F exp(-|v/vs|^n) sign(v), n = 2 (Gaussian) for most lubricated contacts, 0.5 to 1 for slower decays."""

    name = "stribeck_friction"
    strict = True
    positive = 1
    sizes = (Size("excess_torque", "N m", 0.01),)
    shapes = (Shape("stribeck_velocity", "rad/s", (0.1, 0.2, 0.4, 0.8), 1.25),
              Shape("exponent", "1", (0.5, 1.0, 2.0), discrete=True, default=2.0))
    """Slower than this grid is the smoothing of sign(v), faster is not near standstill."""
    sentence = "friction is higher near standstill than in motion (Stribeck)"
    reference = "Stribeck 1902; Armstrong-Helouvry 1991"
    experiment = "slow reversals: a multisine below 0.3 Hz at small amplitude"
    depends_on = "v"
    plans = ("slow", "steady")

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        return size[0] * np.exp(-(np.abs(at.v[j] / size[1]) ** size[2])) * at.sign[j]

    def level_at_rest(self, size: FloatArray) -> float:
        return float(size[0])


class AsymmetricFriction(TorqueEffect):
    """Extra Coulomb and viscous friction while v > 0: F max(s, 0) + B max(v, 0)."""

    name = "asymmetric_friction"
    equivalence_class = CONSTANT
    distinguishing_size = 1
    sizes = (Size("coulomb_difference", "N m", 0.01), Size("viscous_difference", "N m s/rad", 0.01))
    sentence = "friction differs between the two directions of motion"
    reference = "Janot, Gautier, Brunot 2019 (EMPS)"
    experiment = "constant speed in both directions at several speeds, with rests between"
    depends_on = "v"
    plans = ("steady",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        forward = 0.5 * (1.0 + at.sign[j])
        return size[0] * forward + size[1] * forward * at.v[j]


class LoadDependentFriction(TorqueEffect):
    """F = Fc + mu |tau - F sign(v)|: dry friction grows with the transmitted torque, tau less friction.

    So it is smaller while the motor drives than while it brakes. With a voltage input the load is the inverse dynamics
    of the links. A fit of a torque-driven leg does not converge with that.
    """

    name = "load_dependent_friction"
    strict = True
    positive = 1
    sizes = (Size("load_coefficient", "1", 0.01),)
    sentence = "friction grows with the torque that the joint transmits"
    reference = "Duclusaud, Passault, Padois, Ly 2025"
    experiment = "the same slow motion with two payloads, or under gravity at several angles"
    depends_on = "u"
    plans = ("steady", "ramps")
    by_hand = "record the session a second time with another payload"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j, m = self.joint or 0, view.mechanism
        if m.force_unit == "V":
            links = np.array([p.rigid for p in m.parameters])
            q, v, a = (np.moveaxis(x, 0, -1) for x in (at.q, at.v, at.a))
            load = m.inverse_dynamics(q, v, a, view.beta * links)[..., j]
            return size[0] * np.sqrt(load**2 + 1e-6) * at.sign[j]
        over = at.u[j] * at.sign[j] - view.parameter("coulomb", j)
        load = np.sqrt(over**2 + 1e-6)
        return size[0] * load / (1.0 + np.clip(size[0], -0.9, 0.9) * over / load) * at.sign[j]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if self.joint in actuated else "the joint carries no measured torque"


class QuadraticDrag(TorqueEffect):
    """c v |v|."""

    name = "quadratic_drag"
    positive = 1
    sizes = (Size("drag", "N m s^2/rad^2", 0.001),)
    sentence = "drag grows with the square of the speed"
    reference = "effects of air and churning; quadratic drag law"
    experiment = "a free swing from a large angle, or fast motion at two amplitudes"
    depends_on = "v"
    plans = ("swing",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        v = at.v[self.joint or 0]
        return size[0] * v * np.abs(v)


class FrictionDrift(TorqueEffect):
    """(C (1 - exp(-t / tau)) + D t_run) sign(v): the Coulomb level changes over the session and within each run."""

    name = "friction_drift"
    sizes = (Size("change", "N m", 0.005), Size("change_per_minute_within_runs", "N m", 0.01))
    shapes = (Shape("time_constant", "s", (30.0, 100.0, 300.0)),)
    sentence = "the friction level drifts with time (warming up, running in)"
    reference = "Simoni, Beschi, Legnani, Visioli 2015"
    experiment = "the same run repeated cold and warm, temperature recorded"
    depends_on = "session"
    plans = ()
    by_hand = "record the session twice, cold and warm, with the temperature"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        level = -size[0] * np.expm1(-at.session_s / size[2]) + size[1] * at.time_s / 60.0
        return level * at.sign[self.joint or 0]


class PreslidingFriction(StateEffect):
    """LuGre bristles in place of part of the sign: A (z - sign v) + B (v - |v| z), dz/ds = (sign v - z) / s0.

    The state z lags the sign of the velocity over a displacement s0 along the path s after a reversal. Bristles that
    bend also damp (B): while they do, not in steady sliding.
    """

    name = "presliding_friction"
    strict = True
    positive = 2  # bristles that drove would give back more than they took: a hysteresis that fades does
    defining = 1
    sizes = (Size("level", "N m", 0.01), Size("bristle_damping", "N m s/rad", 0.005))
    shapes = (Shape("displacement", "rad", (0.003, 0.01, 0.03, 0.1), below=1.0),)
    """Shorter is how a reversal falls between two samples."""
    sentence = "after a reversal friction builds up over a displacement, like a spring (presliding)"
    reference = "Dahl 1968; Canudas de Wit et al. 1995 (LuGre)"
    experiment = "micro-motions: sines of a few milliradians about several angles"
    depends_on = "v"
    plans = ("micro", "slow")

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        return size[0] * (at.state - at.sign[j]) + size[1] * (at.v[j] - np.abs(at.v[j]) * at.state)

    def relaxation(self, v: tuple[FloatArray, FloatArray], sign: tuple[FloatArray, FloatArray], size: FloatArray,
                   dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Exact over an interval of constant sign: e = exp(-|dq| / s0)."""
        return np.exp(-0.5 * np.abs(v[1] + v[0]) * dt_s / size[-1]), 0.5 * (sign[1] + sign[0])
