"""A family of geared legs with a dozen small imperfections that a good laboratory would accept, always present.

The motor drives the knee through a soft gear with 0.2 mrad of play; the encoder is on the motor's side. Friction at
both joints follows LuGre. The current loop and the shunt's filter lag, the shunt has 12 bits, the gear cogs and its
friction grows by 1 to 2 % of the load, the IMU is filtered and has the errors of a calibrated chip. One effect of
ordinary strength may be added, of the library or not. Semi-implicit Euler at 40 kHz, LuGre after Canudas de Wit et al.,
IEEE TAC 40(3), 1995; Bouc-Wen after Wen, J. Eng. Mech. 102(2), 1976.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numba import njit

from evidence.blind import servo
from evidence.blind.servo import (
    GEAR,
    RATE_HZ,
    RIG,
    SECONDS,
    Readings,
    draw,
    of_case,
    off_centre,
    reference,
    truth_of,
    turned,
    write_case,
)
from tests.support.mujoco_leg import GRAVITY, Leg

TICK_S, INNER = 1e-3, 40
SHUNT_NM = 16.0 / 4096
"""Resolution of the shunt [N m]."""
ROTOR = 3e-4
"""Inertia of the rotor, seen at the knee [kg m^2]."""
LAWS = ("spring", "drag", "asymmetry", "ripple", "stribeck", "load", "saturation", "cubic", "patchy", "magnet",
        "boucwen", "slosh", "copper", "wander")
SMALL = {"gyro_bias": 1e-3, "gyro_scale": 2e-3, "accel_bias": 0.01, "tilt": 1.5e-3, "torque_offset": 2e-3,
         "encoder_offset": 5e-4, "eccentricity": 5e-4, "skew": 2e-4}
"""Standard deviations of what a calibrated rig keeps [SI]."""


OF_ORDINARY_STRENGTH = {
    "none_wandering": ("wander", 0.012),
    "joint_stiffness": ("spring", 0.35),
    "quadratic_drag": ("drag", 0.03),
    "asymmetric_friction": ("asymmetry", 0.08),
    "torque_ripple": ("ripple", 0.08),
    "stribeck_friction": ("stribeck", 0.15),
    "load_dependent_friction": ("load", 0.12),
    "torque_saturation": ("saturation", 0.4),
    "torque_offset": ("torque_offset", 0.06),
    "torque_delay": ("delay", 6e-3),
    "sensor_time_skew": ("skew", 4e-3),
    "gyro_bias": ("gyro_bias", 0.03),
    "gyro_scale": ("gyro_scale", 0.03),
    "accelerometer_bias": ("accel_bias", 0.25),
    "imu_misalignment": ("tilt", 0.03),
    "encoder_offset": ("encoder_offset", 0.03),
    "encoder_eccentricity": ("eccentricity", 0.04),
    # no effect of the library does these
    "outside_cubic_spring": ("cubic", 0.5),
    "outside_patchy_friction": ("patchy", 0.12),
    "outside_magnet": ("magnet", 0.2),
    "outside_cable_hysteresis": ("boucwen", 0.06),
    "outside_swinging_mass": ("slosh", 0.05),
    "outside_torque_squared": ("copper", 0.06),
    "outside_gyro_curvature": ("gyro_cubic", 0.004)}
"""Hidden effect -> the law, or the fault in what is logged, that is added to the small ones, and its strength."""
Hidden = Mapping[str, float]
"""Strength of each law and fault of one effect."""


def _maker(key: str, size: float) -> Callable[[float], Hidden]:
    return lambda s: {key: size * s}


MAKERS: dict[str, Callable[[float], Hidden]] = {
    "none": lambda s: {}, **{name: _maker(*one) for name, one in OF_ORDINARY_STRENGTH.items()}}


@njit(cache=True)
def _lugre(v, z, level, peak, slip, damping, h):  # type: ignore[no-untyped-def]
    """Friction torque and bristle deflection after a step of h [s]; the bristle's equation is solved implicitly."""
    g = level + (peak - level) * np.exp(-((v / 0.05) ** 2))
    stiff = level / slip
    new = (z + h * v) / (1.0 + h * stiff * abs(v) / g)
    return stiff * new + damping * (new - z) / h, new


@njit(cache=True)
def _move(wanted, rate, beta, leg, law, phases, noise):  # type: ignore[no-untyped-def]
    """(T, 6) q1, motor angle, gyro, accelerometer x and y, shunt at every tick, from the commanded motion."""
    spring, drag, asymmetry, ripple, stribeck, load, limit, cubic, patchy, magnet, bouc, slosh, copper, wander = law
    d1, d2, dry, lever, stiffness, play, rotor, cog, load0 = leg
    b1, b2, b3, b4, b5 = beta
    h = 1e-3 / 40
    q1 = q2 = qm = v1 = v2 = vm = z1 = z2 = i = shunt = 0.0
    fg = fx = fy = w = cable = s = sd = u = 0.0
    out = np.empty((wanted.size, 6))
    gear_damping = 0.6 * np.sqrt(stiffness * rotor)
    for k in range(wanted.size):
        u = min(max(9.0 * (wanted[k] - qm) + 0.7 * (rate[k] - vm), -6.0), 6.0)
        w += -w * 1e-3 / 0.15 + wander * np.sqrt(2e-3 / 0.15) * noise[k]
        for _ in range(40):
            i += h * (u - i) / 5e-4
            shunt += h * (i - shunt) / 5e-4
            twist = qm - q2
            pushed = twist - min(max(twist, -play), play)
            gear = stiffness * pushed + (gear_damping * (vm - v2) if pushed != 0.0 else 0.0)
            level = dry + (load0 + load) * abs(gear)
            level += patchy * (1.0 + np.sin(4.0 * q2 + 0.5))
            if vm > 0.0:
                level += asymmetry
            level += stribeck / (1.0 + abs(vm) / 0.12)
            rub2, z2 = _lugre(vm, z2, level, 1.1 * level, 2e-3, 0.03, h)
            rub1, z1 = _lugre(v1, z1, 0.1 * dry, 0.11 * dry, 2e-3, 2e-3, h)
            motor = i
            if limit > 0.0:
                motor = i / (1.0 + (abs(i) * limit) ** 3) ** (1.0 / 3.0)
            motor -= copper * i * i
            am = (motor + w + (cog * np.sin(GEAR * qm + phases[0])) + ripple * np.sin(GEAR * qm + phases[1])
                  - rub2 - gear) / rotor
            cable += h * (v1 - 0.5 * abs(v1) * cable / 0.15 - 0.5 * v1 * abs(cable) / 0.15)
            near = (q1 - 0.1) / 0.08
            t1 = -d1 * v1 - rub1 - magnet * near * np.exp(-near * near) - bouc * cable / 0.15
            t2 = gear - d2 * v2 - spring * (q2 - 0.2) - drag * v2 * abs(v2) ** 0.9 - cubic * (q2 - 0.1) ** 3
            c2, s2 = np.cos(q2), np.sin(q2)
            g2 = 9.81 * b5 * np.sin(q1 + q2)
            if slosh > 0.0:  # a mass on a spring along the pivot's rotation, 1.6 Hz
                pull = slosh * (100.0 * s + 1.0 * sd)
                sd += h * (-100.0 * s - 1.0 * sd - 0.3 * v1 * abs(v1) - 9.81 * np.sin(q1))
                s += h * sd
                t1 += pull
            r1 = t1 + b3 * s2 * (2.0 * v1 * v2 + v2 * v2) - 9.81 * b4 * np.sin(q1) - g2
            r2 = t2 - b3 * s2 * v1 * v1 - g2
            m11, m12 = b1 + b2 + 2.0 * b3 * c2, b2 + b3 * c2
            det = m11 * b2 - m12 * m12
            a1, a2 = (b2 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det
            v1 += h * a1
            v2 += h * a2
            vm += h * am
            q1 += h * v1
            q2 += h * v2
            qm += h * vm
            fg += h * (v1 - fg) / 2e-3
            fx += h * (lever * a1 + 9.81 * np.sin(q1) - fx) / 2e-3
            fy += h * (-lever * v1 * v1 - 9.81 * np.cos(q1) - fy) / 2e-3
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4], out[k, 5] = q1, qm, fg, fx, fy, shunt
    return out


def make_case(name: str, seed: int, out: Path) -> None:
    """As `servo.make_case`."""
    rng = of_case(name, seed, 11)
    hidden = MAKERS[name](rng.uniform(0.85, 1.15))
    leg, dry, runs = record([hidden] * servo.RUNS, rng)
    write_case(name, seed, out, runs, rng, leg, RIG, truth_of(name, sizes={}), dry)


def record(hidden: Sequence[Hidden], rng: np.random.Generator) -> tuple[Leg, float, Iterator[Readings]]:
    """A random leg, its dry friction [N m], and its runs as logged, without noise: one with each of `hidden`."""
    leg, dry = draw(rng)
    drive = np.array([*leg.viscous, dry, leg.lever, rng.uniform(900.0, 1800.0), 1e-4, ROTOR,
                      rng.uniform(0.003, 0.008), rng.uniform(0.01, 0.02)])
    small = {k: sigma * rng.normal() for k, sigma in SMALL.items()}
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    time = np.arange(round(SECONDS / TICK_S)) * TICK_S

    def logged(run: int, one: Hidden) -> Readings:
        wanted, rate = reference(rng, time, run)
        law = np.array([one.get(k, 0.0) for k in LAWS])
        rows = _move(wanted, rate, leg.beta()[:5], drive, law, phases, rng.normal(size=time.size))
        fault = {k: small.get(k, 0.0) + one.get(k, 0.0) for k in {*small, *one}.difference(LAWS)}
        return as_logged(dict(zip(("q1_rad", "q2_rad", "gyro_radps", "accel_x_mps2", "accel_y_mps2", "tau2_nm"),
                                  rows.T)), time, fault)

    return leg, dry, (logged(run, one) for run, one in enumerate(hidden))


def as_logged(fine: Readings, time: np.ndarray, fault: dict[str, float]) -> Readings:
    """Readings at 100 Hz with what a calibrated rig keeps of its `fault`s. The driver knows the lag of the IMU's filter
    (2 ms) and that of the shunt's (0.5 ms), and corrects for both."""
    every = round(1.0 / (RATE_HZ * TICK_S))
    grid = time[every:-every:every]
    imu = 2e-3 - TICK_S - fault.get("skew", 0.0)
    late = {"q1_rad": -TICK_S, "q2_rad": -TICK_S, "tau2_nm": 5e-4 - TICK_S - fault.get("delay", 0.0)}
    c = {name: np.interp(grid + late.get(name, imu), time, values) for name, values in fine.items()}
    c["tau2_nm"] = np.round((c["tau2_nm"] + fault["torque_offset"]) / SHUNT_NM) * SHUNT_NM
    w = c["gyro_radps"]
    c["gyro_radps"] = w * (1.0 + fault["gyro_scale"]) + fault["gyro_bias"] + fault.get("gyro_cubic", 0.0) * w**3
    c["accel_x_mps2"] += fault["accel_bias"]
    turned(fault["tilt"])(c)
    q = c["q2_rad"]
    c["q2_rad"] = q + fault["encoder_offset"] + off_centre(q, fault["eccentricity"])
    return {"time_s": grid - grid[0], **c}


assert GRAVITY == 9.81, "the compiled motion has it as a number"
