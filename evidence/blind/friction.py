"""Dry friction of both joints as a set-valued force, solved implicitly over each step."""

import numpy as np

from evidence.blind.leg import Array, Leg, Rows

CREEP_RADPS = 1e-3
"""Over which the law is rounded off."""


class DryFriction:
    """Set-valued friction at both joints: the torque over the step that makes its end obey the law."""

    def __init__(self, leg: Leg, c: dict[str, Array], rows: Rows, h: float, begin: Array) -> None:
        self.c, self.rows, self.h, self.begin = c, rows, h, begin
        self.level1 = np.asarray(leg.coulomb1)
        self.level2 = np.where(c["bristle2"] > 0, 0.0, leg.coulomb2)
        self.on = {name: bool(value.any()) for name, value in c.items()}
        self.two_mass = c["shaft"] > 0
        self.plain = not any(self.on[name] for name in (
            "stribeck2", "asymmetry2", "load2", "warmup", "angle_friction"))
        self.none = self.plain and not self.level1.any() and not self.level2.any()

    def _knee_level(self, y: Array, t: float, torque: Array, f: Array) -> Array:
        c, on, level2 = self.c, self.on, self.level2
        speed2 = y[3] if not self.rows.motor else np.where(self.two_mass, y[self.rows.motor + 1], y[3])
        if on["stribeck2"]:
            scale = np.where(c["stribeck2"] != 0, c["stribeck_velocity2"], 1.0)
            level2 = level2 + c["stribeck2"] / (1.0 + (speed2 / scale) ** 2)
        if on["load2"]:
            # what the gear passes on: the motor's torque less what friction took
            level2 = level2 + c["load2"] * np.sqrt((torque + f[1]) ** 2 + 1e-4)
        if on["warmup"]:
            span = np.where(c["warmup"] != 0, c["warmup_time"], 1.0)
            level2 = level2 + c["warmup"] * np.exp(-(self.begin + t) / span)
        if on["angle_friction"]:
            level2 = level2 + c["angle_friction"] * np.cos(c["angle_order"] * y[1] + c["angle_phase"])
        return np.maximum(level2, 0.0)

    def __call__(self, y: Array, t: float, torque: Array, f: Array,
                 inverse: tuple[Array, Array, Array]) -> Array:
        """Correct the velocities of `y` in place and give the torques (2, L) that acted."""
        if self.none:
            return f
        h = self.h
        level1, level2 = self.level1, self.level2 if self.plain else self._knee_level(y, t, torque, f)
        a11, a12, a22 = inverse
        motor = self.rows.motor
        v2 = y[3]
        coupling = a12
        if motor:
            v2 = np.where(self.two_mass, y[motor + 1], v2)
            coupling = np.where(self.two_mass, 0.0, a12)
            a22 = np.where(self.two_mass, 1.0 / np.where(self.two_mass, self.c["motor_inertia"], 1.0), a22)
        free1 = y[2] - h * (a11 * f[0] + coupling * f[1])
        free2 = v2 - h * (coupling * f[0] + a22 * f[1])
        low2 = -(level2 + self.c["asymmetry2"]) if self.on["asymmetry2"] else -level2
        ha11, ha12, ha22 = h * a11, h * coupling, h * a22
        stiff1 = -1.0 / (ha11 + CREEP_RADPS / (level1 + 1e-9))
        stiff2 = -1.0 / (ha22 + CREEP_RADPS / (level2 + 1e-9))
        f1, f2 = f[0], f[1]
        for _ in range(3):
            f1 = np.minimum(np.maximum((free1 + ha12 * f2) * stiff1, -level1), level1)
            f2 = np.minimum(np.maximum((free2 + ha12 * f1) * stiff2, low2), level2)
        d1, d2 = f1 - f[0], f2 - f[1]
        dv1 = ha11 * d1 + ha12 * d2
        dv2 = ha12 * d1 + ha22 * d2
        y[2] += dv1
        y[0] += (0.5 * h) * dv1
        if motor:
            step = np.where(self.two_mass, dv2, 0.0)
            y[motor + 1] += step
            y[motor] += (0.5 * h) * step
            dv2 = np.where(self.two_mass, h * a12 * d1, dv2)
        y[3] += dv2
        y[1] += (0.5 * h) * dv2
        return np.array([f1, f2])
