"""Feedforward and PD gains of a driven joint from an identified leg, with the margins of the loop they close.

Hanging at rest the leg is linear but for dry friction: M q'' + D q' + K q = b u, with M, D and K the inertia matrix,
the viscous friction and the derivative of gravity there, and b = 1 at the driven joint. Seen from that joint alone, at
frequencies at which the passive one is free, the inertia is 1 / (b' M^-1 b).

- Feedforward, in the terms of FRC's SysId: kS [N m] dry friction, kV [N m s/rad], kA [N m s^2/rad] the inertia above,
  kG [N m] gravity, to be multiplied by the sine of the link's absolute angle.
- PD: the linear-quadratic regulator of kA x'' + kV x' + kG x = u, in which position error, speed error and torque are
  each weighed by the inverse square of what is tolerated (Bryson's rule; SysId does the same).
- Margins: the loop (kP + kD s) b' (M s^2 + D s + K)^-1 b e^(-s T) of the whole leg, swinging pivot included, with
  everything that is late in the loop as one delay T. Gain margins are the factors on both gains at which the loop meets
  -1, above 1 and below; the phase margin is the smallest over all frequencies at which the loop's gain is one.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from daq import FloatArray, InputError, WorkError
from experiments.console import text_table
from experiments.models.mechanism_settings import build_mechanism
from experiments.models.schema import Model

NUDGE_RAD = 1e-6
GRID_RADPS = np.geomspace(1e-2, 1e5, 200_001)


class Plant(NamedTuple):
    """The linear leg about hanging."""

    inertia: FloatArray
    """(n, n) [kg m^2]"""
    damping: FloatArray
    """(n, n) [N m s/rad]"""
    stiffness: FloatArray
    """(n, n) [N m/rad]"""
    joint: int
    """The driven one, from 0."""

    def response(self, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Angle of the driven joint per torque [rad/(N m)] at complex frequencies s (k,) [rad/s]."""
        s = s[:, None, None]
        inverse = np.linalg.inv(self.inertia * s**2 + self.damping * s + self.stiffness)
        return np.asarray(inverse[:, self.joint, self.joint])


class Tolerances(NamedTuple):
    """Tolerances of the regulator, and its delays."""

    angle_rad: float = 0.05
    speed_radps: float = 1.0
    torque_nm: float = 1.0
    delay_s: float = 0.002


class Gains(NamedTuple):
    """Feedforward, feedback and margins."""

    joint: int
    """From 1."""
    ks_nm: float
    kv_nms_per_rad: float
    ka_nms2_per_rad: float
    kg_nm: float
    kp_nm_per_rad: float
    kd_nms_per_rad: float
    gain_margin: float
    """Factor on both gains at which the loop begins to ring; infinite where none does."""
    gain_reduction: float
    """The same below 1; 0 where none does."""
    phase_margin_deg: float
    """Infinite where the loop's gain is one nowhere."""
    crossover_radps: float
    """Highest frequency at which the loop's gain is one; 0 where there is none."""
    delay_margin_s: float
    """What more may be late."""


def linear_plant(model: Model, where: str) -> Plant:
    """The leg about hanging. Raises `InputError` for a model that has not one driven joint, or no torque."""
    mechanism = build_mechanism(model.mechanism)
    if model.mechanism.input == "voltage":
        raise InputError(where, "is in volt units, gains of torque need newtons", "fit on runs with a measured torque")
    if len(mechanism.actuated) != 1 or model.mechanism.model == "biped3":
        raise InputError(where, "is no hanging leg with one driven joint", "give a model of a leg2 or a joint1")
    beta, n = np.array(model.beta), mechanism.n
    rest = np.zeros(n)
    offset = mechanism.bias_torque(rest, rest, beta)
    stiffness = np.stack([(mechanism.bias_torque(NUDGE_RAD * e, rest, beta) - offset) / NUDGE_RAD for e in np.eye(n)],
                         axis=-1)
    damping = np.zeros((n, n))
    for parameter, value in zip(mechanism.parameters, beta):
        if parameter.term == "viscous":
            damping[parameter.at[0], parameter.at[0]] = max(value, 0.0)  # a fit's error is no motor
    inertia = mechanism.inertia_matrix(rest, beta)
    if np.linalg.eigvalsh(inertia).min() <= 0:
        raise InputError(where, "its inertia matrix is not positive definite", "fit on runs that move all joints")
    return Plant(inertia, damping, stiffness, mechanism.actuated[0])


def gains_of(model: Model, where: str, wanted: Tolerances) -> Gains:
    """Gains for the model's driven joint. Raises `InputError`, and `WorkError` where the loop would not be stable."""
    for name, value in (("angle", wanted.angle_rad), ("speed", wanted.speed_radps), ("torque", wanted.torque_nm)):
        if not 0.0 < value < 1e6:
            raise InputError(f"--{name}", f"{value:g} is not a size to tolerate", "give one above 0")
    if not 0.0 <= wanted.delay_s < 1.0:
        raise InputError("--delay", f"{wanted.delay_s:g} is not a delay in seconds", "give one from 0 to 1")
    plant = linear_plant(model, where)
    j = plant.joint
    mechanism = build_mechanism(model.mechanism)
    dry = sum(value for p, value in zip(mechanism.parameters, model.beta) if p.term == "coulomb" and p.at == (j,))
    ka = 1.0 / float(np.linalg.inv(plant.inertia)[j, j])
    kv, kg = float(plant.damping[j, j]), float(plant.stiffness[j, j])
    a = np.array([[0.0, 1.0], [-kg / ka, -kv / ka]])
    b = np.array([[0.0], [1.0 / ka]])
    riccati = solve_continuous_are(a, b, np.diag([wanted.angle_rad**-2, wanted.speed_radps**-2]),
                                   np.array([[wanted.torque_nm**-2]]))
    kp, kd = (float(k) for k in (wanted.torque_nm**2 * b.T @ riccati)[0])
    margins = loop_margins(plant, kp, kd, wanted.delay_s)
    return Gains(j + 1, max(float(dry), 0.0), kv, ka, kg, kp, kd, *margins)


def loop_margins(plant: Plant, kp: float, kd: float, delay_s: float) -> tuple[float, float, float, float, float]:
    """Gain margin, gain reduction, phase margin [deg], crossover [rad/s], delay margin [s].

    Raises `WorkError` where the loop is not stable as it is.
    """
    omega = np.union1d(GRID_RADPS, resonances(plant))
    s = np.asarray(1j * omega, dtype=np.complex128)
    loop = (kp + kd * s) * plant.response(s) * np.exp(-s * delay_s)
    if not is_stable(plant, omega, loop):
        raise WorkError(f"with {delay_s:g} s of delay these gains make the loop ring; tolerate more, or be faster")
    crossing = np.flatnonzero((loop.imag[1:] * loop.imag[:-1] < 0) & (loop.real[1:] < 0))
    factors = []
    for k in crossing:
        u = loop.imag[k] / (loop.imag[k] - loop.imag[k + 1])
        factors.append(-1.0 / float(loop.real[k] + u * (loop.real[k + 1] - loop.real[k])))
    size = np.abs(loop)
    ones = np.flatnonzero((size[1:] - 1.0) * (size[:-1] - 1.0) <= 0)
    phase = np.abs(np.angle(-loop[ones]))  # how far from -1, whichever way
    lag = np.mod(np.angle(-loop[ones]), 2.0 * math.pi)
    return (min((f for f in factors if f > 1.0), default=math.inf), max((f for f in factors if f < 1.0), default=0.0),
            float(np.degrees(phase.min())) if ones.size else math.inf, float(omega[ones[-1]]) if ones.size else 0.0,
            float((lag / omega[ones]).min()) if ones.size else math.inf)


def resonances(plant: Plant) -> FloatArray:
    """Frequencies (m,) [rad/s] dense about each resonance and notch, however narrow."""
    values = np.linalg.eigvals(np.linalg.solve(plant.inertia, plant.stiffness))
    kept = [i for i in range(len(plant.inertia)) if i != plant.joint]
    if kept:
        inner = np.ix_(kept, kept)
        values = np.concatenate([values, np.linalg.eigvals(np.linalg.solve(plant.inertia[inner],
                                                                           plant.stiffness[inner]))])
    centres = np.sqrt(np.abs(values.real))
    spread = np.concatenate([-np.geomspace(1.0, 1e-6, 400), [0.0], np.geomspace(1e-6, 1.0, 400)])
    return np.unique(np.concatenate([c * (1.0 + 0.5 * spread) for c in centres if c > 0.0] or [np.ones(1)]))


def is_stable(plant: Plant, omega: FloatArray, loop: NDArray[np.complex128]) -> bool:
    """The closed loop is stable: its characteristic function turns by n pi from frequency 0 up (Mikhailov's criterion,
    which holds with a delay, too); `loop` (k,) at the frequencies `omega` (k,).
    """
    s = 1j * omega[:, None, None]
    free = np.linalg.det(plant.inertia * s**2 + plant.damping * s + plant.stiffness)
    angle = np.unwrap(np.angle(free * (1.0 + loop)))
    return round(float(angle[-1] - angle[0]) / math.pi) == len(plant.inertia)


def gains_document(found: Gains, wanted: Tolerances) -> dict[str, Any]:
    """`legid.gains/1`."""
    return {"schema": "legid.gains/1", **found._asdict(), "tolerated": {
        "angle_rad": wanted.angle_rad, "speed_radps": wanted.speed_radps, "torque_nm": wanted.torque_nm},
        "delay_s": wanted.delay_s}


def gains_text(found: Gains) -> str:
    """The control law and its numbers, for a terminal."""
    law = f"joint {found.joint}: torque = kS sign(v) + kV v + kA a + kG sin(angle) + kP angle error + kD speed error"
    return f"{law}\n{text_table(['', 'value', 'unit', ''], gain_rows(found), {1})}"


def gain_rows(found: Gains) -> list[list[str]]:
    """Name, value, unit and meaning of each."""
    return [
        ["kS", f"{found.ks_nm:.4g}", "N m", "feedforward: dry friction, by the sign of the wanted speed"],
        ["kV", f"{found.kv_nms_per_rad:.4g}", "N m s/rad", "feedforward: viscous friction"],
        ["kA", f"{found.ka_nms2_per_rad:.4g}", "N m s^2/rad", "feedforward: inertia, the passive joint free"],
        ["kG", f"{found.kg_nm:.4g}", "N m", "feedforward: gravity, times the sine of the link's absolute angle"],
        ["kP", f"{found.kp_nm_per_rad:.4g}", "N m/rad", "feedback on the angle's error"],
        ["kD", f"{found.kd_nms_per_rad:.4g}", "N m s/rad", "feedback on the speed's error"],
        ["gain margin", f"{found.gain_margin:.4g}", "", f"{20.0 * math.log10(found.gain_margin):.3g} dB on both gains"],
        ["gain reduction", f"{found.gain_reduction:.4g}", "", "smallest factor on both gains that stays stable"],
        ["phase margin", f"{found.phase_margin_deg:.4g}", "deg", "smallest over all crossovers"],
        ["crossover", f"{found.crossover_radps:.4g}", "rad/s", "highest"],
        ["delay margin", f"{found.delay_margin_s:.4g}", "s", "what more may be late"],
    ]
