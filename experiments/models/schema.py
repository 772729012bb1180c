"""MODEL.json as typed structs: a mechanism, its parameters, the effects that extend it, where they come from."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from estimator.model import VELOCITY_SCALE
from experiments.provenance import Origin

SCHEMA = "legid.model/1"
NonNegative = Annotated[float, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Joint = Annotated[int, Meta(ge=1)]


class _Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class ImuSettings(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Place of an IMU."""

    link: Joint = 1
    lever_arm_m: NonNegative = 0.0


class MechanismSettings(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Arguments of `build_mechanism`; joints count from 1."""

    model: str
    """Of `builders` of estimator.model."""
    actuated: tuple[Joint, ...]
    gravity_mps2: NonNegative = 9.81
    links: Annotated[int, Meta(ge=1, le=20)] = 2
    input: Literal["torque", "voltage"] = "torque"
    prismatic: bool = False
    lever_arm_m: NonNegative = 0.0
    imus: tuple[ImuSettings, ...] = ()
    """In the order of their columns; empty: one on link 1 at `lever_arm_m`, on leg2 and joint1 only."""
    link_lengths_m: tuple[Positive, ...] = ()
    """Of the links that IMUs ride on, from the first."""
    rotor_inertia: tuple[Joint, ...] = ()
    torque_offset: tuple[Joint, ...] = ()
    encoder_zero: tuple[Joint, ...] = ()
    """Joints whose encoders had unknown zeros in the runs that were fitted."""
    friction_velocity_radps: Positive | tuple[Positive, ...] = VELOCITY_SCALE
    """One for all joints, or one each."""
    hips: bool = False
    """Of a biped3, whether its joints are a walker's hips and its legs change places; see docs/formats.md."""

    @property
    def has_imu(self) -> bool:
        """Whether a simulation has an IMU's columns."""
        return bool(self.imus) or self.model == "leg2"


class ParameterValue(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of beta."""

    name: str
    meaning: str
    unit: str
    value: float


class EffectValue(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One effect that extends the nominal model."""

    name: str
    joint: Joint | None
    """From 1; null for an effect of the whole rig."""
    sizes: dict[str, float]
    """Size -> value, in the units that the effect states."""
    shapes: dict[str, float] = {}
    """Shape -> value, likewise."""


class TableInput(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One quantity that a table depends on."""

    variable: Literal["angle", "rate", "motor torque"]
    joint: Joint


class TorqueTable(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Torque at knots of one or two inputs, linear between them; beyond them it keeps its edge value."""

    inputs: tuple[TableInput, ...]
    directed: bool = False
    """Whether the smoothed sign of the joint's rate multiplies it."""
    knots: tuple[tuple[float, ...], ...]
    """One increasing list an input [rad, rad/s or N m]"""
    values: tuple[float, ...]
    """[N m], those of one knot of the first input after those of the one before"""
    std: tuple[NonNegative, ...]
    """Standard deviations of the values; they hold for the model's parameters as they are."""


class JointTorque(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Torque that a joint takes in addition: a constant and the sum of its tables."""

    joint: Joint
    constant: float
    tables: tuple[TorqueTable, ...]
    noise_nm: NonNegative
    """Noise level of the residual torque that it was learnt from."""


class StructureValues(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Torques without a listed cause that repeat in all runs as functions of the state."""

    torques: tuple[JointTorque, ...]
    removed: float
    """Share of the free-run rms error on left-out runs that they remove."""
    removed_ci95: tuple[float, float]


class LawValues(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sizes of one fault as the law of a position loop shows them in the runs."""

    effect: str
    joint: Joint
    size: tuple[float, ...]
    std: tuple[float | None, ...]
    """null where too few blocks of the runs show it"""
    blocks: Annotated[int, Meta(ge=0)]


class ReferenceValues(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Statistics that `legid diagnose --against MODEL.json` needs of the runs of a model, instead of the runs."""

    runs: tuple[str, ...]
    sensors: Literal["imu", "encoder"]
    hold: str
    friction_velocity_radps: tuple[Positive, ...]
    followers: tuple[Joint, ...] = ()
    """Joints whose torque is that of their position loop's law."""
    beta: tuple[float, ...]
    """Of the nominal model, without effects."""
    noise: dict[str, tuple[float | None, ...]]
    """torque, encoder (null without one), gyro and accel (x and y of each IMU in turn); 1 sigma."""
    reach: tuple[tuple[float, float], ...]
    common: float
    """Variance of unexplained structure that all runs have, over that of a size estimated from one run"""
    own: float
    """The same of structure that each run has for itself"""
    freedom: float
    unit: tuple[float, ...]
    """Variance of each column's size by one run"""
    drift: tuple[float, ...] = ()
    """Further variance of each column from run to run, in units of that; empty where no column drifts."""
    columns: tuple[str, ...]
    """Parameters, then every size that is tried."""
    score: tuple[float, ...]
    information: bytes
    """Upper triangle by rows, little-endian doubles, base64."""
    levels: dict[str, tuple[float, float]]
    """Column of a run to mean and variance of the log level of its noise over the runs."""
    law: tuple[LawValues, ...] = ()
    """Empty where no loop has its input measured, and in models of earlier versions."""
    errors: dict[str, tuple[float, float]] = {}
    """Channel to the same of its free-run error, each run predicted by the others."""


class PartValues(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Part of the covariance of the parameters that one source of uncertainty adds."""

    source: str
    """noise, scatter, structure, torque_gain, or an effect with its joint, such as joint_stiffness@2."""
    tolerance: tuple[NonNegative, ...] = ()
    """Of each size of an effect, 1 sigma, SI."""
    directions: tuple[tuple[float, ...], ...]
    """Rows in the order of `parameters`; the sum of their outer products is the part."""


class TrustValues(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Whether the parameters can be trusted, as the fit said."""

    level: Literal["good", "caution", "bad"]
    sentence: str
    reasons: tuple[str, ...] = ()


class Provenance(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Origin of the numbers."""

    runs: tuple[str, ...]
    method: str
    sensors: Literal["imu", "encoder"]
    date: str
    """UTC, ISO 8601."""
    version: str
    """Of this program."""
    origin: Origin | None = None
    """The files behind them with their hashes; None in models of earlier versions."""
    prior: dict[str, tuple[float, float]] = {}
    """Value and standard deviation of what was known before the fit, which is then a maximum a posteriori."""
    damaged: tuple[str, ...] = ()
    """Runs that were damaged, with what is missing of them."""


class Model(_Part, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One MODEL.json."""

    schema: Literal["legid.model/1"]
    mechanism: MechanismSettings
    parameters: tuple[ParameterValue, ...]
    covariance: tuple[tuple[float | None, ...], ...]
    """In the order of `parameters`, then sizes and shapes of each of `effects`; null where not determined."""
    ci95: tuple[tuple[float, float] | None, ...] = ()
    """95 % intervals of `parameters`, null where not determined: wider than the covariance alone where runs disagreed.
    Empty where they are by it, and in models of earlier versions."""
    budget: tuple[PartValues, ...] = ()
    """Parts of the parameters' covariance; empty without tolerances, and in models of earlier versions."""
    trust: TrustValues | None = None
    """None in models of earlier versions, and in those that no fit wrote."""
    noise: dict[str, float]
    """1 sigma by channel; accel_correlation between the accelerometer's axes where one was declared."""
    hold: str
    """How a torque sample acts until the next."""
    effects: tuple[EffectValue, ...] = ()
    structure: StructureValues | None = None
    """Only where a diagnosis offered it; None in models of earlier versions."""
    gear_ratio: Positive = 1.0
    """Of the motor; effects may depend on it."""
    reach: tuple[tuple[float, float], ...] = ()
    """Smallest and largest angle of each joint in the runs fitted [rad]; effects may depend on it."""
    reference: ReferenceValues | None = None
    """For comparisons with later runs; None in a model that `legid diagnose` did not write, or of fewer than two runs.
    """
    provenance: Provenance

    def __repr__(self) -> str:
        return f"<Model: {str(self).partition(chr(10))[0]}>"

    def __str__(self) -> str:
        """Mechanism, parameters and effects in a few lines; the document itself is JSON."""
        lines = [f"{self.mechanism.model}, fitted by {self.provenance.method} to {', '.join(self.provenance.runs)}",
                 *(f"{one.name} = {one.value:.6g} {one.unit}" for one in self.parameters),
                 *(f"effect: {one.name}" for one in self.effects)]
        return "\n".join(lines)

    @property
    def beta(self) -> list[float]:
        """Values in the order of `parameters`."""
        return [parameter.value for parameter in self.parameters]
