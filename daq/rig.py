"""rig.toml: what is known of a rig before any data, checked against typed structs."""

from __future__ import annotations

import hashlib
import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_type_hints

import msgspec
from msgspec import Meta, Struct, structs

from daq.errors import InputError, did_you_mean, input_errors
from daq.files import read_bytes
from daq.imu_mount import check_accelerometer, check_mount
from daq.mechanisms import check_mechanism, joints_of
from daq.rig_columns import Column
from daq.rig_devices import NODES, Devices
from daq.rig_imu import Imu
from daq.rig_limits import Limits
from daq.rig_sampling import Filter, Sampling, Timing
from daq.rig_types import (
    IDENTITY3,
    Correlation,
    Joint,
    Matrix3,
    NonNegative,
    Positive,
    Seconds,
    Signed,
    Table,
    Vector3,
)
from daq.servo import Servo, faults

MOST_BYTES = 1 << 20
"""Of a rig file."""


class Mechanism(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The mechanism, and its joints that a motor drives."""

    model: Annotated[str, Meta(max_length=60)]
    """leg2 | biped3 | joint1 | chain, or one of one's own; see `daq.mechanisms`"""
    actuated: tuple[Joint, ...]
    gravity_mps2: Annotated[float, Meta(ge=0, le=100.0)] = 9.81
    links: Annotated[int, Meta(ge=1, le=20)] = 2
    """Number of links; read for `chain` only."""
    input: Literal["torque", "voltage"] = "torque"
    link_lengths_m: tuple[Annotated[float, Meta(gt=0, le=10.0)], ...] = ()
    """From joint to joint, of the first links: as many as IMUs ride on."""
    encoders: tuple[Joint, ...] | None = None
    """Joints whose encoders are read; None: all, or on a rig with an IMU all but joint 1's."""


class Terms(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Declared extra terms of the nominal model, by joint (1-based)."""

    rotor_inertia: tuple[Joint, ...] | None = None
    """J*qdd of a geared rotor, in the joint's own row only [kg m^2]. None, here and below: a fit chooses."""
    torque_offset: tuple[Joint, ...] | None = None
    """A constant added to the joint's measured torque [N m]."""
    encoder_zero: tuple[Joint, ...] | None = None
    """The encoder's zero, another in every run [rad]: of drives that count from where they were switched on."""
    friction_velocity_radps: Positive | tuple[Positive, ...] | None = None
    """Friction smoothing velocity v_s [rad/s, m/s on a slide]: sign(qd) is qd / sqrt(qd^2 + v_s^2).

    None: 0.005 rad/s; a fit chooses a thousandth of its speed on a slide.
    """


class DistanceMeter(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A laser distance meter on link 1 that points at the ground ahead: the absolute angle by (52) to (54)."""

    mount_m: Annotated[float, Meta(gt=0, le=10.0)]
    """d_2: from the ground's contact to the meter, along the link."""
    gamma_rad: Annotated[float, Meta(gt=0, lt=1.5707)]
    """gamma_3: between link and beam."""
    sigma_m: NonNegative = 0.0
    """1 sigma of a reading at no distance; with `sigma_per_m` 0 too it is estimated."""
    sigma_per_m: NonNegative = 0.0
    """Its growth with the distance."""
    upright_rad: Signed = 0.0
    """q1 where the link stands upright; it grows as the link leans towards the spot."""


class Walker(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `biped3` that walks: its records go over many steps, in the joints that its motors turn (docs/formats.md)."""

    touchdown_s: Seconds = 0.005
    """How far a change of column `stance` may be off the landing; samples nearer to it are left out."""


class Motor(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    gear_ratio: Positive = 1.0
    """Turns of the motor per turn of the joint."""
    torque_constant_nm_per_a: Positive | None = None
    """By the data sheet, of the motor before its gear; what [calibration] has goes before it."""
    side: Literal["motor", "joint"] = "motor"
    """Of the gear, on which the angle and the torque of a drive other than our own firmware are meant."""
    sign: Literal[1, -1] = 1
    """-1: such a drive counts backwards when the knee's angle grows."""


class Disturbance(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Coloured torque that disturbs joints: an Ornstein-Uhlenbeck process, of all joints alike or of each by number."""

    torque_nm: NonNegative | tuple[NonNegative, ...]
    """1 sigma; 0: none."""
    time_constant_s: Positive | tuple[Positive, ...] = 1.0


class Noise(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Known standard deviations; what is absent is estimated from the data."""

    gyro_radps: Positive | None = None
    accel_mps2: Positive | tuple[Positive, ...] | None = None
    """Of both axes, or of x and of y: `parse_rig` counts them, for msgspec 0.22 breaks the heap where a union has a
    tuple of fixed length."""
    torque_nm: Positive | tuple[Positive, ...] | None = None
    """Of every driven joint, or of each of them by rising joint."""
    encoder_rad: Positive | tuple[Positive, ...] | None = None
    """Of every encoder, or of each joint's."""
    passive_nm: Positive | tuple[Positive, ...] | None = None
    """Torque that the model may lack at a joint without a motor, of all of them or of each by rising joint."""
    disturbance: Disturbance | None = None
    """None: estimated where the data ask for one."""
    accel_correlation: Correlation = 0.0
    """Between the accelerometer's x and y noise."""
    torque_correlation: tuple[tuple[Correlation, ...], ...] = ()
    """Between the torque noise of the driven joints, a row each by rising joint; empty: none."""

    def encoder_of(self, joint: int) -> float | None:
        """Encoder noise of one joint (0-based, -1 the last); None where it is to be estimated."""
        known = self.encoder_rad
        return known[joint] if isinstance(known, tuple) else known


class Calibration(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Measured once on the rig; raw readings stay raw in the run file."""

    knee_zero_rad: Signed = 0.0
    shunt_offset_a: Signed = 0.0
    second_shunt_offset_a: Signed = 0.0
    """Of the one in [devices.shunt], after its sign."""
    pivot_zero_rad: Signed = 0.0
    """What the sensor in [devices.pivot] reads, after its sign, when link 1 hangs straight down."""
    torque_constant_nm_per_a: Annotated[float, Meta(gt=0, le=1e3)] = 1.0
    """Joint torque per ampere of motor current, gear included. Absent: that of [motor] times the gear, or 1."""
    torque_constant_half_nm_per_a: NonNegative | None = None
    """Half of its 95 % interval, where a known weight has shown it."""
    imu_mount: Matrix3 = IDENTITY3
    """Rows: contract x, y, z axes expressed in the chip's frame."""
    gyro_bias_radps: Vector3 = (0.0, 0.0, 0.0)
    accel_bias_mps2: Vector3 = (0.0, 0.0, 0.0)
    accel_matrix: Matrix3 = IDENTITY3
    """Scales and cross-talk of the accelerometer: calibrated = matrix @ (reading - bias), in the chip's frame."""


class Rig(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One rig.toml."""

    mechanism: Mechanism
    terms: Terms = Terms()
    imu: Imu | tuple[Imu, ...] | None = None
    """`imus` has them all."""
    distance_meter: DistanceMeter | None = None
    walker: Walker | None = None
    motor: Motor = Motor()
    noise: Noise = Noise()
    sampling: Sampling = Sampling()
    timing: Timing = Timing()
    filter: Filter = Filter()
    devices: Devices = Devices()
    limits: Limits = Limits()
    calibration: Calibration = Calibration()
    servo: Servo | None = None
    prior: dict[str, tuple[float, ...]] = msgspec.field(default_factory=dict)
    """Parameter, or body value (m1, lc1, I1, l1, ...) -> value and standard deviation, from CAD or a scale."""
    tolerance: dict[str, bool | float | tuple[float, ...] | dict[str, float | tuple[float, ...]]] = msgspec.field(
        default_factory=dict)
    """Effect -> standard deviation of what it may be on this rig [SI], a list for several sizes, a table by joint for
    single joints; `none = true`: what is not named has none."""
    columns: dict[str, Column] = msgspec.field(default_factory=dict)
    """Column of the contract -> where files of other programs hold it."""

    @property
    def tolerances(self) -> dict[str, tuple[float, ...]]:
        """Effect, or effect@joint, to the tolerance of each size; `none` where only what is named has any."""
        found: dict[str, tuple[float, ...]] = {}
        for name, entry in self.tolerance.items():
            if name == "none":
                found |= {name: ()} if entry else {}
            elif isinstance(entry, dict):
                found |= {f"{name}@{joint}": _listed(own) for joint, own in entry.items()}
            else:
                found[name] = _listed(entry)
        half = self.calibration.torque_constant_half_nm_per_a
        if half is not None and "none" not in found:
            found.setdefault("torque_gain", (half / 1.96 / self.calibration.torque_constant_nm_per_a,))
        age_std_s = max(imu.age_std_s for imu in self.imus)
        if age_std_s and "none" not in found:
            found.setdefault("sensor_time_skew", (age_std_s,))
        own = {} if self.servo is None or "none" in found else self.servo.tolerances
        return {**own, **found}

    @property
    def imus(self) -> tuple[Imu, ...]:
        """In the file's order; one on link 1 where none is declared."""
        return self.imu if isinstance(self.imu, tuple) else (self.imu or Imu(),)

    def told_by(self, device: Imu | None) -> Rig:
        """The rig with what the recorder's own IMU, its first, says of its age, where the file says nothing of it."""
        first, *others = self.imus
        own = first.told_by(device)
        return self if own is first else structs.replace(self, imu=(own, *others))


def _listed(entry: float | tuple[float, ...]) -> tuple[float, ...]:
    return tuple(map(float, entry)) if isinstance(entry, tuple) else (float(entry),)


def joint_count(mechanism: Mechanism) -> int:
    """Number of joints of the mechanism. Raises KeyError where there is none of its name."""
    return joints_of(mechanism.model, mechanism.links)


def load_rig(path: Path | str) -> Rig:
    """Read and check rig.toml. Raises `InputError` naming the file and the key."""
    return read_rig_file(path).rig


class RigFile(NamedTuple):
    """A rig file as it was when it was read, once: its text and what it says belong together."""

    path: Path
    text: str
    rig: Rig

    @property
    def sha256(self) -> str:
        """SHA-256 sum of the text, in hexadecimal digits."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def read_rig_file(path: Path | str, sha256: str = "") -> RigFile:
    """The rig file at `path`. Raises `InputError` naming the file and the key, and where it is not the one with
    `sha256` any more."""
    where = str(path)
    try:
        with input_errors(path, "give the rig's TOML file with --rig"):
            text = read_bytes(path, MOST_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(where, "is not UTF-8 text", "save the rig file as UTF-8") from None
    file = RigFile(Path(path), text.replace("\r\n", "\n"), parse_rig(text, where))
    if sha256 and file.sha256 != sha256:
        raise InputError(where, "was edited after legid live had read it", "start legid live again")
    return file


def _suggestion(message: str) -> str:
    """For a key that there is not: the one of its table that is spelt most like it."""
    unknown = re.search(r"unknown field `(.+?)`(?: - at `(?:\$\.)?([\w.]+)`)?", message)
    table: Any = Rig
    for name in (unknown[2] or "").split(".") if unknown else ():
        kinds = [get_type_hints(table)[name]] if name in getattr(table, "__struct_fields__", ()) else []
        table = next((k for kind in kinds for k in (kind, *get_args(kind)) if hasattr(k, "__struct_fields__")), table)
    return did_you_mean(unknown[1], table.__struct_fields__) if unknown else ""


def parse_rig(text: str, where: str = "rig.toml") -> Rig:
    """Rig from the text of a rig.toml; `where` names it in errors."""
    try:
        tables = tomllib.loads(text)
        rig = msgspec.convert(tables, Rig)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"not valid TOML: {error}", "correct that line") from None
    except msgspec.ValidationError as error:
        message = str(error).replace("`$.", "`").replace("Object", "rig")
        hint = _suggestion(message)
        raise InputError(where, message[0].lower() + message[1:] + hint,
                         "see docs/rig.md") from None
    except RecursionError:
        raise InputError(where, "is nested too deep", "a rig file has tables of lists, no more") from None
    _check_finite(rig, where)
    if rig.motor.torque_constant_nm_per_a and "torque_constant_nm_per_a" not in tables.get("calibration", {}):
        by_sheet = rig.motor.torque_constant_nm_per_a * rig.motor.gear_ratio
        rig = structs.replace(rig, calibration=structs.replace(rig.calibration, torque_constant_nm_per_a=by_sheet))
    check_mount(rig.calibration.imu_mount, where)
    check_accelerometer(rig.calibration.accel_matrix, where)
    check_mechanism(rig.mechanism.model, where)
    if rig.distance_meter is not None and rig.mechanism.model not in ("biped3", "chain"):
        raise InputError(where, f"a {rig.mechanism.model} stands on no ground that a distance_meter could see",
                         "take out the table [distance_meter]")
    if rig.walker is not None and (rig.mechanism.model != "biped3" or rig.distance_meter or rig.imu is not None):
        raise InputError(where, "has a [walker]: that is for a biped3 without distance_meter or imu", "take one out")
    n = joint_count(rig.mechanism)
    named = [("mechanism.actuated", rig.mechanism.actuated), ("terms.rotor_inertia", rig.terms.rotor_inertia or ()),
             ("terms.torque_offset", rig.terms.torque_offset or ()),
             ("terms.encoder_zero", rig.terms.encoder_zero or ()), ("mechanism.encoders", rig.mechanism.encoders or ())]
    for key, joints in named:
        bad = [j for j in joints if j > n]
        if bad:
            raise InputError(where, f"{key} names joint {bad[0]}, {rig.mechanism.model} has {n}", "correct the list")
        if len(set(joints)) < len(joints):
            raise InputError(where, f"{key} names a joint twice", "correct the list")
    levels = rig.noise.encoder_rad
    if isinstance(levels, tuple) and len(levels) != n:
        raise InputError(where, f"noise.encoder_rad has {len(levels)} levels, {rig.mechanism.model} has {n} joints",
                         "give one number for all encoders, or one for each joint")
    voltage = rig.mechanism.input == "voltage"
    wrong = None if rig.servo is None else faults(rig.servo, len(rig.mechanism.actuated), voltage)
    if wrong is not None:
        raise InputError(where, *wrong)
    if not rig.imus:
        raise InputError(where, "imu is an empty list", "give a table [[imu]] for each IMU, or take the key out")
    for lack in (imu.lack for imu in rig.imus):
        if lack is not None:
            raise InputError(where, *lack)
    controller = rig.devices.controller
    if controller is not None and controller.node >= NODES and controller.kind == "legid":
        raise InputError(where, f"devices.controller.node is {controller.node}, a leg controller's are 0 to "
                         f"{NODES - 1}", "give the node that its firmware has")
    _check_prior(rig, where)
    _check_tolerance(rig, where)
    _check_levels(rig, where)
    _check_correlations(rig, where)
    return rig


def _check_prior(rig: Rig, where: str) -> None:
    """Each entry is a value with its standard deviation."""
    for name, entry in rig.prior.items():
        if len(entry) != 2 or not all(map(math.isfinite, entry)) or not entry[1] > 0.0:
            raise InputError(where, f"prior.{name} is {list(entry)}", f"give its value and standard deviation, such as "
                             f"{name} = [1.04, 0.02]; a value that is exact goes into --fix {name}=VALUE")


def _check_tolerance(rig: Rig, where: str) -> None:
    """Numbers from zero up; `none` is true or false, and nothing else is."""
    for name, entry in rig.tolerance.items():
        if isinstance(entry, bool) != (name == "none"):
            raise InputError(where, f"tolerance.{name} is {entry}", "give a standard deviation, such as "
                             "imu_lever_arm = 0.001, or none = true")
    for name, values in rig.tolerances.items():
        if not all(map(math.isfinite, values)) or min(values, default=0.0) < 0.0:
            raise InputError(where, f"tolerance.{name} is {list(values)}", "give standard deviations from zero up")


def _check_levels(rig: Rig, where: str) -> None:
    """As many levels as channels; a joint without a motor has no torque sensor to err, but `passive_nm`."""
    axes = rig.noise.accel_mps2
    if isinstance(axes, tuple) and len(axes) != 2:
        raise InputError(where, f"noise.accel_mps2 has {len(axes)} levels, the accelerometer 2 axes in the plane",
                         "give one number for both, or one for x and one for y")
    joints, driven, disturbance = joint_count(rig.mechanism), len(rig.mechanism.actuated), rig.noise.disturbance
    for name, levels, count, kind in (
            ("torque_nm", rig.noise.torque_nm, driven, "driven"),
            ("passive_nm", rig.noise.passive_nm, joints - driven, "passive"),
            ("disturbance.torque_nm", disturbance and disturbance.torque_nm, joints, ""),
            ("disturbance.time_constant_s", disturbance and disturbance.time_constant_s, joints, "")):
        if isinstance(levels, tuple) and len(levels) != count:
            kind += " joint" if count == 1 else " joints"
            raise InputError(where, f"noise.{name} has {len(levels)} levels, the mechanism has {count} {kind.strip()}",
                             f"give one number for all {kind.strip()}, or one for each by rising joint")


def _check_correlations(rig: Rig, where: str) -> None:
    """A covariance of noise can be inverted only where no channel's error follows from the others'."""
    if not abs(rig.noise.accel_correlation) < 1.0:
        raise InputError(where, f"noise.accel_correlation is {rig.noise.accel_correlation:g}: one axis would say "
                         "nothing of its own", "give a number between -1 and 1")
    rows, driven = rig.noise.torque_correlation, len(rig.mechanism.actuated)
    if not rows:
        return
    remedy = f"give {driven} rows of {driven} numbers, by rising driven joint, 1.0 on the diagonal"
    if len(rows) != driven or any(len(row) != driven for row in rows):
        raise InputError(where, f"noise.torque_correlation is not {driven} by {driven}, as mechanism.actuated", remedy)
    if any(rows[i][j] != (1.0 if i == j else rows[j][i]) for i in range(driven) for j in range(driven)):
        raise InputError(where, "noise.torque_correlation is not symmetric with 1 on its diagonal", remedy)
    import numpy as np  # `legid --help` reads rigs' types, and needs no mathematics

    if not np.linalg.eigvalsh(np.array(rows))[0] > 0.0:
        raise InputError(where, "noise.torque_correlation is not positive definite",
                         "give the correlations of noise that was measured on all joints at once")


def _check_finite(table: Struct, where: str, path: str = "") -> None:
    """TOML writes inf and nan; a limit that is either limits nothing."""
    for name in table.__struct_fields__:
        value = getattr(table, name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, Struct):
                _check_finite(item, where, f"{path}{name}.")
            elif isinstance(item, float) and not math.isfinite(item):
                raise InputError(where, f"{path}{name} is {item:g}", "give a number that the rig really has")
