"""`module_of`: leg.py, a program that applies around MuJoCo's steps what leg.xml cannot hold of a model."""

from __future__ import annotations

import textwrap
from collections import defaultdict
from pathlib import Path
from typing import Any

from estimator.signals import angle_column, imu_columns, torque_column
from experiments.models import EffectValue, TorqueTable, noise_level
from experiments.simulators.friction import clips_of
from experiments.simulators.mjcf import STEP_S, needed_mujoco
from experiments.simulators.parts import Parts

MARGIN = 0.1
"""See `TorqueSaturation`: a current beyond this is continued straight."""
IMU_ERROR, ENCODER_ERROR = "the IMU's error", "the encoder's error"
TWIST = "the encoder on the motor reads the gear's twist under the torque through it"
Terms = defaultdict[int, list[str]]
"""Joint from 0 to lines, or to the terms of a sum."""


class Code:
    """Lines of the module, by the place that they stand in."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.said: list[str] = []
        self.constants: list[str] = []
        self.functions: list[str] = []
        self.torque: Terms = defaultdict(list)
        """Lines that change what acts (`u1`, ...) of a driven joint, from 0."""
        self.level: Terms = defaultdict(list)
        """Terms of the joint's dry friction [N m]."""
        self.taken: Terms = defaultdict(list)
        """Terms of the torque that the joint takes [N m]."""
        self.read: Terms = defaultdict(list)
        """Terms that its encoder adds."""
        self.felt: list[str] = []
        """Lines that change an IMU's readings."""
        self.late_s = 0.0
        self.early_s = 0.0

    def say(self, effect: str, joint: int | None, how: str) -> None:
        """A line of the head."""
        where = "" if joint is None else f" at {self.parts.joints[joint].name}"
        self.said += textwrap.wrap(f"- {effect}{where}: {how}", 110, subsequent_indent="  ")

    def constant(self, name: str, value: float, unit: str) -> str:
        """A named number, and its name."""
        if all(not line.startswith(f"{name} = ") for line in self.constants):
            self.constants += [f"{name} = {value!r}", f'"""[{unit}]"""']
        return name


def module_of(parts: Parts, command: str) -> str:
    """Text of leg.py. Raises `InputError` where a part cannot be placed."""
    from jinja2 import Environment, StrictUndefined

    code = Code(parts)
    for effect in parts.left:
        _apply(code, effect)
    _structure(code)
    template = Path(__file__).with_name("leg.py.jinja").read_text(encoding="utf-8")
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
                              keep_trailing_newline=True)
    return environment.from_string(template).render(_context(code, command))


def _context(code: Code, command: str) -> dict[str, Any]:
    parts, mechanism, n = code.parts, code.parts.mechanism, len(code.parts.joints)
    driven = mechanism.actuated
    angles = tuple(angle_column(mechanism, j) for j in range(n))
    torques = tuple(torque_column(mechanism, j) for j in driven)
    columns = [*angles, *torques, *(c for k in range(_imus(parts)) for c in imu_columns(k))]
    noise = {c: level for c in columns if (level := noise_level(parts.model.noise, c))}
    act = _act(code)
    said = ["It applies what leg.xml does not hold:" if code.said else "leg.xml holds the whole model.", *code.said]
    return {
        "title": f"A {parts.model.mechanism.model} that legid identified, in MuJoCo.", "command": command,
        "mujoco": ".".join(map(str, needed_mujoco(parts))), "said": said,
        "zeros": [0.0] * n, "ones": [0.5] * len(driven),
        "zeros_of_motors": [0.0] * len(driven), "step": STEP_S,
        "joints": tuple(j.name for j in parts.joints), "motors": tuple(parts.joints[j].name for j in driven),
        "angles": angles, "torques": torques, "hold": repr(parts.model.hold).replace("'", '"'), "noise": noise,
        "correlation": parts.model.noise.get("accel_correlation", 0.0), "late": code.late_s, "early": code.early_s,
        "delays": tuple(parts.joints[j].delay_s for j in driven) if any(j.delay_s for j in parts.joints) else (),
        "delayed_sensors": parts.imu_delay_s > 0.0, "constants": code.constants, "functions": code.functions,
        "start": _start(parts), "act": act, "imu": _imu(code), "encoders": _encoders(code, angles),
        "reads_delayed": any("mj_readCtrl" in line for line in act)}


def _imus(parts: Parts) -> int:
    return len(parts.mechanism.imus) if parts.model.mechanism.has_imu else 0


def _dof(parts: Parts, joint: int) -> int:
    """Place of a joint in MuJoCo's qpos and qvel; the stand comes first."""
    return joint + (parts.stand is not None)


def _start(parts: Parts) -> list[str]:
    """Bristles begin as a motion that has gone on for long."""
    lines, k = list[str](), 0
    for j, joint in enumerate(parts.joints):
        for _, _, displacement in joint.bristles:
            rate = f"v[{j}]"
            lines.append(f"self.data.act[{k}] = {displacement!r} * {_sign(rate, joint.smoothing)}  # bristles")
            k += 1
    return lines


def _sign(rate: str, smoothing: float) -> str:
    return f"{rate} / math.sqrt({rate} * {rate} + {smoothing!r} ** 2)"


def _act(code: Code) -> list[str]:
    """Lines that set commands, dry friction and further torques."""
    parts, lines = code.parts, []
    for k, j in enumerate(parts.mechanism.actuated):
        joint = parts.joints[j]
        lines.append(f"u{j + 1} = torque[{k}]" + (f" - {joint.offset!r}  # the torque that acts" if joint.offset
                                                  else ""))
        lines += code.torque[j]
        lines.append(f"d.ctrl[{k}] = u{j + 1}" + (f" + {joint.offset!r}" if joint.offset else ""))
        laws = " ".join(term for terms in (*code.level.values(), *code.taken.values()) for term in terms)
        through = f"through{j + 1}" in " ".join(code.read[j])
        if joint.delay_s and (f"u{j + 1}" in laws or through):
            lines.append(f"u{j + 1} = mujoco.mj_readCtrl(m, d, {k}, d.time, self.buffer, 1).item()"
                         + (f" - {joint.offset!r}" if joint.offset else ""))
        if through:
            lines.append(f"self.acting{j + 1} = u{j + 1}")
    used = "\n".join(line for group in (code.level, code.taken) for terms in group.values() for line in terms)
    for j, joint in enumerate(parts.joints):
        dof = _dof(parts, j)
        if f"q{j + 1}" in used:
            lines.append(f"q{j + 1} = d.qpos[{dof}] + ahead * d.qvel[{dof}]")
        if f"v{j + 1}" in used or f"s{j + 1}" in used:
            lines.append(f"v{j + 1} = d.qvel[{dof}] + ahead * d.qacc[{dof}]")
        if f"s{j + 1}" in used:
            lines.append(f"s{j + 1} = {_sign(f'v{j + 1}', joint.smoothing)}")
    for j, terms in code.level.items():
        lines += _friction(parts, j, terms)
    for j, terms in code.taken.items():
        lines.append(f"d.qfrc_applied[{_dof(parts, j)}] = -({' + '.join(terms)})")
    return lines


def _friction(parts: Parts, j: int, terms: list[str]) -> list[str]:
    """Dry friction whose level changes: `frictionloss`, and as soft as the smoothed sign makes it."""
    joint, dof = parts.joints[j], _dof(parts, j)
    lines = [f"level = max({' + '.join([repr(joint.coulomb), *terms])}, 0.0)  # dry friction of {joint.name}"]
    for k, clip in enumerate(clips_of(joint, float(parts.inverse_inertia()[j]))):
        if k == 0:
            lines += [f"m.dof_frictionloss[{dof}] = {clip.share!r} * level",
                      f"m.dof_solref[{dof}, 1] = {-clip.damping!r} * level"]
        else:
            tendon = f'm.tendon("{joint.name}_friction").id'
            lines += [f"m.tendon_frictionloss[{tendon}] = {clip.share!r} * level",
                      f"m.tendon_solref_fri[{tendon}, 1] = {-clip.damping!r} * level"]
    return lines


def _encoders(code: Code, angles: tuple[str, ...]) -> list[str]:
    """Lines that read encoders, with what they read wrongly."""
    parts, lines = code.parts, []
    for j, joint in enumerate(parts.joints):
        terms = code.read[j]
        used, dof = " ".join(terms), _dof(parts, j)
        if f"q{j + 1}" in used or f"through{j + 1}" in used:
            lines.append(f"q{j + 1} = d.qpos[{dof}]")
        if f"through{j + 1}" in used:
            inertia = sum(e.sizes.get("motor_inertia", 0.0) for e in parts.left if e.joint == j + 1)
            friction = f"{joint.viscous!r} * v + {joint.dry!r} * {_sign('v', joint.smoothing)}"
            lines += [f"v = d.qvel[{dof}]", f"friction = {friction}",
                      f"through{j + 1} = self.acting{j + 1} - friction - {inertia!r} * d.qacc[{dof}]  # in the gear"]
    cells = ", ".join(f'"{column}": float({" + ".join([f"d.sensordata[{j}]", *code.read[j]])})'
                      for j, column in enumerate(angles))
    return [*lines, f"row = {{{cells}}}"]


def _imu(code: Code) -> list[str]:
    """Lines that read the IMUs, with their errors."""
    lines, at = [], len(code.parts.joints)
    if _imus(code.parts):
        lines.append("imu = self.data.sensordata")
    for k in range(_imus(code.parts)):
        gyro, x, y = imu_columns(k)
        lines += [f'row["{gyro}"] = -float(imu[{at + 2}])', f'row["{x}"], row["{y}"] = float(imu[{at + 3}]), '
                  f'float(imu[{at + 4}])']
        at += 6
    return [*lines, *code.felt]


def _structure(code: Code) -> None:
    structure = code.parts.model.structure
    for torque in structure.torques if structure else ():
        j = torque.joint - 1
        code.say("structure", j, "torque by tables that a diagnosis learnt")
        if torque.constant:
            code.taken[j].append(repr(torque.constant))
        for k, table in enumerate(torque.tables, 1):
            into = code.level if table.directed else code.taken
            into[j].append(_table(code, table, f"TABLE{j + 1}_{k}"))


def _table(code: Code, table: TorqueTable, name: str) -> str:
    """The call that reads a table, whose numbers become constants."""
    letters = {"angle": "q", "rate": "v", "motor torque": "u"}
    inputs = [f"{letters[v.variable]}{v.joint}" for v in table.inputs]
    shape = tuple(len(k) for k in table.knots)
    code.constants += [f"{name} = (", *(f"    np.array({list(map(float, k))})," for k in table.knots),
                       f"    np.array({list(map(float, table.values))}).reshape({shape}))",
                       '"""Knots and torques [N m]"""']
    if len(inputs) == 1:
        return f"float(np.interp({inputs[0]}, *{name}))"
    if not any(line.startswith("def bilinear") for line in code.functions):
        code.functions += BILINEAR
    return f"bilinear({inputs[0]}, {inputs[1]}, *{name})"


BILINEAR = '''

def bilinear(x: float, y: float, xs: np.ndarray, ys: np.ndarray, values: np.ndarray) -> float:
    """Value of a table at x, y; beyond its edges that of the edge."""
    return float(np.interp(y, ys, [np.interp(x, xs, column) for column in values.T]))
'''.rstrip("\n").split("\n")


def _apply(code: Code, effect: EffectValue) -> None:
    """Write the law of an effect, or what of it leg.xml does not hold."""
    size, j = effect.sizes, (effect.joint or 1) - 1
    match effect.name:
        case "torque_saturation":
            for k in [j] if effect.joint else code.parts.mechanism.actuated:
                code.say(effect.name, k, "the motor gives i / sqrt(1 + 2 c i^2) of a measured torque i")
                code.torque[k] += _saturation(code, size["cubic_shortfall"], k)
        case "gyro_bias":
            code.say(effect.name, None, IMU_ERROR)
            code.felt.append(f'row["gyro_radps"] += {size["bias"]!r}')
        case "gyro_scale":
            code.say(effect.name, None, IMU_ERROR)
            code.felt.insert(0, f'row["gyro_radps"] *= 1.0 + {size["scale_error"]!r}')
        case "accelerometer_bias":
            code.say(effect.name, None, IMU_ERROR)
            code.felt += [f'row["accel_{axis}_mps2"] += {size[f"bias_{axis}"]!r}' for axis in "xy"]
        case "torque_delay":
            code.say(effect.name, None, "the measured torque is read late")
            code.late_s = size["delay"]
        case "sensor_time_skew":
            code.say(effect.name, None, "the IMU is early: encoders and torques are read late")
            code.early_s = -size["skew"]
        case _:
            into, how, term = _joint_law(code, effect, j)
            code.say(effect.name, j, how)
            into[j].append(term)


def _saturation(code: Code, c: float, j: int) -> list[str]:
    """Lines that change the torque of joint j, from 0."""
    name, u = code.constant(f"SHORTFALL{j + 1}", c, "1/(N m)^2"), f"u{j + 1}"
    if c <= 0.0:
        return [f"{u} /= math.sqrt(max(1.0 + 2.0 * {name} * {u} ** 2, 0.1))"]
    most = (0.5 * (1.0 - MARGIN) / c) ** 0.5
    edge, slope = most / MARGIN**0.5, MARGIN**-1.5
    return [f"i, most = abs({u}), {edge!r}  # beyond it the torque grows by {1.0 / slope:.3g} of the current",
            f"i = min(i, most) / math.sqrt(1.0 + 2.0 * {name} * min(i, most) ** 2) "
            f"+ {1.0 / slope!r} * max(i - most, 0.0)", f"{u} = math.copysign(i, {u})"]


def _joint_law(code: Code, effect: EffectValue, j: int) -> tuple[Terms, str, str]:
    """(terms to which it adds one, what it does in words, that term) of an effect at joint j, from 0."""
    size, shape, n, dry = effect.sizes, effect.shapes, j + 1, code.parts.joints[j].dry
    load = f"math.hypot(u{n} * s{n} - {dry!r}, 1e-3)"
    match effect.name:
        case "stribeck_friction":
            f = code.constant(f"STRIBECK{n}", size["excess_torque"], "N m")
            return (code.level, "dry friction is higher by F exp(-|v / v_s|^n) near standstill",
                    f"{f} * math.exp(-(abs(v{n}) / {shape['stribeck_velocity']!r}) ** {shape['exponent']!r})")
        case "load_dependent_friction":
            mu = size["load_coefficient"]
            name = code.constant(f"LOAD{n}", mu, "1")
            code.functions += [
                "", "", f"def load{n}(u: float, sign: float) -> float:",
                '    """Further dry friction [N m] under the motor torque u, while the joint moves to the side '
                '`sign`."""',
                f"    over = u * sign - {dry!r}", "    load = math.sqrt(over * over + 1e-6)",
                f"    return {name} * load / (1.0 + {min(max(mu, -0.9), 0.9)!r} * over / load)"]
            return code.level, "dry friction grows by mu times the transmitted torque", f"load{n}(u{n}, s{n})"
        case "quadratic_load_friction":
            name = code.constant(f"LOAD_SQUARED{n}", size["load_coefficient"], "1/(N m)")
            return (code.level, "dry friction grows by k times the square of the transmitted torque",
                    f"{name} * {load} ** 2")
        case "load_stribeck_friction":
            name = code.constant(f"LOAD_AT_REST{n}", size["load_coefficient"], "1")
            return (code.level, "dry friction by load is higher by mu exp(-|v / v_s|^n) near standstill",
                    f"{name} * {load} "
                    f"* math.exp(-(abs(v{n}) / {shape['stribeck_velocity']!r}) ** {shape['exponent']!r})")
        case "directional_load_friction":
            share, k = shape["load_share"], code.constant(f"LOAD_BY_SIDE{n}", size["load_coefficient"], "1")
            return (code.level,
                    "dry friction grows by k |(1 - s) tau_m - s tau_e|, tau_e the load's torque a step before",
                    f"({k} + {size['coefficient_near_rest']!r} * math.exp(-(v{n} / {shape['stribeck_velocity']!r}) "
                    f"** 2)) * math.hypot({1.0 - share!r} * u{n} + {share!r} * float(d.qfrc_bias"
                    f"[{_dof(code.parts, j)}]), 1e-3)")
        case "friction_drift":
            return (code.level, "dry friction changes over the session and within each run",
                    f"({-size['change']!r} * math.expm1(-(self.session_s + d.time + ahead) / "
                    f"{shape['time_constant']!r})"
                    f" + {size['change_per_minute_within_runs'] / 60.0!r} * (self.run_s + d.time + ahead))")
        case "asymmetric_friction":
            return (code.taken, "half of the difference in viscous friction, B |v| / 2; leg.xml holds the rest",
                    f"{0.5 * size['viscous_difference']!r} * s{n} * v{n}")
        case "quadratic_drag":
            return code.taken, "a negative drag", f"{size['drag']!r} * v{n} * abs(v{n})"
        case "joint_elasticity":
            return code.read, TWIST, f"{size['compliance']!r} * through{n}"
        case "backlash":
            return (code.read, TWIST,
                    f"{0.5 * size['gap']!r} * math.tanh(through{n} / {shape['contact_torque']!r})")
        case "encoder_offset":
            return code.read, ENCODER_ERROR, repr(size["offset"])
        case _:  # encoder_eccentricity
            return (code.read, ENCODER_ERROR,
                    f"{size['sine_amplitude']!r} * math.sin(q{n}) + {size['cosine_amplitude']!r} * math.cos(q{n})")
