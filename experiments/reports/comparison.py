"""Two models side by side, as text: `legid compare`."""

from __future__ import annotations

from experiments.console import text_table
from experiments.documents import ComparisonDocument, Value, finite
from experiments.judge import NAMES, Estimate, horizon_text, number

PARAMETER_HEADER = ["parameter", "A", "95 % interval", "B", "95 % interval", "z of B - A", "unit", "meaning"]
ERROR_HEADER = ["horizon", "sensor", "rms error of A", "of B", "B / A", "95 % interval", "better"]


def parameter_rows(found: ComparisonDocument) -> list[list[str]]:
    """One row of PARAMETER_HEADER a parameter."""
    rows = []
    for p in found.parameters:
        cells = [cell for side in (p.a, p.b) for cell in _cells(side)]
        rows.append([p.name, *cells, "" if p.z is None else f"{p.z:+.1f}", p.unit, p.meaning])
    return rows


def _cells(side: Value | None) -> tuple[str, str]:
    if side is None:
        return "", ""
    low, high = map(finite, side.ci95)
    return number(side.value, finite(side.std)), Estimate(side.value, finite(side.std), low, high).interval


def error_rows(found: ComparisonDocument) -> list[list[str]]:
    """One row of ERROR_HEADER a horizon and sensor."""
    def rms(value: float | None) -> str:
        return "diverged" if value is None else f"{value:.4g}"

    return [[horizon_text(e.length_s), e.column, rms(e.a), rms(e.b), "" if e.ratio is None else f"{e.ratio:.3f}",
             "" if e.ratio_ci95 is None else f"{e.ratio_ci95[0]:.3f} .. {e.ratio_ci95[1]:.3f}", e.better or ""]
            for e in found.errors]


def comparison_text(found: ComparisonDocument) -> str:
    """Text after `legid compare`."""
    return "\n".join([
        found.trust.sentence, *found.trust.reasons, "", *(f"{name}: {file}" for name, file in zip(NAMES, found.models)),
        "", text_table(PARAMETER_HEADER, parameter_rows(found), {1, 2, 3, 4, 5}), "",
        f"Free runs of {', '.join(found.runs)}:", text_table(ERROR_HEADER, error_rows(found), {2, 3, 4, 5})])
