"""A family of plants of another make: MuJoCo's dynamics and friction solver under a position servo at 1 kHz.

Torque is held between the servo's ticks and logged at 100 Hz; friction is MuJoCo's set-valued `frictionloss`; each
effect has a law of its own, none the library's formula where another is plausible. At a tick torque and acceleration
jump, so what is logged there is the mean of both sides.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.random import Generator

from tests.support.mujoco_leg import GRAVITY, Leg, random_leg

TICK_S, STEP_S, RATE_HZ, SECONDS, RUNS = 1e-3, 2.5e-4, 100.0, 20.0, 8
GEAR = 50.0
RIG = f"[motor]\ngear_ratio = {GEAR}\n"
COUNTS = 8192
COLUMNS = ("time_s", "q2_rad", "tau2_nm", "gyro_radps", "accel_x_mps2", "accel_y_mps2")
NOISE = {"gyro_radps": 0.004, "accel_x_mps2": 0.04, "accel_y_mps2": 0.04, "tau2_nm": 0.01}
XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{step}" gravity="0 0 -{g}" integrator="RK4"/>
  <worldbody>
    <body name="base">
      {base}
      <inertial pos="0 0 0" mass="{base_mass}" diaginertia="0.1 0.1 0.1"/>
      <body name="upper" pos="0 0 0">
        <joint name="pivot" type="hinge" axis="0 -1 0" damping="{viscous[0]}" frictionloss="{f1}" stiffness="{k1}"
               springref="{r1}"/>
        <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="{i1} {i1} {i1}"/>
        <site name="imu" pos="0 0 -{lever}"/>
        <body name="lower" pos="0 0 -{l1}">
          <joint name="knee" type="hinge" axis="0 -1 0" damping="{viscous[1]}" frictionloss="{f2}" stiffness="{k2}"
                 springref="{r2}" armature="{armature}" {limit}/>
          <inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="{i2} {i2} {i2}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <sensor><accelerometer site="imu"/><gyro site="imu"/></sensor>
</mujoco>
"""
Readings = dict[str, np.ndarray]
"""Columns as the sensors would read them."""
Change = Callable[[Readings], None]
Law = Callable[[np.ndarray, np.ndarray, float, float], tuple[float, float]]
"""(q, v, commanded torque, session time) -> torques that act beside MuJoCo's own on pivot and knee [N m]."""


@dataclass
class Plant:
    """What is hidden, as changes of MuJoCo's model, of the torque, and of what is logged."""

    spring: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    armature: float = 0.0
    limit: float = 0.0
    base_n_per_m: float = 0.0
    friction_now: Callable[[float], float] = lambda t: 1.0
    law: Law = lambda q, v, u, t: (0.0, 0.0)
    logged: Change = lambda columns: None
    late_s: dict[str, float] = field(default_factory=dict)


KNEE = ("joint_stiffness", "quadratic_drag", "asymmetric_friction", "stribeck_friction", "load_dependent_friction",
        "torque_ripple", "encoder_offset", "encoder_scale", "encoder_eccentricity", "end_stop_contact",
        "friction_drift")
"""Effects of joint 2; the others are of the rig."""
SIZES = {"rotor_inertia": {"inertia": 0.006}, "torque_offset": {"offset": 0.06}, "torque_delay": {"delay": 0.006},
         "sensor_time_skew": {"skew": 0.004}, "gyro_bias": {"bias": 0.03}, "gyro_scale": {"scale": 0.03},
         "encoder_offset": {"offset": 0.03}, "encoder_scale": {"scale": 0.03}}
"""Of ordinary strength, where the library's law has the same size."""


def truth_of(name: str, strength: float = 1.0, sizes: Mapping[str, Mapping[str, float]] = SIZES
             ) -> list[dict[str, Any]]:
    """What is hidden, with joint and sizes; nothing where the library does not know it."""
    if name.startswith(("none", "outside")):
        return []
    return effect(name, 2 if name in KNEE else None,
                  **{size: strength * value for size, value in sizes.get(name, {}).items()})


def effect(name: str, joint: int | None = None, **sizes: float) -> list[dict[str, Any]]:
    return [{"effect": name, "joint": joint, "sizes": sizes, "also": []}]


def _sign(v: float, scale: float = 0.01) -> float:
    return float(np.clip(v / scale, -1.0, 1.0))


def changed(name: str, law: Callable[[np.ndarray], np.ndarray]) -> Change:
    def change(columns: Readings) -> None:
        columns[name] = law(columns[name])
    return change


def turned(angle: float) -> Change:
    """An accelerometer that is mounted askew."""
    def change(columns: Readings) -> None:
        x, y = columns["accel_x_mps2"], columns["accel_y_mps2"]
        columns["accel_x_mps2"], columns["accel_y_mps2"] = (np.cos(angle) * x - np.sin(angle) * y,
                                                            np.sin(angle) * x + np.cos(angle) * y)
    return change


def off_centre(q: np.ndarray, depth: float) -> np.ndarray:
    """Error of an angle [rad] from a disc off centre by `depth` radii, read by one head."""
    return np.arctan2(depth * np.sin(q - 0.7), 1.0 + depth * np.cos(q - 0.7))


def at_knee(torque: Callable[[np.ndarray, np.ndarray, float, float], float]) -> Plant:
    """A plant whose law acts on the knee alone."""
    return Plant(law=lambda q, v, u, t: (0.0, torque(q, v, u, t)))


MAKERS: dict[str, Callable[[float], Plant]] = {
    "none": lambda s: Plant(),
    "joint_stiffness": lambda s: Plant(spring=((0.0, 0.0), (0.35 * s, 0.2))),
    "rotor_inertia": lambda s: Plant(armature=0.006 * s),
    "quadratic_drag": lambda s: at_knee(lambda q, v, u, t: -0.03 * s * v[1] * abs(v[1]) ** 0.9),
    "asymmetric_friction": lambda s: at_knee(lambda q, v, u, t: -0.08 * s * max(_sign(v[1]), 0.0)),
    "stribeck_friction": lambda s: at_knee(
        lambda q, v, u, t: -0.15 * s * _sign(v[1]) / (1.0 + abs(v[1]) / 0.12)),
    "load_dependent_friction": lambda s: at_knee(
        lambda q, v, u, t: -0.12 * s * abs(u) * _sign(v[1])),
    "torque_ripple": lambda s: at_knee(
        lambda q, v, u, t: 0.08 * s * (np.sin(1 * GEAR * q[1] + 0.4) + 0.1 * np.sin(2 * GEAR * q[1]))),
    "torque_offset": lambda s: Plant(logged=changed("tau2_nm", lambda u: u + 0.06 * s)),
    "torque_saturation": lambda s: at_knee(
        lambda q, v, u, t: u / (1.0 + (abs(u) / (2.6 / s)) ** 3) ** (1 / 3) - u),
    "torque_delay": lambda s: Plant(late_s={"tau2_nm": 0.006 * s}),
    "sensor_time_skew": lambda s: Plant(
        late_s={k: 0.004 * s for k in ("gyro_radps", "accel_x_mps2", "accel_y_mps2")}),
    "gyro_bias": lambda s: Plant(logged=changed("gyro_radps", lambda w: w + 0.03 * s)),
    "gyro_scale": lambda s: Plant(logged=changed("gyro_radps", lambda w: w * (1.0 + 0.03 * s))),
    "accelerometer_bias": lambda s: Plant(logged=changed("accel_x_mps2", lambda a: a + 0.25 * s)),
    "imu_misalignment": lambda s: Plant(logged=turned(0.03 * s)),
    "encoder_offset": lambda s: Plant(logged=changed("q2_rad", lambda q: q + 0.03 * s)),
    "encoder_scale": lambda s: Plant(logged=changed("q2_rad", lambda q: q * (1.0 + 0.03 * s))),
    "encoder_eccentricity": lambda s: Plant(logged=changed("q2_rad", lambda q: q + off_centre(q, 0.04 * s))),
    "end_stop_contact": lambda s: Plant(limit=0.75 / s),
    "friction_drift": lambda s: Plant(friction_now=lambda t: 1.0 + 1.5 * s * np.exp(-t / 70.0)),
    "base_compliance": lambda s: Plant(base_n_per_m=6000.0 / s),
    # no effect of the library does these
    "outside_cubic_spring": lambda s: at_knee(lambda q, v, u, t: -0.35 * s * (q[1] - 0.1) ** 3),
    "outside_patchy_friction": lambda s: at_knee(
        lambda q, v, u, t: -0.12 * s * _sign(v[1]) * (1.0 + np.sin(4.0 * q[1] + 0.5))),
    "outside_magnet": lambda s: Plant(
        law=lambda q, v, u, t: (-0.2 * s * (q[0] - 0.1) * np.exp(-((q[0] - 0.1) / 0.08) ** 2) / 0.08, 0.0)),
}


def model_of(leg: Leg, plant: Plant, dry: float) -> mujoco.MjModel:
    (k1, r1), (k2, r2) = plant.spring
    base = f'<joint type="slide" axis="1 0 0" stiffness="{plant.base_n_per_m}" damping="12"/>' \
        if plant.base_n_per_m else ""
    limit = f'limited="true" range="-3.0 {plant.limit}" solreflimit="-1500 -3"' if plant.limit else ""
    text = XML.format(**vars(leg), step=STEP_S, g=GRAVITY, f1=0.1 * dry, f2=dry, k1=k1, r1=r1, k2=k2, r2=r2,
                      armature=plant.armature, base=base, base_mass=2.0, limit=limit)
    return mujoco.MjModel.from_xml_string(text)


def reference(rng: Generator, time: np.ndarray, run: int) -> tuple[np.ndarray, np.ndarray]:
    """A servo's commanded angle and rate: random-phase multisines, some runs fast, some slow."""
    high = (2.2, 1.6, 2.8, 0.7)[run % 4]
    f = np.arange(0.1, high, 1.0 / SECONDS)
    phase, weight = rng.uniform(0, 2 * np.pi, f.shape), 1.0 / (0.6 + f)
    w = 2 * np.pi * f[:, None]
    q, v = ((weight[:, None] * part).sum(axis=0) for part in (np.sin(w * time + phase[:, None]),
                                                              w * np.cos(w * time + phase[:, None])))
    peak = rng.uniform(0.8, 1.1) / np.abs(q).max()
    begin = np.clip(time, 0.0, 1.0)
    return peak * begin * q, peak * (begin * v + (time < 1.0) * q)


def record(leg: Leg, plant: Plant, dry: float, rng: Generator, run: int, session_s: float
           ) -> dict[str, np.ndarray]:
    """One run as logged, without noise; what is late is read off a finer grid."""
    model = model_of(leg, plant, dry)
    data = mujoco.MjData(model)
    first = model.joint("pivot").dofadr[0]
    here = slice(first, first + 2)
    ticks, every = round(SECONDS / TICK_S), round(1.0 / (RATE_HZ * TICK_S))
    time = np.arange(ticks + 1) * TICK_S
    wanted, rate = reference(rng, time, run)
    rows = np.empty((ticks, 6))
    friction = model.dof_frictionloss.copy()
    u, inner = 0.0, round(TICK_S / STEP_S)
    for k in range(ticks):
        q, v = data.qpos[here], data.qvel[here]
        mujoco.mj_forward(model, data)
        before, u_before = data.sensordata.copy(), u
        u = float(np.clip(9.0 * (wanted[k] - q[1]) + 0.7 * (rate[k] - v[1]), -6.0, 6.0))
        more = plant.law(q, v, u, session_s + time[k])
        data.qfrc_applied[here] = (more[0], u + more[1])
        model.dof_frictionloss[first + 1] = friction[first + 1] * plant.friction_now(session_s + time[k])
        mujoco.mj_forward(model, data)
        s = 0.5 * (before + data.sensordata)
        # MuJoCo: x forward, z up along the link towards the pivot, rotation about -y
        rows[k] = q[0], q[1], -s[4], s[0], -s[2], 0.5 * (u_before + u)
        mujoco.mj_step(model, data, inner)
    names = ("q1_rad", "q2_rad", "gyro_radps", "accel_x_mps2", "accel_y_mps2", "tau2_nm")
    fine = dict(zip(names, rows.T))
    grid = time[every:ticks - every:every]
    out = {"time_s": grid - grid[0]}
    for name, values in fine.items():
        out[name] = np.interp(grid - plant.late_s.get(name, 0.0), time[:ticks], values)
    plant.logged(out)
    return out


def make_case(name: str, seed: int, out: Path, makers: Mapping[str, Callable[[float], Plant]] = MAKERS) -> None:
    """r1.csv to r8.csv and rig.toml in OUT/NAME-SEED, its truth next to that folder."""
    rng = of_case(name, seed)
    strength = rng.uniform(0.85, 1.15)
    write_plant(name, seed, out, makers[name](strength), truth_of(name, strength), *draw(rng), rng)


def of_case(name: str, *numbers: int) -> np.random.Generator:
    """Random numbers of a case's name and numbers."""
    return np.random.default_rng([sum(map(ord, name)), *numbers])


def draw(rng: np.random.Generator) -> tuple[Leg, float]:
    """A leg, and the dry friction of its knee [N m]."""
    return replace(random_leg(rng), coulomb=(0.0, 0.0)), rng.uniform(0.02, 0.08)


def write_plant(name: str, seed: int, out: Path, plant: Plant, hidden: Sequence[dict[str, Any]], leg: Leg, dry: float,
                rng: np.random.Generator) -> Leg:
    """Record and write the runs of a plant; the leg with its friction."""
    runs = (record(leg, plant, dry, rng, run, session_s=25.0 * run) for run in range(RUNS))
    write_case(name, seed, out, runs, rng, leg, RIG, hidden, dry)
    return replace(leg, coulomb=(0.1 * dry, dry))


def counted(q: np.ndarray) -> np.ndarray:
    """An angle as the encoder reads it."""
    step = 2 * np.pi / COUNTS
    return np.round(q / step) * step


def write_case(name: str, seed: int, out: Path, runs: Iterable[dict[str, np.ndarray]], rng: Generator,
               leg: Leg, rig: str, hidden: Sequence[dict[str, Any]], dry: float) -> None:
    """Runs as sensors with noise log them, a rig file that says nothing but what everybody knows, and the truth."""
    folder = out / f"{name}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    for k, found in enumerate(runs, 1):
        for column, sigma in NOISE.items():
            found[column] = found[column] + sigma * rng.normal(size=found[column].size)
        found["q2_rad"] = counted(found["q2_rad"])
        np.savetxt(folder / f"r{k}.csv", np.column_stack([found[c] for c in COLUMNS]), delimiter=",",
                   header=",".join(COLUMNS), comments="", fmt="%.9g")
    (folder / "rig.toml").write_text(
        f'[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {leg.lever}\n{rig}')
    (out / f"{folder.name}.truth.json").write_text(json.dumps(
        {"name": folder.name, "effects": list(hidden), "seed": seed, "beta": leg.beta().tolist(),
         "dry": dry}))
