"""`Diagnosis`: what a diagnosis found, in the contract's terms, with what a report draws from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from daq import FloatArray
from estimator.diagnosis.decision_rule import MATERIAL
from estimator.effects import Effect
from estimator.model import Mechanism
from estimator.prediction import Structure
from estimator.use import Use
from estimator.verdicts import SizeEstimate, Verdict


@dataclass(frozen=True)
class Cause:
    """One named (or possible) cause."""

    effect: str
    joint: int | None
    """1-based, None for effects of the whole rig."""
    sentence: str
    size: tuple[SizeEstimate, ...]
    p_value: float
    gain: float
    """Twice the log likelihood that it gains on the train runs, over the scatter."""
    confusable_with: tuple[str, ...]


@dataclass(frozen=True)
class CandidateScore:
    """One effect of the library as scored before any re-fit."""

    effect: str
    joint: int | None
    score: float
    """Root of the gain: like a number of standard deviations."""
    p_value: float
    """Over all effects and shapes tried."""
    size: float
    """One-step estimate of its first size."""
    smallest_detectable: float
    """Infinite where the nominal parameters imitate it in these runs."""
    unit: str


@dataclass(frozen=True)
class SensorGain:
    """Free-run rms error of one sensor on the test runs, as `legid validate` gives it."""

    before: float
    """Infinite where the nominal simulation diverges"""
    after: float
    floor: float
    """What noise alone would leave: replicates of the extended model."""


@dataclass(frozen=True)
class HorizonGain:
    """Free-run rms error of the extended model over that of the nominal one, on held-out runs, over all sensors."""

    horizon_s: float
    """Infinite: whole runs"""
    ratio: float
    ci95: tuple[float, float]
    """Over resampled pieces of those runs."""


@dataclass(frozen=True)
class Signature:
    """Residual of one cause against its natural variable on the train runs, before and after."""

    title: str
    x_label: str
    y_label: str
    x: FloatArray
    """(m,) bin centres"""
    before: FloatArray
    """(m,) mean residual torque or reading of the nominal model in the bin"""
    before_error: FloatArray
    """(m,) its standard error"""
    curve: FloatArray
    """(m,) what the extended model adds there"""
    after: FloatArray
    """(m,) mean residual of the extended model"""


@dataclass(frozen=True)
class Trace:
    """One test run over time: measured, simulated before and after."""

    run: str
    time_s: FloatArray
    measured: Mapping[str, FloatArray]
    before: Mapping[str, FloatArray]
    after: Mapping[str, FloatArray]


@dataclass(frozen=True)
class BudgetRow:
    """One part of the simulation's error on held-out runs."""

    what: str
    """nominal | cause | remainder | noise"""
    share: float
    """Of the mean squared free-run error beyond noise alone, over all sensors and horizons."""
    ci95: tuple[float, float]
    """Over resampled pieces of those runs."""
    effect: str | None = None
    joint: int | None = None
    """1-based"""
    of_error: float = 0.0
    """Of the whole mean squared error: the rows but `nominal` add up to 1, and none is above it. A cause that raises
    the error has none."""
    of_error_ci95: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Remainder:
    """Place of the residual: the generic term that reduces it most."""

    joint: int | None
    """1-based; None for a sensor of the whole rig"""
    channel: str
    depends_on: str


@dataclass(frozen=True)
class Rotation:
    """One rotation of the split: other held-out runs, and the models fitted to the rest."""

    runs: tuple[str, ...]
    """Held out"""
    sizes: Mapping[str, float]
    """Of the effects that were tried, by `effect@joint.size`"""
    falls: bool
    """Whether the error on these runs falls by a material amount."""


@dataclass(frozen=True)
class Diagnosis:
    """The whole answer; see docs/formats.md, diagnosis JSON."""

    verdict: Verdict
    sentence: str
    """The verdict in one sentence for a person."""
    causes: tuple[Cause, ...] = ()
    candidates: tuple[CandidateScore, ...] = ()
    confirm_runs: tuple[str, ...] = ()
    sensors: Mapping[str, SensorGain] = field(default_factory=dict)
    """Column to its free-run error."""
    torque_rms_nm: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    """rms of the equation's residual torque by joint, before and after."""
    gap_closed: float | None = None
    gap_closed_ci95: tuple[float, float] | None = None
    nominal: Mapping[str, float] = field(default_factory=dict)
    nominal_std: Mapping[str, float] = field(default_factory=dict)
    extended: Mapping[str, float] = field(default_factory=dict)
    extended_std: Mapping[str, float] = field(default_factory=dict)
    not_testable: Mapping[str, str] = field(default_factory=dict)
    runs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Train runs as `fit`, test runs as `confirm`; `screen` is empty"""
    warnings: tuple[str, ...] = ()
    next_experiment: str = ""
    separability: tuple[tuple[str, ...], FloatArray] = ((), np.zeros((0, 0)))
    """Effect labels and the cosines (k, k) between what they would add, nominal parameters projected out."""
    signatures: tuple[Signature, ...] = ()
    traces: tuple[Trace, ...] = ()
    effects: tuple[tuple[Effect, FloatArray], ...] = ()
    """The extension itself, for the saved model."""
    extended_beta: FloatArray = field(default_factory=lambda: np.zeros(0))
    extended_covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(p + sizes, p + sizes)"""
    uses: tuple[Use, ...] = ()
    """What the model is good for, by the test runs"""
    noise: Mapping[str, float] = field(default_factory=dict)
    unmeasured: Mapping[int, str] = field(default_factory=dict)
    """Joint (1-based) to the rms level of the disturbance torque there that counts as noise, with its unit."""
    angle_range: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) range of each joint's angle over the runs that were fitted: what the effects' sizes refer to."""
    by_horizon: tuple[HorizonGain, ...] = ()
    """Of an answer, the shortest horizon first"""
    budget: tuple[BudgetRow, ...] = ()
    probability: float | None = None
    """That the answer is true, by answers to legs whose causes are known (see `calibrated`); None where none is
    stated"""
    in_library: float | None = None
    """The same if its causes are among the effects tried, by these runs (see `probability_of`); None where none is
    stated."""
    error: tuple[float, float] | None = None
    """rms free-run error before and after in units of what noise alone leaves, over all sensors and horizons."""
    compared: tuple[tuple[tuple[str, ...], float], ...] = ()
    """Keys of the effects of every explanation that was compared, and its rms free-run error on the held-out runs in
    the units of `error`; the least error first."""
    immaterial: tuple[Cause, ...] = ()
    """Present, but the simulation's error hardly falls by them."""
    remainder: Remainder | None = None
    structure: Structure | None = None
    """Torques without a listed cause that repeat in all runs; only of `unexplained` and `partial`, where they hold."""
    rotations: tuple[Rotation, ...] = ()
    """Only if the held-out runs were inconclusive; the first rotation is theirs. Then budget and error are of all runs,
    each held out of the fit that it tests."""
    material: float = MATERIAL
    """Smallest relative reduction of the rms error that counts."""
    hold: str = ""
    """How torque was taken to act between samples; empty where nothing was fitted."""
    mechanism: Mechanism | None = None
    """With its friction smoothing velocities, as stated or estimated."""
    wall_s: float = 0.0

    @property
    def stability(self) -> float | None:
        """Share of the rotations in which the error falls by a material amount; None without rotations."""
        return sum(r.falls for r in self.rotations) / len(self.rotations) if self.rotations else None
