"""The result of a fit as the documents that leave the program: fit JSON and MODEL.json."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimator import FitResult
from estimator.fitting import next_measurement
from experiments.judge import check_fit, faults_of, fit_trust, residual_tests
from experiments.models import MechanismSettings
from experiments.reports.budget import budget_document
from experiments.reports.run_agreement import agreement_document
from experiments.reports.second_opinion import opinion_document

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
        "inadmissible": list(faults_of(result)), "remedies": list(result.remedies),
        "warnings": list(result.warnings), "assumptions": list(result.assumptions),
        "findings": [{"role": one.role, "kind": one.kind, "text": one.text}
                     for one in (*result.findings, *check_fit(result))],
        "trust": fit_trust(result).document,
        "residuals": [{"what": c.what, "kind": kind, "outside": c.outside, "largest": c.largest, "band99": c.band}
                      for kind, some in (("auto", auto), ("cross", cross)) for c in some],
    }


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


