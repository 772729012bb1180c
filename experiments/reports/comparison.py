"""Two models side by side, as text and document: `legid compare`."""

from __future__ import annotations

import math
from typing import Any

from experiments.console import text_table
from experiments.judge import NAMES, Comparison, Estimate, comparison_trust, horizon_text, number

SCHEMA = "legid.comparison/1"
PARAMETER_HEADER = ["parameter", "A", "95 % interval", "B", "95 % interval", "z of B - A", "unit", "meaning"]
ERROR_HEADER = ["horizon", "sensor", "rms error of A", "of B", "B / A", "95 % interval", "better"]


def parameter_rows(found: Comparison) -> list[list[str]]:
    """One row of PARAMETER_HEADER a parameter."""
    rows = []
    for p in found.parameters:
        cells = [cell for side in (p.a, p.b) for cell in _cells(side)]
        rows.append([p.name, *cells, "" if p.z is None else f"{p.z:+.1f}", p.unit, p.meaning])
    return rows


def _cells(side: Estimate | None) -> tuple[str, str]:
    return ("", "") if side is None else (number(side.value, side.std), side.interval)


def error_rows(found: Comparison) -> list[list[str]]:
    """One row of ERROR_HEADER a horizon and sensor."""
    def rms(value: float) -> str:
        return "diverged" if math.isinf(value) else f"{value:.4g}"

    return [[horizon_text(e.horizon_s), e.column, rms(e.a), rms(e.b),
             f"{e.b / e.a:.3f}" if math.isfinite(e.a + e.b) and e.a > 0.0 else "",
             "" if e.ci95 is None else f"{e.ci95[0]:.3f} .. {e.ci95[1]:.3f}", e.better] for e in found.errors]


def comparison_text(found: Comparison) -> str:
    """Text after `legid compare`."""
    trust = comparison_trust(found)
    return "\n".join([
        trust.sentence, *trust.reasons, "", *(f"{name}: {file}" for name, file in zip(NAMES, found.files)), "",
        text_table(PARAMETER_HEADER, parameter_rows(found), {1, 2, 3, 4, 5}), "",
        f"Free runs of {', '.join(found.runs)}:", text_table(ERROR_HEADER, error_rows(found), {2, 3, 4, 5})])


def comparison_document(found: Comparison) -> dict[str, Any]:
    """`legid.comparison/1`; a horizon of null is a whole segment, an error of null diverged."""
    def side(one: Estimate | None) -> dict[str, Any] | None:
        return None if one is None else {"value": one.value, "std": one.std, "ci95": [one.low, one.high]}

    return {
        "schema": SCHEMA, "models": list(found.files), "runs": list(found.runs),
        "parameters": [{"name": p.name, "unit": p.unit, "meaning": p.meaning, "a": side(p.a), "b": side(p.b), "z": p.z}
                       for p in found.parameters],
        "errors": [{"horizon_s": e.horizon_s, "column": e.column, "a": e.a, "b": e.b,
                    "ratio": e.b / e.a if math.isfinite(e.a + e.b) and e.a > 0.0 else None,
                    "ratio_ci95": None if e.ci95 is None else list(e.ci95), "better": e.better or None}
                   for e in found.errors],
        "trust": comparison_trust(found).document, "set_aside": [run.document for run in found.set_aside]}
