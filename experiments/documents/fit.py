"""`legid.fit/1`: identified parameters, as `legid fit --json` writes them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, field

from daq import Dataset
from estimator import FitResult
from estimator.fitting import next_measurement
from experiments.documents.document import (
    Aside,
    Damaged,
    Document,
    From,
    Number,
    Uses,
    finite,
    known,
)
from experiments.documents.fit_parts import (
    Agreement,
    BudgetRow,
    Interval,
    Next,
    Opinion,
    Prior,
    agreement_of,
    budget_of,
    opinion_of,
)
from experiments.documents.tuning import Entry
from experiments.judge import (
    Headline,
    Trust,
    all_uses,
    check_fit,
    faults_of,
    fit_trust,
    friction_shares,
    measure_sentence,
    precision,
    residual_tests,
)
from experiments.models import MechanismSettings
from experiments.session import Choice, SetAside, damaged_runs, faulty_readings

LISTED = ((re.compile(r"accel_[xy]_mps2"), "accel_mps2_by_axis"),
          (re.compile(r"torque[0-9]+_nm"), "torque_nm_by_joint"))
"""Levels of single axes and joints in a result, and the list that has them in the file."""
ByChannel = dict[str, Number | tuple[Number, ...]]


class Parameter(Struct, frozen=True, kw_only=True):
    """One identified parameter."""

    name: Annotated[str, Meta(description="its name")]
    meaning: Annotated[str, Meta(description="what it is")]
    unit: Annotated[str, Meta(description="its unit")]
    value: Annotated[Number, Meta(description="null if not determined, as all its numbers")]
    std: Annotated[Number, Meta(description="standard deviation")]
    ci95: Annotated[Interval, Meta(description="95 % interval")]
    fixed: Annotated[bool, Meta(description="whether it was given")] = False
    at_bound: Annotated[bool | UnsetType, Meta(description="true: held at zero, `ci95` from there")] = UNSET


class LoopValue(Struct, frozen=True, kw_only=True):
    """A value of a position loop that the fit estimated."""

    key: Annotated[str, Meta(description="of `[servo]`")]
    joint: Annotated[int, Meta(description="from 1")]
    value: Annotated[Number, Meta(description="SI")]
    found: Annotated[bool, Meta(description="false: left out, the runs are as likely without it")]
    ci95: Annotated[Interval, Meta(description="95 % interval")]


class LevelsByRun(Struct, frozen=True, kw_only=True):
    """Noise of single runs."""

    runs: Annotated[tuple[str, ...], Meta(description="their names")]
    levels: Annotated[dict[str, tuple[float, ...]], Meta(description="one a run, by channel; `noise` is their rms")]


class Hold(Struct, frozen=True, kw_only=True):
    """Course of the torque between samples."""

    name: Annotated[str, Meta(description="as in MODEL.json")]
    chosen: Annotated[bool, Meta(description="by the likelihood")]
    margin: Annotated[Number, Meta(description="log-likelihood above the next one, or null")]


class FindingEntry(Struct, frozen=True, kw_only=True):
    """One thing that was found about the fit."""

    role: Annotated[str, Meta(description="such as assumption, warning, fault or fact")]
    kind: Annotated[str, Meta(description="for programs")]
    text: Annotated[str, Meta(description="for people")]


class Residual(Struct, frozen=True, kw_only=True):
    """A correlation of residuals, up to 25 samples."""

    what: Annotated[str, Meta(description="a channel")]
    kind: Annotated[Literal["auto", "cross"], Meta(description="`auto`, or `cross`: with a driven torque")]
    outside: Annotated[Number, Meta(description="share beyond `band99`")]
    largest: Annotated[Number, Meta(description="correlation")]
    band99: Annotated[Number, Meta(description="half of the 99 % band")]


class Gain(Struct, frozen=True, kw_only=True):
    """A servo's gain that the fit found."""

    value: Annotated[float, Meta(description="the gain")]
    ci95: Annotated[tuple[float, float], Meta(description="95 % interval")]


class Friction(Struct, frozen=True, kw_only=True):
    """Share of Coulomb friction in the energy that a joint's friction takes."""

    joint: Annotated[int, Meta(description="from 1")]
    coulomb_share: Annotated[float, Meta(description="of the energy that friction takes, in a motion without motors")]
    ci95: Annotated[tuple[float, float], Meta(description="95 % interval")]


class FitDocument(Document, kw_only=True):
    """Identified parameters, what they rest on, and whether they can be trusted."""

    schema: Annotated[Literal["legid.fit/1"], Meta(description="of this document")] = "legid.fit/1"
    model: Annotated[str, Meta(description="the mechanism, as in rig.toml")]
    method: Annotated[str, Meta(description="of `parameters`")]
    sensors: Annotated[str, Meta(description="imu or encoder: source of the pivot's angle")]
    parameters: Annotated[tuple[Parameter, ...], Meta(description="one entry a parameter")]
    prior: Annotated[tuple[Prior, ...], Meta(description="values under `[prior]`")] = ()
    prior_conflict: Annotated[Number, Meta(description="standard deviations a value by which runs contradict them")
                              ] = 0.0
    measure_next: Annotated[Next | None, Meta(description="null if no single value is worth it")] = None
    budget: Annotated[tuple[BudgetRow, ...] | None, Meta(
        description="null, or [parts](docs/trust.md#the-budget) of each interval")] = None
    loop: Annotated[tuple[LoopValue, ...], Meta(description="values of position loops that were estimated")] = ()
    tolerances_enlarged: Annotated[dict[str, float], Meta(description="group to factor")] = field(
        default_factory=dict)
    noise: Annotated[ByChannel, Meta(
        description="1 sigma by channel: `accel_mps2` is the rms of both axes; `torque_nm` the largest of "
        "`torque_nm_by_joint`; several IMUs have `gyro1_radps`, ...; `disturbance2_nm` and `_s` are level and time "
        "constant at joint 2; `unseen2_nm` acts there between samples")]
    noise_by_run: Annotated[LevelsByRun | None, Meta(description="null if equal in all runs")] = None
    torque_residual_rms_nm: Annotated[tuple[Number, ...], Meta(description="measured less modelled, by joint")]
    converged: Annotated[bool, Meta(description="false: use no number")]
    iterations: Annotated[int, Meta(description="of the fit")]
    samples: Annotated[int, Meta(description="used")]
    wall_s: Annotated[Number, Meta(description="time that the fit took [s]")]
    recorded: Annotated[int, Meta(description="samples of the runs, gaps among them; 0: not told")] = 0
    undetermined: Annotated[tuple[str, ...], Meta(description="combinations; their parameters have null for numbers")
                            ] = ()
    hold: Annotated[Hold | None, Meta(description="of the torque between samples")] = None
    agreement: Annotated[Agreement | None, Meta(description="whether runs agree; null if not asked")] = None
    second_opinion: Annotated[Opinion | None, Meta(description="by another method; null if not asked")] = None
    inadmissible: Annotated[tuple[str, ...], Meta(
        description="empty, or why the parameters are not to be used (exit status 1, no model)")] = ()
    remedies: Annotated[tuple[str, ...], Meta(description="readings of the columns that make sense")] = ()
    warnings: Annotated[tuple[str, ...], Meta(description="for people, remedies last")] = ()
    assumptions: Annotated[tuple[str, ...], Meta(description="what the intervals rest on")] = ()
    findings: Annotated[tuple[FindingEntry, ...], Meta(description="all that was found, in order")] = ()
    trust: Annotated[Trust, Meta(description="[the first line](docs/trust.md#the-first-line-of-a-fit)")] = Trust(
        "caution", "")
    uses: Uses = ()
    residuals: Annotated[tuple[Residual, ...], Meta(description="are they white?")] = ()
    precision: Annotated[str, Meta(description="the budget of the leading parameter in a sentence")] = ""
    friction: Annotated[tuple[Friction, ...], Meta(description="of joints without motors")] = ()
    driven: Annotated[tuple[int, ...], Meta(description="joints with a motor, in the order of "
                                            "`torque_nm_by_joint`")] = ()
    force_unit: Annotated[str, Meta(description="of torques: N m, N or V")] = "N m"
    length_unit: Annotated[str, Meta(description="of angles: rad, or m")] = "rad"
    set_aside: Aside = ()
    readings: Annotated[tuple[dict[str, object], ...], Meta(
        description="[faulty readings](docs/exchange.md#a-look-at-the-readings): `run`, `column`, `what`, ...")] = ()
    servo_gain: Annotated[Gain | None, Meta(description="null if it was known")] = None
    chosen: Annotated[tuple[Entry, ...], Meta(description="entries that the records chose")] = ()
    damaged: Damaged = ()
    provenance: From = UNSET

    @property
    def headline(self) -> Headline:
        """First lines: the trust in it."""
        return replace(self.trust.headline, warnings=self.warnings)

    @classmethod
    def of(cls, result: FitResult, settings: MechanismSettings, runs: Sequence[Dataset] = (),
           set_aside: Sequence[SetAside] = (), choices: Sequence[Choice] = (),
           servo_gain: tuple[float, float, float] | None = None) -> Self:
        """The document of a fit of `runs` by a mechanism of `settings`.

        A parameter that takes part in what is undetermined has null for numbers.
        """
        m, noise = result.mechanism, result.run_noise
        return cls(
            model=settings.model, method=result.method, sensors=result.sensors, parameters=_parameters(result),
            prior=tuple(Prior(name=one.name, value=one.value, std=one.std, fitted=one.fitted,
                              fitted_std=one.fitted_std, contradiction=one.contradiction) for one in result.prior),
            prior_conflict=known(result.prior_conflict), measure_next=_next(result), budget=budget_of(result),
            loop=tuple(LoopValue(key=one.key, joint=one.joint + 1, value=known(one.value), found=one.found,
                                 ci95=(known(one.value - one.half), known(one.value + one.half)))
                       for one in result.loop),
            tolerances_enlarged={} if result.budget is None else dict(result.budget.enlarged),
            noise=_listed(result.noise),
            noise_by_run=None if noise is None else LevelsByRun(
                runs=noise.runs, levels={name: tuple(map(float, own)) for name, own in noise.levels.items()}),
            torque_residual_rms_nm=tuple(map(known, result.torque_residual_rms)), converged=bool(result.converged),
            iterations=int(result.iterations), samples=int(result.samples), wall_s=float(result.wall_s),
            recorded=sum(map(len, runs)),
            undetermined=tuple(map(str, result.undetermined)),
            hold=Hold(name=result.hold, chosen=result.hold_margin is not None,
                      margin=None if result.hold_margin is None else known(result.hold_margin)),
            agreement=agreement_of(result), second_opinion=opinion_of(result), inadmissible=faults_of(result),
            remedies=result.remedies, warnings=result.warnings, assumptions=result.assumptions,
            findings=tuple(FindingEntry(role=one.role, kind=one.kind, text=one.text)
                           for one in (*result.findings, *check_fit(result))),
            trust=fit_trust(result), uses=all_uses(result), residuals=_residuals(result),
            precision=precision(result),
            friction=tuple(Friction(joint=one.joint, coulomb_share=one.coulomb, ci95=(one.low, one.high))
                           for one in friction_shares(result)),
            driven=tuple(j + 1 for j in m.actuated), force_unit=m.force_unit, length_unit=m.length_unit,
            set_aside=tuple(set_aside), readings=tuple(faulty_readings(runs)),
            servo_gain=None if servo_gain is None else Gain(value=servo_gain[0], ci95=servo_gain[1:]),
            chosen=tuple(Entry(**choice.document) for choice in choices), damaged=tuple(damaged_runs(runs)))

    @property
    def levels(self) -> dict[str, float]:
        """Noise levels by channel, with those of single axes and joints: accel_x_mps2, torque2_nm, ..."""
        found: dict[str, float] = {}
        for name, level in self.noise.items():
            if isinstance(level, tuple):
                joints = self.driven if len(self.driven) == len(level) else range(1, len(level) + 1)
                names = ["accel_x_mps2", "accel_y_mps2"] if name.startswith("accel") else [
                    f"torque{j}_nm" for j in joints]
                found |= {one: finite(own) for one, own in zip(names, level, strict=True)}
            else:
                found[name] = finite(level)
        return found


def _parameters(result: FitResult) -> tuple[Parameter, ...]:
    closed = [p.name not in result.open_parameters for p in result.mechanism.parameters]
    numbers = (np.where(closed, x.T, np.nan).T for x in (result.beta, result.std, result.ci95()))
    return tuple(Parameter(name=p.name, meaning=p.meaning, unit=p.unit, value=known(value), std=known(std),
                           ci95=(known(low), known(high)), fixed=p.name in result.fixed,
                           at_bound=True if p.name in result.at_bound else UNSET)
                 for p, value, std, (low, high) in zip(result.mechanism.parameters, *numbers))


def _listed(noise: Mapping[str, float]) -> ByChannel:
    """Levels by channel; those of single axes and joints are lists, in addition to the common level."""
    found: ByChannel = {}
    for name, level in noise.items():
        channel = next((whole for one, whole in LISTED if one.fullmatch(name)), None)
        if channel is None:
            found[name] = known(level)
        else:
            before = found.get(channel, ())
            assert isinstance(before, tuple)
            found[channel] = (*before, known(level))
    return found


def _next(result: FitResult) -> Next | None:
    advice = next_measurement(result)
    return None if advice is None else Next(
        name=advice.name, value=known(advice.value), std=known(advice.std), share=known(advice.share),
        widths={name: known(width) for name, width in advice.widths.items()}, undetermined=advice.undetermined,
        text=measure_sentence(result, advice))


def _residuals(result: FitResult) -> tuple[Residual, ...]:
    auto, cross = residual_tests(result)
    kinds: tuple[tuple[Literal["auto", "cross"], Any], ...] = (("auto", auto), ("cross", cross))
    return tuple(Residual(what=c.what, kind=kind, outside=known(c.outside), largest=known(c.largest),
                          band99=known(c.band)) for kind, some in kinds for c in some)
