"""rig.toml: what is known of a rig before any data, checked against typed structs."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from daq.errors import InputError

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Joint = Annotated[int, Meta(ge=1)]
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
IDENTITY3: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class _Table(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    pass


class Mechanism(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which mechanism hangs there, and which of its joints a motor drives."""

    model: Literal["leg2", "biped3", "joint1", "chain"]
    actuated: tuple[Joint, ...]
    gravity_mps2: NonNegative = 9.81
    links: Annotated[int, Meta(ge=1, le=20)] = 2
    """Number of links; read for `chain` only."""
    input: Literal["torque", "voltage"] = "torque"


class Terms(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Declared extra terms of the nominal model, by joint (1-based)."""

    rotor_inertia: tuple[Joint, ...] = ()
    """J*qdd of a geared rotor, in the joint's own row only [kg m^2]."""
    torque_offset: tuple[Joint, ...] = ()
    """A constant added to the joint's measured torque [N m]."""
    encoder_zero: tuple[Joint, ...] = ()
    """The encoder's zero, another in every run [rad]: of drives that count from where they were switched on."""
    friction_velocity_radps: Positive = 0.005
    """Velocity over which sign(qd) is rounded off [rad/s]."""


class Imu(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    lever_arm_m: NonNegative = 0.0


class Motor(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    gear_ratio: Positive = 1.0


class Noise(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Known standard deviations; what is absent is estimated from the data."""

    gyro_radps: Positive | None = None
    accel_mps2: Positive | None = None
    torque_nm: Positive | None = None
    encoder_rad: Positive | None = None


class Sampling(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    rate_hz: Positive = 100.0
    hold: Literal["auto", "zero", "linear", "average", "smooth"] = "linear"
    """How the measured torque acts between samples; auto: as the motion makes likeliest."""


class Filter(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Zero-phase Butterworth low pass of `wls` and of every starting value."""

    cutoff_hz: Positive | None = None
    """-6 dB point of the forward-backward filter; absent: a tenth of the rate, at most 10 Hz."""
    order: Annotated[int, Meta(ge=1, le=8)] = 4


class ImuDevice(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    bus: str = "/dev/i2c-1"
    address: int = 0x6B
    rate_hz: float = 238.0
    accel_range_g: Literal[2, 4, 8, 16] = 4
    gyro_range_dps: Literal[245, 500, 2000] = 500
    bus_khz: Positive = 400.0
    slow_hz: NonNegative = 0.0
    """Temperature, and the field where there is a magnetometer, so many times a second; 0: not read."""
    magnetometer: int | None = None
    """Its address: 0x1E or 0x1C."""


class ControllerDevice(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    port: str = "/dev/ttyACM0"
    baud: int = 1_000_000
    can: dict[str, str | int | float | bool] | None = None
    """python-can's configuration (interface, channel, bitrate, ...); given, `port` and `baud` are not used."""
    node: Annotated[int, Meta(ge=0, le=63)] = 0
    """The controller's node on CAN."""
    rate_hz: Positive = 500.0
    watchdog_ms: Annotated[int, Meta(ge=5, le=1000)] = 100


class Devices(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    imu: ImuDevice | None = None
    controller: ControllerDevice | None = None


class Limits(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Beyond any of these the torque goes to zero and the run stops, naming the limit."""

    torque_nm: Positive = 2.0
    speed_radps: Positive = 15.0
    q1_rad: Positive = 1.6
    q2_rad: Positive = 2.6
    temperature_degc: Positive = 70.0
    staleness_s: Positive = 0.1
    clock_bound_s: Positive = 0.005


class Calibration(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Measured once on the rig; raw readings stay raw in the run file."""

    knee_zero_rad: float = 0.0
    shunt_offset_a: float = 0.0
    torque_constant_nm_per_a: Positive = 1.0
    """Joint torque per ampere of motor current, gear included."""
    imu_mount: Matrix3 = IDENTITY3
    """Rows: contract x, y, z axes expressed in the chip's frame."""
    gyro_bias_radps: Vector3 = (0.0, 0.0, 0.0)
    accel_bias_mps2: Vector3 = (0.0, 0.0, 0.0)
    accel_matrix: Matrix3 = IDENTITY3
    """Scales and cross-talk of the accelerometer: calibrated = matrix @ (reading - bias), in the chip's frame."""


class Column(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where files of other programs hold a column of the contract: value = sign * scale * unit * reading + offset."""

    name: str
    """As the file calls it."""
    unit: str = ""
    """Of the file; empty: the contract's own."""
    scale: float = 1.0
    """On top of the unit, a torque constant for one."""
    sign: Literal[1, -1] = 1
    offset: float = 0.0
    """Added at the end, in the contract's unit."""
    delay: float = 0.0
    """How late the reading is stamped [s]."""


class Rig(_Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One rig.toml."""

    mechanism: Mechanism
    terms: Terms = Terms()
    imu: Imu = Imu()
    motor: Motor = Motor()
    noise: Noise = Noise()
    sampling: Sampling = Sampling()
    filter: Filter = Filter()
    devices: Devices = Devices()
    limits: Limits = Limits()
    calibration: Calibration = Calibration()
    columns: dict[str, Column] = {}
    """Column of the contract -> where files of other programs hold it."""


JOINTS = {"leg2": 2, "biped3": 3, "joint1": 1}


def joint_count(mechanism: Mechanism) -> int:
    """Number of joints of the mechanism."""
    return mechanism.links if mechanism.model == "chain" else JOINTS[mechanism.model]


def load_rig(path: Path | str) -> Rig:
    """Read and check rig.toml. Raises `InputError` naming the file and the key."""
    where = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(where, error.strerror or str(error), "give the rig's TOML file with --rig") from None
    except UnicodeDecodeError:
        raise InputError(where, "is not UTF-8 text", "save the rig file as UTF-8") from None
    return parse_rig(text, where)


def parse_rig(text: str, where: str = "rig.toml") -> Rig:
    """Rig from the text of a rig.toml; `where` names it in errors."""
    try:
        rig = msgspec.convert(tomllib.loads(text), Rig)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"not valid TOML: {error}", "mend the line named") from None
    except msgspec.ValidationError as error:
        message = str(error).replace("`$.", "`").replace("Object", "rig")
        raise InputError(where, message[0].lower() + message[1:], "see the rig.toml section of the README") from None
    n = joint_count(rig.mechanism)
    named = [("mechanism.actuated", rig.mechanism.actuated), ("terms.rotor_inertia", rig.terms.rotor_inertia),
             ("terms.torque_offset", rig.terms.torque_offset), ("terms.encoder_zero", rig.terms.encoder_zero)]
    for key, joints in named:
        bad = [j for j in joints if j > n]
        if bad:
            raise InputError(where, f"{key} names joint {bad[0]}, {rig.mechanism.model} has {n}", "correct the list")
    return rig
