"""Parts of `legid.diagnosis/1`: causes, candidates, errors on held-out runs, shares of the error, structure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from math import inf
from typing import Annotated

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType

from estimator.diagnosis import CandidateScore, Diagnosis, SensorGain
from estimator.diagnosis import Cause as PlainCause
from estimator.prediction import Structure as PlainStructure
from estimator.prediction import where_of
from experiments.documents.document import Number, finite, known

Interval = Annotated[tuple[Number, Number], Meta(description="its 95 % interval")]
Place = Annotated[int | None, Meta(description="from 1; null for IMU, base, rotor, timing, or an only motor")]
WHOLE_RIG = frozenset({"rotor_inertia"})
"""Effects that the library places at a joint and the contract does not."""


class Before(Struct, frozen=True, kw_only=True):
    """Error before and after."""

    before: Annotated[Number, Meta(description="of the nominal model")]
    after: Annotated[Number, Meta(description="of the extended one")]


class Named(Struct, frozen=True, kw_only=True):
    """One effect of an explanation."""

    effect: Annotated[str, Meta(description="of the library")]
    joint: Place


class CauseSize(Struct, frozen=True, kw_only=True):
    """One size of a cause."""

    name: Annotated[str, Meta(description="the size")]
    unit: Annotated[str, Meta(description="its unit")]
    value: Annotated[float, Meta(description="in the unit")]
    ci95: Interval


class NamedCause(Struct, frozen=True, kw_only=True):
    """One named, or possible, cause."""

    effect: Annotated[str, Meta(description="of the library (`legid effects`)")]
    joint: Place
    meaning: Annotated[str, Meta(description="in words")]
    size: Annotated[tuple[CauseSize, ...], Meta(description="one entry a size")]
    p_value: Annotated[float, Meta(description="over all effects tried")]
    confusable_with: Annotated[tuple[str, ...], Meta(description="effects that look much like it in these runs")] = ()


class Scored(Struct, frozen=True, kw_only=True):
    """One effect of the library, scored before any fit of it."""

    effect: Annotated[str, Meta(description="of the library")]
    joint: Place
    score: Annotated[float, Meta(description="like a number of standard deviations")]
    p_value: Annotated[float, Meta(description="over all effects tried")]
    size: Annotated[Number, Meta(description="one-step estimate of its first size")]
    smallest_detectable: Annotated[Number, Meta(description="size; null: these runs cannot test it")]
    unit: Annotated[str, Meta(description="of both")]
    motor: Annotated[int | UnsetType, Meta(description="joint of a rotor's motor, if several are tested")] = UNSET


class Errors(Struct, frozen=True, kw_only=True):
    """Free-run rms errors of one sensor."""

    before: Annotated[Number, Meta(description="of the nominal model; null if diverged")]
    after: Annotated[Number, Meta(description="of the extended one")]
    floor: Annotated[Number, Meta(description="of noise alone")]


class OverHorizon(Struct, frozen=True, kw_only=True):
    """Error of the extended model over that of the nominal one."""

    horizon_s: Annotated[float | None, Meta(description="of the free runs [s]; null: whole runs")]
    ratio: Annotated[Number, Meta(description="of rms errors, over all sensors")]
    ci95: Interval


class Torques(Struct, frozen=True, kw_only=True):
    """Residual torques by joint."""

    before: Annotated[tuple[Number, ...], Meta(description="of the nominal model")] = ()
    after: Annotated[tuple[Number, ...], Meta(description="of the extended one")] = ()


class GainOnHeldOut(Struct, frozen=True, kw_only=True):
    """Errors on held-out runs, before and after."""

    confirm_runs: Annotated[tuple[str, ...], Meta(description="held out")]
    free_run_rmse: Annotated[dict[str, Errors], Meta(
        description="by sensor, as of `legid validate EXTENDED --against NOMINAL`")]
    torque_rms_nm: Annotated[Torques, Meta(description="residual torque, rms by joint")]
    gap_closed: Annotated[Number, Meta(description="share of the gap to noise alone, of mean squares (texts: rms)")
                          ] = None
    gap_closed_ci95: Annotated[tuple[Number, Number] | None, Meta(description="its 95 % interval")] = None
    by_horizon: Annotated[tuple[OverHorizon, ...] | UnsetType, Meta(description="of an answer")] = UNSET


class Share(Struct, frozen=True, kw_only=True):
    """One part of the error."""

    what: Annotated[str, Meta(description="`nominal`, `cause`, `remainder` or `noise`")]
    effect: Annotated[str | None, Meta(description="of a cause")]
    joint: Place
    share: Annotated[Number, Meta(description="of the mean square beyond noise")]
    ci95: Annotated[tuple[Number, Number], Meta(description="its 95 % interval")]
    of_error: Annotated[Number, Meta(description="of all of it")] = 0.0
    of_error_ci95: Annotated[tuple[Number, Number], Meta(description="its 95 % interval")] = (0.0, 0.0)


class Residual(Struct, frozen=True, kw_only=True):
    """Place of the residual."""

    joint: Annotated[int | None, Meta(description="from 1; null for a sensor of the whole rig")]
    channel: Annotated[str, Meta(description="where it is largest")]
    depends_on: Annotated[str, Meta(description="what it is a function of")]


class LearntPlace(Struct, frozen=True, kw_only=True):
    """One learnt torque."""

    joint: Annotated[int, Meta(description="from 1")]
    depends_on: Annotated[str, Meta(description="its inputs")]
    rms_nm: Annotated[float, Meta(description="rms torque")]
    noise_nm: Annotated[float, Meta(description="noise level there")]


class ErrorOver(Struct, frozen=True, kw_only=True):
    """Free-run error of one sensor over one horizon."""

    channel: Annotated[str, Meta(description="the sensor")]
    horizon_s: Annotated[Number, Meta(description="length [s]; null: whole segments")]
    before: Annotated[Number, Meta(description="rms error without the structure")]
    after: Annotated[Number, Meta(description="with it")]


class Learnt(Struct, frozen=True, kw_only=True):
    """Torques without a listed cause that repeat in all runs."""

    removed: Annotated[float, Meta(description="share of the error on left-out runs")]
    removed_ci95: Annotated[tuple[Number, ...], Meta(description="its 95 % interval; may be empty")]
    where: Annotated[tuple[LearntPlace, ...], Meta(description="the largest first")]
    error: Annotated[tuple[ErrorOver, ...], Meta(description="one entry a sensor and horizon")]


def contract_joint(effect: str, joint: int | None) -> int | None:
    """The joint as the contract counts it: null for what belongs to the whole rig."""
    return None if effect in WHOLE_RIG else joint


def split_key(key: str) -> tuple[str, int | None]:
    """(effect, joint from 1 or None) of the estimator's key `effect@joint`."""
    name, _, joint = key.partition("@")
    return name, int(joint) if joint else None


def untestable(diagnosis: Diagnosis) -> list[tuple[str, int | None, str]]:
    """(effect, joint from 1 or None, why) of what these runs cannot test."""
    tested = {candidate.effect for candidate in diagnosis.candidates}
    rows = [(*split_key(key), why) for key, why in diagnosis.not_testable.items()]
    return [row for row in rows if not (row[0] in WHOLE_RIG and row[0] in tested)]


def cause_of(cause: PlainCause) -> NamedCause:
    """The entry of one cause."""
    near = dict.fromkeys(split_key(key)[0] for key in cause.confusable_with)
    return NamedCause(
        effect=cause.effect, joint=contract_joint(cause.effect, cause.joint), meaning=cause.sentence,
        size=tuple(CauseSize(name=s.name, unit=s.unit, value=s.value, ci95=(known(s.ci95[0]), known(s.ci95[1])))
                   for s in cause.size),
        p_value=cause.p_value, confusable_with=tuple(near))


def scores_of(candidates: Sequence[CandidateScore]) -> tuple[Scored, ...]:
    """One entry a candidate."""
    tested = Counter(one.effect for one in candidates if one.effect in WHOLE_RIG)
    return tuple(Scored(effect=one.effect, joint=contract_joint(one.effect, one.joint), score=one.score,
                        p_value=one.p_value, size=known(one.size), smallest_detectable=known(one.smallest_detectable),
                        unit=one.unit, motor=one.joint if tested[one.effect] > 1 and one.joint else UNSET)
                 for one in candidates)


def errors_of(sensors: Mapping[str, SensorGain]) -> dict[str, Errors]:
    """Entries by sensor."""
    return {column: Errors(before=known(gain.before), after=known(gain.after), floor=known(gain.floor))
            for column, gain in sensors.items()}


def gains_of(errors: Mapping[str, Errors]) -> dict[str, SensorGain]:
    """The same as the estimator has them: infinite where the nominal simulation diverges."""
    return {column: SensorGain(inf if one.before is None else one.before, finite(one.after), finite(one.floor))
            for column, one in errors.items()}


def gain_of(diagnosis: Diagnosis) -> GainOnHeldOut:
    """The entry `gain` of a diagnosis."""
    before, after = diagnosis.torque_rms_nm
    return GainOnHeldOut(confirm_runs=diagnosis.confirm_runs, free_run_rmse=errors_of(diagnosis.sensors),
                         torque_rms_nm=Torques(before=tuple(before), after=tuple(after)),
                         gap_closed=diagnosis.gap_closed, gap_closed_ci95=diagnosis.gap_closed_ci95,
                         by_horizon=tuple(OverHorizon(horizon_s=known(one.horizon_s), ratio=known(one.ratio),
                                                      ci95=one.ci95) for one in diagnosis.by_horizon) or UNSET)


def learnt_of(structure: PlainStructure | None) -> Learnt | None:
    """The structure of the residual; None without one."""
    if structure is None:
        return None
    noise = {(one.law.joint or 0) + 1: one.noise_nm for one in structure.torques}
    table = structure.table
    return Learnt(
        removed=structure.removed, removed_ci95=tuple(structure.removed_ci95 or ()),
        where=tuple(LearntPlace(joint=joint, depends_on=inputs, rms_nm=rms, noise_nm=noise[joint])
                    for (joint, inputs), rms in where_of(structure).items()),
        error=tuple(ErrorOver(channel=c, horizon_s=h if np.isfinite(h) else None, before=known(table.rms(0, c, h)),
                              after=known(table.rms(1, c, h))) for c in table.judged for h in table.horizons_s))
