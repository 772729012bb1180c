"""The result of a fit as the documents that leave the program: fit JSON and MODEL.json."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from daq import WorkError
from estimator import FitResult
from estimator.fitting import next_measurement
from experiments.models import (
    MechanismSettings,
    Model,
    ParameterValue,
    PartValues,
    Provenance,
    TrustValues,
    fitted_settings,
)
from experiments.provenance import program_version
from experiments.reports.budget import budget_document
from experiments.reports.fit_checks import check_fit
from experiments.reports.residual_tests import residual_tests
from experiments.reports.run_agreement import agreement_document
from experiments.reports.second_opinion import opinion_document
from experiments.reports.trust import fit_trust

FIT_SCHEMA = "legid.fit/1"
LISTED = ((re.compile(r"accel_[xy]_mps2"), "accel_mps2_by_axis"),
          (re.compile(r"torque[0-9]+_nm"), "torque_nm_by_joint"))
"""Levels of single axes and joints in a result, and the list that has them in the file."""


def fit_document(result: FitResult, settings: MechanismSettings) -> dict[str, Any]:
    """`legid.fit/1` of docs/formats.md, with what is undetermined, warned of and assumed added to it.

    A parameter that takes part in what is undetermined has NaN, null in the file, for numbers.
    """
    closed = [p.name not in result.open_parameters for p in result.mechanism.parameters]
    numbers = (np.where(closed, x.T, np.nan).T for x in (result.beta, result.std, result.ci95()))
    rows = zip(result.mechanism.parameters, *numbers)
    auto, cross = residual_tests(result)
    return {
        "schema": FIT_SCHEMA, "model": settings.model, "method": result.method, "sensors": result.sensors,
        "parameters": [{"name": p.name, "meaning": p.meaning, "unit": p.unit, "value": float(value),
                        "std": float(std), "ci95": [float(low), float(high)], "fixed": p.name in result.fixed,
                        **({"at_bound": True} if p.name in result.at_bound else {})}
                       for p, value, std, (low, high) in rows],
        "prior": [{"name": one.name, "value": one.value, "std": one.std, "fitted": one.fitted,
                   "fitted_std": one.fitted_std, "contradiction": one.contradiction} for one in result.prior],
        "prior_conflict": result.prior_conflict,
        "measure_next": None if (advice := next_measurement(result)) is None else advice.document,
        "budget": budget_document(result),
        "loop": [{"key": one.key, "joint": one.joint + 1, "value": one.value, "found": one.found,
                  "ci95": [one.value - one.half, one.value + one.half]} for one in result.loop],
        "tolerances_enlarged": {} if result.budget is None else dict(result.budget.enlarged),
        "noise": noise_document(result.noise),
        "noise_by_run": _by_run(result),
        "torque_residual_rms_nm": [float(rms) for rms in result.torque_residual_rms],
        "converged": bool(result.converged), "iterations": int(result.iterations), "samples": int(result.samples),
        "wall_s": float(result.wall_s), "undetermined": list(map(str, result.undetermined)),
        "hold": {"name": result.hold, "chosen": result.hold_margin is not None, "margin": result.hold_margin},
        "agreement": agreement_document(result), "second_opinion": opinion_document(result),
        "inadmissible": list(_faults(result)), "remedies": list(result.remedies),
        "warnings": list(result.warnings), "assumptions": list(result.assumptions),
        "findings": [{"role": one.role, "kind": one.kind, "text": one.text}
                     for one in (*result.findings, *check_fit(result))],
        "trust": fit_trust(result).document,
        "residuals": [{"what": c.what, "kind": kind, "outside": c.outside, "largest": c.largest, "band99": c.band}
                      for kind, some in (("auto", auto), ("cross", cross)) for c in some],
    }


def check_sound(result: FitResult, for_model: bool) -> None:
    """Raises `WorkError` for a fit that did not converge or that knows nothing; `for_model`, for one that is not sure
    of every parameter too."""
    missing = f"this data does not determine {', '.join(map(str, result.undetermined))}" if result.undetermined else ""
    several = result.agreement is not None and result.agreement.unit == "run" and len(result.agreement.runs) > 1
    if not result.converged:
        raise WorkError(f"did not converge after {result.iterations} iterations; the values above are not to be used, "
                        + ("; or ".join(result.remedies) or _remedy(result, several))
                        + (f"; {missing}" if missing else ""))
    if missing and result.open_parameters >= {p.name for p in result.mechanism.parameters} - set(result.fixed):
        raise WorkError(f"{missing}; move every joint")
    if faults := _faults(result):
        why = "; ".join(faults)
        raise WorkError(f"these parameters are no mechanism's: {why}; "
                        + ("; or ".join(result.remedies) or "no other sign, unit, order or gear of a column that was "
                           "tried makes a mechanism of them: check gravity and the joints under [mechanism], or give a "
                           "value that you know with --fix NAME=VALUE"
                           + ", and fit each run individually with --each" * several))
    if missing and for_model:
        raise WorkError(f"no model was written: {missing}; record richer motion, or give parameters with "
                        "--fix NAME=VALUE")


def _faults(result: FitResult) -> tuple[str, ...]:
    """Reasons why these parameters are not to be used, as the first line of the text says."""
    return tuple(one.text for one in (*result.findings, *check_fit(result)) if one.role == "fault")


def _remedy(result: FitResult, several: bool) -> str:
    """What to do about a fit that did not converge, by what is known of it. More motion helps open parameters alone."""
    if result.undetermined:
        return "record motion of every joint, fast and slow"
    if several:
        return "fit each run individually with --each: one of them may differ from the others"
    return "run legid diagnose on several runs of this leg: the model may lack something"


def model_of(result: FitResult, settings: MechanismSettings, hold: str, runs: Sequence[str],
             date: datetime | None = None) -> Model:
    """The identified model, ready to be saved."""
    covariance = tuple(tuple(float(c) if np.isfinite(c) else None for c in row) for row in result.covariance)
    return Model(
        schema="legid.model/1", mechanism=fitted_settings(settings, result.mechanism),
        parameters=tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(value))
                         for p, value in zip(result.mechanism.parameters, result.beta)),
        covariance=covariance, ci95=_intervals(result),
        trust=TrustValues(level=(trust := fit_trust(result)).level, sentence=trust.sentence, reasons=trust.reasons),
        budget=() if result.budget is None else tuple(
            PartValues(source=part.source, tolerance=part.tolerance,
                       directions=tuple(tuple(map(float, row)) for row in part.directions))
            for part in result.budget.parts),
        noise={name: float(level) for name, level in result.noise.items()},
        hold=result.hold if hold == "auto" else hold,
        provenance=Provenance(runs=tuple(runs), method=result.method,
                              prior={one.name: (one.value, one.std) for one in result.prior},
                              sensors=result.sensors,  # type: ignore[arg-type]
                              date=(date or datetime.now(UTC)).isoformat(timespec="seconds"),
                              version=program_version()))


def noise_document(noise: Mapping[str, float]) -> dict[str, float | list[float]]:
    """Noise levels by channel; levels of single axes and joints are lists, in addition to the common level."""
    found: dict[str, float | list[float]] = {}
    for name, level in noise.items():
        channel = next((whole for one, whole in LISTED if one.fullmatch(name)), None)
        if channel is None:
            found[name] = float(level)
        else:
            own = found.setdefault(channel, [])
            assert isinstance(own, list)
            own.append(float(level))
    return found


def _by_run(result: FitResult) -> dict[str, Any] | None:
    """Levels of single runs; None where all have the same."""
    found = result.run_noise
    return None if found is None else {
        "runs": list(found.runs), "levels": {name: [float(x) for x in own] for name, own in found.levels.items()}}


def _intervals(result: FitResult) -> tuple[tuple[float, float] | None, ...]:
    """Empty where they are by the standard deviations alone."""
    if not result.at_bound and (result.agreement is None or not result.agreement.disagree):
        return ()
    return tuple((float(low), float(high)) if np.isfinite([low, high]).all() else None for low, high in result.ci95())
