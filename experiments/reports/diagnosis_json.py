"""A `Diagnosis` as the documents that leave the program: diagnosis JSON, and the extended model as MODEL.json."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from daq import Dataset, FloatArray
from estimator.diagnosis import CandidateScore, Cause, Diagnosis, SensorGain, ShortRuns
from experiments.models import (
    MechanismSettings,
    Model,
    ParameterValue,
    Provenance,
    build_mechanism,
    effect_value,
    fitted_settings,
    structure_values,
)
from experiments.provenance import program_version
from experiments.reports.next_step import next_step
from experiments.reports.structure import structure_document
from experiments.session import SetAside, Setup, faulty_readings

SCHEMA = "legid.diagnosis/1"
WHOLE_RIG = frozenset({"rotor_inertia"})
"""Effects that the library places at a joint and the contract does not."""


def diagnosis_document(found: Diagnosis, aside: Sequence[SetAside] = (), used: Sequence[Dataset] = ()
                       ) -> dict[str, Any]:
    """`legid.diagnosis/1` of docs/formats.md, with the sentence, warnings and the next experiment added to it; `aside`
    are the runs that were set aside, `used` the others."""
    before, after = found.torque_rms_nm
    return {
        "schema": SCHEMA, "verdict": found.verdict, "sentence": found.sentence,
        "causes": [_cause(cause) for cause in found.causes],
        "candidates": [_candidate(candidate) for candidate in found.candidates],
        "gain": {
            "confirm_runs": list(found.confirm_runs),
            "free_run_rmse": rmse(found.sensors),
            "torque_rms_nm": {"before": list(before), "after": list(after)},
            "gap_closed": found.gap_closed,
            "gap_closed_ci95": None if found.gap_closed_ci95 is None else list(found.gap_closed_ci95),
            **pieces(found.short)},
        "material": found.material, "budget": [
            {"what": row.what, "effect": row.effect,
             "joint": None if row.effect is None else contract_joint(row.effect, row.joint), "share": row.share,
             "ci95": list(row.ci95), "of_error": row.of_error, "of_error_ci95": list(row.of_error_ci95)}
            for row in found.budget],
        "immaterial": [_cause(cause) for cause in found.immaterial],
        "within_tolerance": [
            {"effect": one.effect, "joint": contract_joint(one.effect, one.joint), "name": one.name, "unit": one.unit,
             "value": one.value, "tolerance": one.tolerance} for one in found.within_tolerance],
        "remainder": None if found.remainder is None else {
            "joint": found.remainder.joint, "channel": found.remainder.channel,
            "depends_on": found.remainder.depends_on},
        "structure": None if found.structure is None else structure_document(found.structure),
        "probability": found.probability,
        "stability": found.stability,
        "rotations": [{"confirm_runs": list(r.runs), "sizes": dict(r.sizes), "falls": r.falls}
                      for r in found.rotations],
        "error": None if found.error is None else {"before": found.error[0], "after": found.error[1]},
        "compared": [{"causes": [{"effect": effect, "joint": contract_joint(effect, joint)}
                                 for effect, joint in map(split_key, keys)], "error": _finite(error)}
                     for keys, error in found.compared],
        "parameters": {"nominal": dict(found.nominal), "extended": dict(found.extended)},
        "not_testable": [{"effect": effect, "joint": contract_joint(effect, joint), "why": why}
                         for effect, joint, why in untestable(found)],
        "runs": {group: list(found.runs.get(group, ())) for group in ("fit", "screen", "confirm")},
        "warnings": list(found.warnings), "next_experiment": found.next_experiment,
        "next_step": next_step(found), "wall_s": found.wall_s,
        "set_aside": [run.document for run in aside], "readings": faulty_readings(used),
    }


def rmse(sensors: Mapping[str, SensorGain]) -> dict[str, dict[str, float | None]]:
    """Free-run errors as docs/formats.md has them."""
    return {column: {"before": _finite(gain.before), "after": gain.after, "floor": gain.floor}
            for column, gain in sensors.items()}


def pieces(short: ShortRuns | None) -> dict[str, Any]:
    """The gain in pieces, where free runs over whole runs could not show it."""
    return {} if short is None else {"pieces": {
        "horizon_s": short.horizon_s, "rmse": rmse(short.sensors), "gap_closed": short.closed,
        "gap_closed_ci95": None if short.ci95 is None else list(short.ci95)}}


def contract_joint(effect: str, joint: int | None) -> int | None:
    """The joint as the contract counts it: null for what belongs to the whole rig."""
    return None if effect in WHOLE_RIG else joint


def split_key(key: str) -> tuple[str, int | None]:
    """(effect, joint from 1 or None) of the estimator's key `effect@joint`."""
    name, _, joint = key.partition("@")
    return name, int(joint) if joint else None


def _cause(cause: Cause) -> dict[str, Any]:
    near = dict.fromkeys(split_key(key)[0] for key in cause.confusable_with)
    return {"effect": cause.effect, "joint": contract_joint(cause.effect, cause.joint), "meaning": cause.sentence,
            "size": [{"name": s.name, "unit": s.unit, "value": s.value, "ci95": list(s.ci95)} for s in cause.size],
            "p_value": cause.p_value, "confusable_with": list(near)}


def _candidate(candidate: CandidateScore) -> dict[str, Any]:
    return {"effect": candidate.effect, "joint": contract_joint(candidate.effect, candidate.joint),
            "score": candidate.score, "p_value": candidate.p_value, "size": candidate.size,
            "smallest_detectable": _finite(candidate.smallest_detectable), "unit": candidate.unit}


def _finite(value: float) -> float | None:
    """null for what is not determined: JSON has no infinity."""
    return value if np.isfinite(value) else None


def untestable(found: Diagnosis) -> list[tuple[str, int | None, str]]:
    """(effect, joint from 1 or None, why) of what these runs cannot test."""
    tested = {candidate.effect for candidate in found.candidates}
    rows = [(*split_key(key), why) for key, why in found.not_testable.items()]
    return [row for row in rows if not (row[0] in WHOLE_RIG and row[0] in tested)]


def diagnosed_model(found: Diagnosis, setup: Setup, gear_ratio: float, date: datetime | None = None) -> Model:
    """The extended model, or the nominal one where the verdict extends nothing."""
    settings = setup.settings if found.mechanism is None else fitted_settings(setup.settings, found.mechanism)
    mechanism = build_mechanism(settings)
    p = mechanism.p
    if found.effects:
        beta, covariance = found.extended_beta[:p], found.extended_covariance
    else:
        beta = np.array([found.nominal[name] for name in mechanism.names])
        covariance = np.diag([found.nominal_std[name] ** 2 for name in mechanism.names])
    return Model(
        schema="legid.model/1", mechanism=settings, parameters=_parameters(settings, beta),
        covariance=tuple(tuple(float(c) if np.isfinite(c) else None for c in row) for row in covariance),
        noise={name: float(level) for name, level in found.noise.items()},
        hold=found.hold or setup.options.hold,
        effects=tuple(effect_value(effect, size) for effect, size in found.effects),
        structure=None if found.structure is None else structure_values(found.structure), gear_ratio=gear_ratio,
        reach=tuple((float(low), float(high)) for low, high in (found.angle_range if found.effects else ())),
        provenance=Provenance(runs=_whole_runs(_fitted(found), setup),
                              method="mle",
                              sensors=setup.options.sensors,  # type: ignore[arg-type]
                              date=(date or datetime.now(UTC)).isoformat(timespec="seconds"),
                              version=program_version()))


def _fitted(found: Diagnosis) -> Iterable[str]:
    """Runs that the model was fitted to: a structure is learnt from the held-out ones, too."""
    groups = ("fit", "screen", *(("confirm",) if found.structure is not None else ()))
    return [name for group in groups for name in found.runs.get(group, ())]


def _whole_runs(names: Iterable[str], setup: Setup) -> tuple[str, ...]:
    """The runs that `names` are of: a diagnosis of few runs cuts them into pieces, `ONE.csv[0.0-4.2 s]`."""
    runs = [data.name for data in setup.datasets]
    return tuple(dict.fromkeys(next((run for run in runs if name.startswith(f"{run}[")), name) for name in names))


def _parameters(settings: MechanismSettings, beta: FloatArray) -> tuple[ParameterValue, ...]:
    return tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(value))
                 for p, value in zip(build_mechanism(settings).parameters, beta))
