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


class Code:
    """Lines of the module, by the place that they stand in."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.said: list[str] = []
        self.constants: list[str] = []
        self.functions: list[str] = []
        self.torque = defaultdict[int, list[str]](list)
        """Lines that change what acts (`u1`, ...) of a driven joint, from 0."""
        self.level = defaultdict[int, list[str]](list)
        """Terms of the joint's dry friction [N m]."""
        self.taken = defaultdict[int, list[str]](list)
        """Terms of the torque that the joint takes [N m]."""
        self.read = defaultdict[int, list[str]](list)
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
        own = [effect.joint - 1] if effect.joint else list(parts.mechanism.actuated)
        LAWS[effect.name](code, effect, own)
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


def _saturation(code: Code, effect: EffectValue, at: list[int]) -> None:
    c = effect.sizes["cubic_shortfall"]
    for j in at:
        code.say(effect.name, j, "the motor gives i / sqrt(1 + 2 c i^2) of a measured torque i")
        name, u = code.constant(f"SHORTFALL{j + 1}", c, "1/(N m)^2"), f"u{j + 1}"
        lines = code.torque[j]
        if c > 0.0:
            most = (0.5 * (1.0 - MARGIN) / c) ** 0.5
            edge, slope = most / MARGIN**0.5, MARGIN**-1.5
            lines += [f"i, most = abs({u}), {edge!r}  # beyond it the torque grows by {1.0 / slope:.3g} of the current",
                      f"i = min(i, most) / math.sqrt(1.0 + 2.0 * {name} * min(i, most) ** 2) "
                      f"+ {1.0 / slope!r} * max(i - most, 0.0)", f"{u} = math.copysign(i, {u})"]
        else:
            lines.append(f"{u} /= math.sqrt(max(1.0 + 2.0 * {name} * {u} ** 2, 0.1))")


def _stribeck(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, shape = at[0], effect.shapes
    code.say(effect.name, j, "dry friction is higher by F exp(-|v / v_s|^n) near standstill")
    f = code.constant(f"STRIBECK{j + 1}", effect.sizes["excess_torque"], "N m")
    code.level[j].append(
        f"{f} * math.exp(-(abs(v{j + 1}) / {shape['stribeck_velocity']!r}) ** {shape['exponent']!r})")


def _load(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, parts = at[0], code.parts
    mu, joint = effect.sizes["load_coefficient"], parts.joints[j]
    code.say(effect.name, j, "dry friction grows by mu times the transmitted torque")
    name = code.constant(f"LOAD{j + 1}", mu, "1")
    code.functions += [
        "", "", f"def load{j + 1}(u: float, sign: float) -> float:",
        '    """Further dry friction [N m] under the motor torque u, while the joint moves to the side `sign`."""',
        f"    over = u * sign - {joint.dry!r}", "    load = math.sqrt(over * over + 1e-6)",
        f"    return {name} * load / (1.0 + {min(max(mu, -0.9), 0.9)!r} * over / load)"]
    code.level[j].append(f"load{j + 1}(u{j + 1}, s{j + 1})")


def _load_more(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, shape = at[0], effect.shapes
    joint, size = code.parts.joints[j], effect.sizes["load_coefficient"]
    load = f"math.hypot(u{j + 1} * s{j + 1} - {joint.dry!r}, 1e-3)"
    if effect.name == "quadratic_load_friction":
        code.say(effect.name, j, "dry friction grows by k times the square of the transmitted torque")
        code.level[j].append(f"{code.constant(f'LOAD_SQUARED{j + 1}', size, '1/(N m)')} * {load} ** 2")
        return
    code.say(effect.name, j, "dry friction by load is higher by mu exp(-|v / v_s|^n) near standstill")
    code.level[j].append(
        f"{code.constant(f'LOAD_AT_REST{j + 1}', size, '1')} * {load} "
        f"* math.exp(-(abs(v{j + 1}) / {shape['stribeck_velocity']!r}) ** {shape['exponent']!r})")


def _load_by_side(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, size, shape = at[0], effect.sizes, effect.shapes
    code.say(effect.name, j, "dry friction grows by k |(1 - s) tau_m - s tau_e|, tau_e the load's torque a step before")
    share, k = shape["load_share"], code.constant(f"LOAD_BY_SIDE{j + 1}", size["load_coefficient"], "1")
    code.level[j].append(
        f"({k} + {size['coefficient_near_rest']!r} * math.exp(-(v{j + 1} / {shape['stribeck_velocity']!r}) ** 2)) "
        f"* math.hypot({1.0 - share!r} * u{j + 1} + {share!r} * float(d.qfrc_bias[{_dof(code.parts, j)}]), 1e-3)")


def _drift(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, size = at[0], effect.sizes
    code.say(effect.name, j, "dry friction changes over the session and within each run")
    code.level[j].append(
        f"({-size['change']!r} * math.expm1(-(self.session_s + d.time + ahead) / {effect.shapes['time_constant']!r})"
        f" + {size['change_per_minute_within_runs'] / 60.0!r} * (self.run_s + d.time + ahead))")


def _asymmetric(code: Code, effect: EffectValue, at: list[int]) -> None:
    j = at[0]
    code.say(effect.name, j, "half of the difference in viscous friction, B |v| / 2; leg.xml holds the rest")
    code.taken[j].append(f"{0.5 * effect.sizes['viscous_difference']!r} * s{j + 1} * v{j + 1}")


def _drag(code: Code, effect: EffectValue, at: list[int]) -> None:
    j = at[0]
    code.say(effect.name, j, "a negative drag")
    code.taken[j].append(f"{effect.sizes['drag']!r} * v{j + 1} * abs(v{j + 1})")


def _gear(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, size = at[0], effect.sizes
    code.say(effect.name, j, "the encoder on the motor reads the gear's twist under the torque through it")
    twist = f"{size['compliance']!r} * through{j + 1}" if effect.name == "joint_elasticity" else \
        f"{0.5 * size['gap']!r} * math.tanh(through{j + 1} / {effect.shapes['contact_torque']!r})"
    code.read[j].append(twist)


def _encoder(code: Code, effect: EffectValue, at: list[int]) -> None:
    j, size = at[0], effect.sizes
    code.say(effect.name, j, "the encoder's error")
    code.read[j].append(
        repr(size["offset"]) if effect.name == "encoder_offset" else
        f"{size['sine_amplitude']!r} * math.sin(q{j + 1}) + {size['cosine_amplitude']!r} * math.cos(q{j + 1})")


def _imu_error(code: Code, effect: EffectValue, at: list[int]) -> None:
    code.say(effect.name, None, "the IMU's error")
    if effect.name == "gyro_bias":
        code.felt.append(f'row["gyro_radps"] += {effect.sizes["bias"]!r}')
    elif effect.name == "gyro_scale":
        code.felt.insert(0, f'row["gyro_radps"] *= 1.0 + {effect.sizes["scale_error"]!r}')
    else:
        code.felt += [f'row["accel_{axis}_mps2"] += {effect.sizes[f"bias_{axis}"]!r}' for axis in "xy"]


def _late(code: Code, effect: EffectValue, at: list[int]) -> None:
    code.say(effect.name, None, "the measured torque is read late")
    code.late_s = effect.sizes["delay"]


def _early(code: Code, effect: EffectValue, at: list[int]) -> None:
    code.say(effect.name, None, "the IMU is early: encoders and torques are read late")
    code.early_s = -effect.sizes["skew"]


LAWS = {"torque_saturation": _saturation, "stribeck_friction": _stribeck, "load_dependent_friction": _load,
        "friction_drift": _drift, "asymmetric_friction": _asymmetric, "quadratic_drag": _drag,
        "joint_elasticity": _gear, "backlash": _gear, "encoder_offset": _encoder, "encoder_eccentricity": _encoder,
        "gyro_bias": _imu_error, "gyro_scale": _imu_error, "accelerometer_bias": _imu_error, "torque_delay": _late,
        "sensor_time_skew": _early, "load_stribeck_friction": _load_more, "quadratic_load_friction": _load_more,
        "directional_load_friction": _load_by_side}
