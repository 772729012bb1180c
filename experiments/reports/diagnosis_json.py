"""A `Diagnosis` as the documents that leave the program: diagnosis JSON, and the extended model as MODEL.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from daq import Dataset
from estimator.diagnosis import CandidateScore, Cause, Diagnosis, SensorGain, ShortRuns
from experiments.documents import WHOLE_RIG, contract_joint, split_key
from experiments.judge import next_step
from experiments.reports.structure import structure_document
from experiments.session import SetAside, faulty_readings

SCHEMA = "legid.diagnosis/1"


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
        "probability": found.probability, "probability_in_library": found.in_library,
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


