"""`FitResult`: what an estimator found, what it could not determine, and what its intervals assume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from daq import BoolArray, FloatArray
from estimator.methods import ResultMethod
from estimator.model import Mechanism
from estimator.use import Use

TWO_SIDED = 1.959963984540054
"""Standard deviations to either side of a 95 % interval: the normal distribution's quantile at 0.975."""

RESIDUAL_LAGS = 25
"""Samples up to which residuals are correlated."""
MOST_DISAGREEMENT = 3.0
"""Half widths of a parameter's interval between two estimates, or by a listed effect that the model lacks, beyond which
a fit is not to be trusted."""


@dataclass(frozen=True)
class Trajectory:
    """Estimated motion and sensor predictions of one gap-free segment of one run."""

    run: str
    """Name of the run."""
    time_s: FloatArray
    """(n,)"""
    q: FloatArray
    """(n, joints) [rad]"""
    qd: FloatArray
    """(n, joints) [rad/s]"""
    qdd: FloatArray
    """(n, joints) [rad/s2]"""
    tau: FloatArray
    """(n, joints) model torque Z beta along the estimated motion [N m]."""
    tau_measured: FloatArray
    """(n, joints) measured torque, zero on a passive joint [N m]."""
    measured: Mapping[str, FloatArray]
    """Sensor column -> (n,) measurement."""
    predicted: Mapping[str, FloatArray]
    """Sensor column -> (n,) prediction from the estimated motion."""
    disturbance: FloatArray | None = None
    """(n, joints) estimated coloured disturbance torque [N m]; None where the fit has none."""


@dataclass(frozen=True)
class Combination:
    """Amounts by which parameters can change together without the data noticing."""

    amounts: tuple[tuple[str, float], ...]
    """Name and amount of each, the one that leads first, by 1."""

    def __str__(self) -> str:
        """For a person: "beta2 -0.8*beta3"."""
        (lead, _), *others = self.amounts
        return " ".join([lead, *(f"{amount:+.3g}*{name}" for name, amount in others)])


Role = Literal["assumption", "warning", "fault", "remedy", "doubt", "fact"]
FindingKind = Literal["run_set_aside", "run_doubt", "rig_contradiction", "run_note", "choice", "servo_gain",
                      "noise_share", "level_at_zero", "level_negative", "length", "impossible", "columns",
                      "not_converged", "undetermined", "torque_residual", "passive_joint", "sensor_residual",
                      "repeating_torque", "prior", "runs_disagree", "estimators_disagree", "loose",
                      "omitted_effect", "budget", "sensor_scale", "not_shown"]


@dataclass(frozen=True)
class Finding:
    """One thing that was found about a fit besides its numbers."""

    role: Role
    """- assumption: the intervals depend on it. warning: a person should know it.
    - fault: the parameters must not be used. remedy: what to write into the rig file.
    - `doubt`: a suspect result, so the parameters are not to be trusted. fact: what limits their use."""
    kind: FindingKind
    text: str
    """For a person, one sentence."""

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class RunAgreement:
    """Whether runs agree about the p parameters, and what each says of them where they do not."""

    runs: tuple[str, ...]
    """Their names."""
    p_value: float | None
    """Of runs that have the same parameters scattering as these do; None for one run, which cannot tell."""
    own_std: FloatArray
    """(p,) standard deviations by the noise alone."""
    disagree: bool = False
    """Whether intervals and covariance are wider for it; what follows is empty where they are not."""
    quantile: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(p,) standard deviations to either side of a 95 % interval: Student's, of few runs."""
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(p,) over runs, each counting by what it knows besides the scatter."""
    scatter: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(p,) standard deviation between runs."""
    by_run: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(runs, p) of each run, drawn to the mean by what it does not know."""
    seen: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    """(p,) whether most of a scatter is seen in the runs; else it may belong to another parameter, or be none."""
    unit: Literal["run", "segment"] = "run"
    """What is compared: runs, or segments of a single run."""


@dataclass(frozen=True)
class RunNoise:
    """Noise of single runs, 1 sigma, of the channels in which runs differ."""

    runs: tuple[str, ...]
    """Their names."""
    levels: Mapping[str, FloatArray]
    """gyro_radps, accel_x_mps2, accel_y_mps2, torque1_nm ..., encoder1_rad ... -> (runs,)"""


@dataclass(frozen=True)
class SecondOpinion:
    """Another estimate of the same p parameters from the same data, by a method that fails differently."""

    method: ResultMethod
    """Of this estimate: shooting, or mle where a fit reports shooting."""
    beta: FloatArray
    """(p,)"""
    half_width: FloatArray
    """(p,) half of each 95 % interval."""
    disagreement: FloatArray
    """(p,) |difference| of both estimates over the root of the sum of both squared half widths; NaN where not compared:
    given, at a bound, or not determined by both."""
    held_out: HeldOut | None = None
    """Which of both predicts better; asked where they disagree. None: not asked, or too little data to ask."""

    @property
    def largest(self) -> float:
        """Largest of the disagreements; 0 where nothing is compared."""
        return float(np.nanmax(self.disagreement)) if np.isfinite(self.disagreement).any() else 0.0


@dataclass(frozen=True)
class OmittedEffect:
    """A listed effect that the runs show and the model lacks, and what it would do to the parameters."""

    effect: str
    """Name, with the joint (from 1) where there is one."""
    p_value: float
    """Of such runs without the effect, over all effects tested."""
    parameter: str
    """The one that it moves furthest"""
    half_widths: float
    """How far it moves that one, in halves of the interval"""


@dataclass(frozen=True)
class PriorValue:
    """A body value or parameter that was known before the fit, with what it is after it."""

    name: str
    value: float
    std: float
    """As given."""
    fitted: float
    fitted_std: float
    """By prior and runs together."""

    @property
    def contradiction(self) -> float:
        """Standard deviations by which the runs move the value beyond what the prior makes likely; 0 where they say
        nothing of it."""
        told = self.std**2 - self.fitted_std**2
        return abs(self.fitted - self.value) / told**0.5 if told > 1e-4 * self.std**2 else 0.0


@dataclass(frozen=True)
class BudgetPart:
    """Part of the covariance of the p parameters that one source of uncertainty adds."""

    source: str
    """noise, scatter (between runs), step (to the faults that the runs suggest), structure, torque_gain, or an effect's
    key."""
    directions: FloatArray
    """(k, p) rows; the sum of their outer products is the part."""
    tolerance: tuple[float, ...] = ()
    """Of each size of an effect, 1 sigma, SI: as stated or by default, or as the runs have enlarged it."""

    @property
    def covariance(self) -> FloatArray:
        """(p, p) the part itself."""
        return self.directions.T @ self.directions

    @property
    def std(self) -> FloatArray:
        """(p,) standard deviations that it would make alone."""
        return np.sqrt(np.sum(self.directions**2, axis=0))


@dataclass(frozen=True)
class Budget:
    """Uncertainty budget (JCGM 100): the parts of a fit's covariance, and what the tolerances did to the estimate."""

    parts: tuple[BudgetPart, ...]
    """Their covariances add up to that of the fit."""
    moved: FloatArray
    """(p,) by how much the estimate was moved, to that with the likeliest faults of readings within their tolerances"""
    enlarged: Mapping[str, float] = field(default_factory=dict)
    """Group of tolerances -> factor by which the runs have enlarged it."""

    def part(self, source: str) -> BudgetPart | None:
        """The part of this source; None where there is none."""
        return next((one for one in self.parts if one.source == source), None)


@dataclass(frozen=True)
class HeldOut:
    """Two-fold cross-validation of both methods: each half of the data is predicted by fits to the other half."""

    gain: float
    """Share by which the rms error over a second is lower with shooting than with mle: geometric mean over seconds."""
    ci95: tuple[float, float]
    segments: int
    """Seconds predicted."""
    use: Use | None = None
    """Of a simulation over a second, by shooting"""


class LeftOut(NamedTuple):
    """The fit without a part of its data."""

    where: slice
    """The samples of that part: of a run, or of a part of a single run"""
    beta: FloatArray
    """(p,) parameters by the others"""


@dataclass(frozen=True)
class LoopTerm:
    """One value of a position loop that a fit has estimated together with the parameters."""

    key: str
    """Of `[servo]`"""
    joint: int
    """0-based"""
    value: float
    """As it acts, what the rig file states included; SI"""
    std: float
    found: bool = True
    """Whether the runs show it: else they are as likely without it, and the fit leaves it out."""

    @property
    def half(self) -> float:
        """Half of the 95 % interval."""
        return TWO_SIDED * self.std


@dataclass(frozen=True)
class FitResult:
    """Identified parameters with their covariance, noise levels and the motion they came with."""

    mechanism: Mechanism
    method: ResultMethod
    sensors: str
    """imu | encoder"""
    beta: FloatArray
    """(p,) in the order of `mechanism.parameters`."""
    covariance: FloatArray
    """(p, p)"""
    noise: Mapping[str, float]
    """1 sigma by channel, where estimated or used: gyro_radps, accel_mps2 (root mean square of accel_x_mps2 and
    accel_y_mps2), torque_nm (the largest of torque1_nm ...), encoder_rad, passive_joint_nm; accel_correlation; and of a
    coloured disturbance torque disturbance1_nm with its time constant disturbance1_s, and so on by joint."""
    torque_residual_rms: FloatArray
    """(joints,) rms of measured minus modelled torque [N m]."""
    converged: bool
    iterations: int
    samples: int
    wall_s: float
    undetermined: tuple[Combination, ...] = ()
    """What this data cannot determine: single parameters, or several together."""
    assumptions: tuple[str, ...] = ()
    """What the intervals rest on, one plain sentence each."""
    findings: tuple[Finding, ...] = ()
    """What checks of the fit and of its runs found, in the order in which a person reads it."""
    trajectories: tuple[Trajectory, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Parameters that were given, not estimated."""
    hold: str = "linear"
    """How the torque was taken to act between samples."""
    hold_margin: float | None = None
    """Log-likelihood of that hold above the next one's, where it was chosen by the likelihood."""
    at_bound: Mapping[str, float] = field(default_factory=dict)
    """Levels that came out below zero and are held there -> the upper end of their 95 % interval."""
    agreement: RunAgreement | None = None
    """Whether the runs agree; the covariance has in it what they disagree about. None: the method does not ask."""

    left_out: tuple[LeftOut, ...] = ()
    """The fit without each run, to first order; empty where the method has none, or a single run is too short."""
    uses: tuple[Use, ...] = ()
    """What the model is good for, by data that it was not fitted to; empty where nobody has asked."""
    run_noise: RunNoise | None = None
    """Where runs have levels of their own, each weighs by its own; `noise` is then their root mean square over samples.
    None: all runs have those."""
    second_opinion: SecondOpinion | None = None
    """Of a method that fails differently. None: not asked, or it came to no end."""
    omitted: tuple[OmittedEffect, ...] = ()
    """Asked for by `FitOptions.seeks_omitted`."""
    budget: Budget | None = None
    """Where the tolerances of the rig are not all zero; the covariance has them in it."""
    torque_colour: FloatArray | None = None
    """(joints, RESIDUAL_LAGS) autocorrelation at lags from 1 sample on that the torque residual of a right model has;
    None: it is white."""
    loop: tuple[LoopTerm, ...] = ()
    """Values of position loops that were estimated"""
    prior: tuple[PriorValue, ...] = ()
    prior_conflict: float = 0.0
    """Standard deviations, by known value, by which the runs are likelier without the prior."""
    """What was known before the fit, which is then a maximum a posteriori; empty: a maximum likelihood."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for a person, the remedies last."""
        return tuple(one.text for one in self.findings if one.role in ("warning", "remedy"))

    @property
    def inadmissible(self) -> tuple[str, ...]:
        """Why these parameters are no mechanism's, or the records behind them are read wrongly, one sentence each."""
        return tuple(one.text for one in self.findings if one.role == "fault")

    @property
    def remedies(self) -> tuple[str, ...]:
        """Set-ups under which the same records make sense, the best first, with what to write into the rig file."""
        return tuple(one.text for one in self.findings if one.role == "remedy")

    @property
    def open_parameters(self) -> frozenset[str]:
        """Names of the parameters that take part in what is undetermined: their values mean nothing."""
        return frozenset(name for combination in self.undetermined for name, _ in combination.amounts)

    @property
    def std(self) -> FloatArray:
        """(p,) standard deviations."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def own_std(self) -> FloatArray:
        """(p,) standard deviations by the noise alone, as if all runs had the same parameters."""
        return self.std if self.agreement is None else self.agreement.own_std

    @property
    def half_width(self) -> FloatArray:
        """(p,) half of each 95 % interval."""
        if self.agreement is None or not self.agreement.disagree:
            return TWO_SIDED * self.std
        return self.agreement.quantile * self.std

    @property
    def shown_half_width(self) -> FloatArray:
        """(p,) the same without the scale of the torque, which no runs show and all estimates from them share."""
        scale = None if self.budget is None else self.budget.part("torque_gain")
        if scale is None:
            return self.half_width
        less = np.sqrt(np.maximum(np.diag(self.covariance) - scale.std**2, 0.0))
        return self.half_width * less / np.maximum(self.std, 1e-300)

    @property
    def widening(self) -> FloatArray:
        """(p,) how many times as wide an interval is for what runs disagree about; 1 where it is by noise alone."""
        own = TWO_SIDED * self.own_std
        return np.where(own > 0.0, self.half_width / np.where(own > 0.0, own, 1.0), 1.0)

    def ci95(self) -> FloatArray:
        """(p, 2) 95 % intervals: normal, by Student's t where runs disagree; of a level held at zero from there
        upwards."""
        half = self.half_width
        out = np.stack([self.beta - half, self.beta + half], axis=-1)
        for name, upper in self.at_bound.items():
            out[self.mechanism.column(name)] = 0.0, upper
        return out
