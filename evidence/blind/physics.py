"""A two-link leg hanging from a passive pivot, integrated for many lanes at once.

A lane is one run of one case. The plain leg is Lagrange's equation in the relative angles of docs/formats.md,
written from masses, lengths and inertias (Spong, Robot Modeling and Control, section 7.3, two-link arm with
angles counted from the downward vertical). Smooth forces go through classical RK4. Dry friction is a set-valued
force: its impulse over a step is the solution of a two-contact box problem (Moreau time stepping), so that a
joint really sticks, its law rounded off over a small velocity.

Extra states exist only when a lane asks for them: motor side (elasticity, backlash), LuGre bristles, a base on a
spring, a sloshing inertia, a hysteretic cable. Coefficients of a lane that does not have the effect are zero.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from evidence.blind.friction import DryFriction
from evidence.blind.leg import COEFFICIENTS, GRAVITY, Array, Leg, Rows

SAMPLE_S = 0.01


@dataclass(frozen=True)
class Motion:
    """True motion on the sample grid; every array (N, L)."""

    q1: Array
    q2: Array
    w1: Array
    w2: Array
    a1: Array
    a2: Array
    base_acceleration: Array
    """Of the pivot, horizontal [m/s2]."""
    tilt: Array
    """Of gravity in the plane [rad]."""
    encoder: Array
    """Knee angle at the motor, through the gear [rad]."""
    fast_lanes: NDArray[np.intp]
    fast_time: Array
    fast: Array
    """(q1, w1, a1, base, tilt) of the fast lanes at every step, (T, 5, F)."""

    def pick(self, lanes: NDArray[np.intp]) -> "Motion":
        """Motion of some lanes, without the fast record."""
        return replace(self, **{f.name: getattr(self, f.name)[:, lanes] for f in fields(self)[:9]},
                       fast_lanes=self.fast_lanes[:0], fast_time=self.fast_time[:0], fast=self.fast[:0])


def integrate(leg: Leg, torque: Array, *, extra: Mapping[str, Array | float] | None = None, pivot: Array | None = None,
              start: Array | None = None, session: Array | None = None, step: float = 5e-4,
              fast: NDArray[np.intp] | None = None) -> Motion:
    """Integrate all lanes over the sample grid.

    `torque`, `pivot`: (N, L) torque that acts on knee and pivot at the samples [N m], linear in between.
    `extra`: coefficient name -> (L,). `start`: (4, L) of q1, q2, w1, w2, zero when absent.
    `session`: (L,) time at which a lane's run began within the session [s].
    `fast`: lanes whose motion is kept at every step (for a sensor that is late).
    """
    count, lanes = torque.shape
    leg = leg.lanes(lanes)
    c = {name: np.zeros(lanes) for name in COEFFICIENTS}
    for name, value in (extra or {}).items():
        if name not in c:
            raise KeyError(name)
        c[name] = np.broadcast_to(np.asarray(value, float), (lanes,)).copy()
    substeps = round(SAMPLE_S / step)
    h = SAMPLE_S / substeps
    rows = Rows.plan(c)
    field = Field(leg, c, rows)
    y = np.zeros((rows.count, lanes))
    if start is not None:
        y[:4] = start
        if rows.motor:
            y[rows.motor], y[rows.motor + 1] = start[1], start[3]
    pivot = np.zeros_like(torque) if pivot is None else pivot
    slope, pivot_slope = (np.diff(x, axis=0, append=x[-1:]) / substeps for x in (torque, pivot))
    begin = np.zeros(lanes) if session is None else np.asarray(session, float)
    friction = DryFriction(leg, c, rows, h, begin)
    fast = np.zeros(0, np.intp) if fast is None else np.asarray(fast)
    out = np.empty((9, count, lanes))
    trace = np.empty((count * substeps, 5, fast.size))
    f = np.zeros((2, lanes))
    t = 0.0
    for k in range(count):
        for i in range(substeps):
            u0 = torque[k] + slope[k] * i
            u2 = u0 + slope[k]
            um = u0 + 0.5 * slope[k]
            p0 = pivot[k] + pivot_slope[k] * i
            p2 = p0 + pivot_slope[k]
            pm = p0 + 0.5 * pivot_slope[k]
            k1 = field(y, t, u0, p0, f)
            if i == 0:
                out[:4, k] = y[:4]
                out[4:6, k] = k1[2:4]
                knee = np.where(field.two_mass, y[rows.motor], y[1]) if rows.motor else y[1]
                out[6:, k] = field.base, field.tilt, knee
            if fast.size:
                trace[k * substeps + i] = y[0, fast], y[2, fast], k1[2, fast], field.base[fast], field.tilt[fast]
            k2 = field(y + (0.5 * h) * k1, t + 0.5 * h, um, pm, f)
            k3 = field(y + (0.5 * h) * k2, t + 0.5 * h, um, pm, f)
            k4 = field(y + h * k3, t + h, u2, p2, f)
            k2 += k3
            k2 *= 2.0
            k2 += k1
            k2 += k4
            y += (h / 6.0) * k2
            t += h
            f = friction(y, t, u2, f, field.inverse)
    q1, q2, w1, w2, a1, a2, base, tilt, encoder = out
    return Motion(q1, q2, w1, w2, a1, a2, base, tilt, encoder, fast, np.arange(count * substeps) * h, trace)


Force = Callable[[Array], tuple[Array | float, Array | float]]
"""State -> torques at pivot and knee."""


class Field:
    """The smooth part of the equations of motion; keeps the inverse inertia of its last call."""

    def __init__(self, leg: Leg, c: dict[str, Array], rows: Rows) -> None:
        self.leg, self.c, self.rows = leg, c, rows
        self.b1, self.b2, self.b3, self.b4, self.b5 = leg.beta()[:5]
        self.g4, self.g5 = GRAVITY * self.b4, GRAVITY * self.b5
        self.base, self.tilt = np.zeros((2, self.b4.size))
        self.two_mass = c["shaft"] > 0
        # a geared rotor carried by link 1 turns with q1d + gear*q2d: its energy fills three entries of M
        geared = c["rotor"] > 0
        ratio = np.where(geared, c["gear"], 1.0)
        self.m11 = self.b1 + self.b2 + np.where(geared, c["rotor"] / ratio**2, 0.0)
        self.m12 = self.b2 + np.where(geared, c["rotor"] / ratio, 0.0)
        self.m22 = self.b2 + c["rotor"]
        self.on = {name: bool(value.any()) for name, value in c.items()}
        laws: dict[tuple[str, ...], Force] = {
            ("drag1", "drag2"): lambda y: (-c["drag1"] * y[2] * np.abs(y[2]), -c["drag2"] * y[3] * np.abs(y[3])),
            ("spring1", "spring2"): lambda y: (-c["spring1"] * (y[0] - c["spring_rest1"]),
                                               -c["spring2"] * (y[1] - c["spring_rest2"])),
            ("bristle2",): self._bristle, ("stop_stiffness",): self._stop, ("slosh",): self._slosh,
            # Bouc-Wen hysteresis of a cable bundle around the pivot, with the bundle's own stiffness
            ("cable",): lambda y: (-c["cable"] * (y[rows.cable] + 0.5 * y[0]), 0.0),
            ("cross_damping",): lambda y: (-c["cross_damping"] * y[3], 0.0),
            ("asymmetric_drag2",): lambda y: (0.0, -c["asymmetric_drag2"] * np.maximum(y[3], 0.0))}
        self.forces = [law for names, law in laws.items() if any(self.on[name] for name in names)]
        self.base_lanes = c["base_mass"] > 0
        mass = c["base_mass"] + leg.m1 + leg.m2
        self.base_inverse = np.where(self.base_lanes, 1.0 / mass, 0.0)
        # LuGre bristles that carry the knee's Coulomb level
        has = c["bristle2"] > 0
        deflection = np.where(has, c["bristle2"], 1.0)
        self.bristle_stiffness = np.where(has, leg.coulomb2 / deflection, 0.0)
        self.bristle_damping = 0.6 * np.sqrt(self.bristle_stiffness * self.b2 * 0.3)
        self.bristle_slip = np.where(has, 1.0 / deflection, 0.0)

    def _bristle_rate(self, y: Array) -> Array:
        return y[3] - np.abs(y[3]) * y[self.rows.bristle2] * self.bristle_slip

    def _bristle(self, y: Array) -> tuple[float, Array]:
        """LuGre (Canudas de Wit 1995): z' = v - |v| z / z_full, torque = s0 z + s1 z'."""
        return 0.0, -self.bristle_stiffness * y[self.rows.bristle2] - self.bristle_damping * self._bristle_rate(y)

    def _stop(self, y: Array) -> tuple[float, Array]:
        """Hertz-like contact with Hunt-Crossley damping: k d^1.5 (1 + c d')."""
        c = self.c
        depth = np.maximum(c["stop_side"] * (y[1] - c["stop_angle"]), 0.0)
        force = c["stop_stiffness"] * depth * np.sqrt(depth)
        return 0.0, -c["stop_side"] * force * np.maximum(1.0 + c["stop_damping"] * c["stop_side"] * y[3], 0.0)

    def _slosh(self, y: Array) -> tuple[Array, Array]:
        """A balanced inertia on a spring turns on link 2; its reaction acts on that link's absolute angle."""
        row = self.rows.slosh
        reaction = self.c["slosh_stiffness"] * y[row] + self.c["slosh_damping"] * y[row + 1]
        return reaction, reaction

    def __call__(self, y: Array, t: float, torque: Array, pivot: Array, f: Array) -> Array:
        """State rates (rows, L); `f` (2, L) are the dry friction torques held over the step."""
        c, rows = self.c, self.rows
        q1, q2, w1, w2 = y[:4]
        up = q1
        if self.on["tilt"]:
            self.tilt = c["tilt"] * (np.sin(c["tilt_rate"] * t + c["tilt_phase"]) - np.sin(c["tilt_phase"]))
            up = q1 + self.tilt
        s1, c1, s2, c2 = np.sin(up), np.cos(up), np.sin(q2), np.cos(q2)
        lower = self.g5 * (s1 * c2 + c1 * s2)
        b3c = self.b3 * c2
        b3s = self.b3 * s2
        m11 = self.m11 + 2.0 * b3c
        m12 = self.m12 + b3c
        m22 = self.m22
        r1 = pivot + f[0] - self.leg.viscous1 * w1 - self.g4 * s1 - lower + b3s * w2 * (2.0 * w1 + w2)
        knee = torque + f[1]
        if self.on["ripple"]:
            shaft_angle = q2 if not rows.motor else np.where(self.two_mass, y[rows.motor], q2)
            phase = c["ripple_order"] * c["gear"] * shaft_angle + c["ripple_phase"]
            knee = knee + c["ripple"] * (np.sin(phase) + 0.3 * np.sin(2.0 * phase + 0.7))
        rates = np.empty_like(y)
        if rows.motor:
            motor, speed = y[rows.motor], y[rows.motor + 1]
            twist = motor - q2
            through = self._shaft(twist, speed - w2)
            drive = knee - self.leg.viscous2 * speed
            inertia = np.where(self.two_mass, c["motor_inertia"], 1.0)
            rates[rows.motor] = np.where(self.two_mass, speed, 0.0)
            rates[rows.motor + 1] = np.where(self.two_mass, (drive - through) / inertia, 0.0)
            knee = np.where(self.two_mass, through, knee - self.leg.viscous2 * w2)
        else:
            knee = knee - self.leg.viscous2 * w2
        r2 = knee - lower - b3s * w1 * w1
        for law in self.forces:
            e1, e2 = law(y)
            r1 += e1
            r2 += e2
        if rows.base:
            angle = q1 + q2
            c12 = self.b5 * np.cos(angle)
            u1 = self.b4 * np.cos(q1) + c12
            w12 = w1 + w2
            push = (-c["base_stiffness"] * y[rows.base] - c["base_damping"] * y[rows.base + 1]
                    + self.b4 * np.sin(q1) * w1 * w1 + self.b5 * np.sin(angle) * w12 * w12)
            inv = self.base_inverse
            m11 = m11 - u1 * u1 * inv
            m12 = m12 - u1 * c12 * inv
            m22 = m22 - c12 * c12 * inv
            r1 = r1 - u1 * push * inv
            r2 = r2 - c12 * push * inv
        idet = 1.0 / (m11 * m22 - m12 * m12)
        a1 = (m22 * r1 - m12 * r2) * idet
        a2 = (m11 * r2 - m12 * r1) * idet
        rates[:4] = w1, w2, a1, a2
        self.inverse = (m22 * idet, -m12 * idet, m11 * idet)
        if rows.base:
            self.base = (push - u1 * a1 - c12 * a2) * inv
            rates[rows.base] = y[rows.base + 1]
            rates[rows.base + 1] = self.base
        if rows.bristle2:
            rates[rows.bristle2] = self._bristle_rate(y)
        if rows.slosh:
            has = c["slosh"] > 0
            reaction = c["slosh_stiffness"] * y[rows.slosh] + c["slosh_damping"] * y[rows.slosh + 1]
            rates[rows.slosh] = y[rows.slosh + 1]
            rates[rows.slosh + 1] = np.where(has, -reaction / np.where(has, c["slosh"], 1.0) - a1 - a2, 0.0)
        if rows.cable:
            has = c["cable"] > 0
            z, width = y[rows.cable], np.where(has, c["cable_yield"], 1.0)
            rates[rows.cable] = np.where(has, (w1 - 0.5 * np.abs(w1) * z * np.abs(z) - 0.5 * w1 * z * z) / width, 0.0)
        return rates

    def _shaft(self, twist: Array, rate: Array) -> Array:
        """Torque through shaft and gear: a spring with a dead zone of width `gap`, damped only in contact."""
        half = 0.5 * self.c["gap"]
        wound = twist - np.clip(twist, -half, half)
        touching = (wound != 0.0) | (half == 0.0)
        return self.c["shaft"] * wound + np.where(touching, self.c["shaft_damping"] * rate, 0.0)
