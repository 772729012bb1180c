"""`BaseCompliance`: the stand on which the pivot sits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.effects.base import BodyEffect, Perturbation, Shape, Size, View
from estimator.model import Mechanism, Parameter
from estimator.signals import GYRO, Channel, causal, imu_channels, total

FAR = 1000.0
"""Metres of the base's motion for a radian of the body that stands for it in a simulation."""
FIRM = 1e-9
"""Mobility [1/kg] of a stand that does not yield: its mass is finite."""
SECOND, FIRST, NONE = np.array([1.0, -2.0, 1.0]), np.array([1.0, 0.0, -1.0]), np.array([1.0, 2.0, 1.0])
"""(s / k)^2, s / k and 1, times (1 + 1/z)^2, of s = k (1 - 1/z) / (1 + 1/z), the bilinear transform with k = 2 / dt
(Oppenheim and Schafer, section 7.2)."""


class BaseCompliance(BodyEffect):
    """The stand yields sideways: x of M x'' + D x' + K x = -p', p = g1 cos th1 th1' + g2 cos th2 th2'.

    Its acceleration enters all equations of motion, g_i cos th_i x'' at link i, and the accelerometer. 1/M is the size,
    mode omega and damping zeta the shapes. In a record p is differenced from rates, not taken from the equations of
    motion: through them it would feel itself, and near its resonance that loop's gain is above one. In a simulation
    the base is a body of its own.
    """

    name = "base_compliance"
    positive = 1
    sizes = (Size("mobility", "1/kg", 0.01, tolerance=0.002),)
    shapes = (Shape("frequency", "Hz", (1.5, 2.0, 2.7, 3.6, 4.9, 6.6, 9.0, 12.0, 16.0, 20.0)),
              Shape("damping_ratio", "1", (0.1,)))
    sentence = "the stand moves: the pivot is not fixed"
    reference = "one horizontal mode"
    tolerance_source = "a stand clamped to a table of several hundred kilograms"
    experiment = "taps on the stand, and a chirp through its mode"
    plans = ("fast",)
    by_hand = "tap the stand in one run"

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        t = view.mechanism.transform
        lever, momentum = self._momentum(view, self._rates(view))
        k = 2.0 / view.dt_s
        driven = [differenced(momentum[where], view.dt_s) for where in view.segments()]
        base = size[0] * _filtered(driven, -k * k * SECOND, k, size)
        torque = t.T @ (lever * base)
        felt: dict[Channel, FloatArray] = {}
        for k, place in enumerate(view.mechanism.imus):
            along = total(view.samples.q, view.mechanism.joints_to(place.link))
            felt |= dict(zip(imu_channels(k)[1:], (base * np.cos(along), base * np.sin(along))))
        return Perturbation(view.to_gauss(torque), torque, felt)

    def body(self, mechanism: Mechanism, beta: FloatArray, size: FloatArray) -> tuple[Mechanism, FloatArray]:
        """The base as a link that turns by b = x / FAR, so little that cos(th_i - b) is cos th_i and sin b is b: then
        the terms of links are those of a sliding mass on a spring."""
        n, omega, mass = mechanism.n, 2 * np.pi * size[1], FAR**2 / (size[0] or FIRM)
        transform = np.eye(n + 1)
        transform[:n, :n] = mechanism.transform
        terms: list[tuple[str, tuple[int, ...], float]] = [
            ("inertia", (n, n), mass), ("viscous", (n,), 2.0 * size[2] * omega * mass),
            ("gravity", (n,), omega**2 * mass / mechanism.gravity)]
        terms += [("inertia", (i, n), FAR * g) for i, g in enumerate(_moments(mechanism, beta)) if g]
        parameters = [Parameter(f"{self.name}_{k}", self.sentence, "", *term[:2]) for k, term in enumerate(terms)]
        whole = replace(mechanism, transform=transform, parameters=(*mechanism.parameters, *parameters),
                        zero=(*mechanism.zero, 0.0) if mechanism.zero else (),
                        velocity_scale=(*mechanism.velocity_scales, 1.0))
        return whole, np.concatenate([beta, [value for *_, value in terms]])

    def body_motion(self, view: View, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """-s p and -s^2 p over M (s^2 + 2 zeta omega s + omega^2), from rest at the start of each segment."""
        momentum, k = self._momentum(view, view.samples.v)[1], 2.0 / view.dt_s
        gained = [momentum[where] - momentum[where.start] for where in view.segments()]
        share = size[0] / FAR
        return share * _filtered(gained, -k * FIRST, k, size), share * _filtered(gained, -k * k * SECOND, k, size)

    def _momentum(self, view: View, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """g_i cos th_i of each link (n, N) and p (N,) at joint rates (n, N)."""
        t = view.mechanism.transform
        lever = _moments(view.mechanism, view.beta)[:, None] * np.cos(view.mechanism.from_zero(t @ view.samples.q))
        return lever, np.asarray((lever * (t @ rates)).sum(axis=0))

    def _rates(self, view: View) -> FloatArray:
        """(n, N) joint rates, the pivot's as the gyro saw it where there is a record.

        The pivot's fitted rate follows the equation of motion, and through that the base: fits went round in circles.
        The gyro's noise would act as torque noise, so it comes low-passed.
        """
        if view.measured is None or GYRO not in view.measured.slow or view.mechanism.imus[0].link > 0:
            return view.samples.v
        return np.concatenate([view.measured.slow[GYRO][None], view.samples.v[1:]])

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if any(p.term == "gravity" for p in mechanism.parameters) else "no gravity term in the model"


def _moments(mechanism: Mechanism, beta: FloatArray) -> FloatArray:
    """(n,) g_i of each link; zero where the model has none."""
    out = np.zeros(mechanism.n)
    for value, p in zip(beta, mechanism.parameters):
        if p.term == "gravity":
            out[p.at[0]] += value
    return out


def _filtered(parts: list[FloatArray], numerator: FloatArray, k: float, size: FloatArray) -> FloatArray:
    """Each part, from rest, through numerator / (s^2 + 2 zeta omega s + omega^2)."""
    omega = 2 * np.pi * size[1]
    denominator = k * k * SECOND + 2.0 * size[2] * omega * k * FIRST + omega**2 * NONE
    return np.concatenate([causal(part, numerator, denominator) for part in parts])


def differenced(x: FloatArray, dt_s: float) -> FloatArray:
    """Derivative of x (N,) by central differences of fourth order, of second order at the ends."""
    out = np.gradient(x, dt_s, edge_order=2)
    out[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * dt_s)
    return out
