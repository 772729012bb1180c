"""Free-run simulation against runs not used for the fit: JSON, text and the report's section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from estimator.fitting import Validation
from experiments.console import text_table
from experiments.reports.figures import BLUE, GREEN, GREY, ORANGE, Line, plot_lines, window
from experiments.reports.html import Picture, Section, Table

SCHEMA = "legid.validation/1"
FIGURE_SECONDS = 20.0
PICTURE_SECONDS = 10.0


def validation_document(validations: Sequence[Validation], sensors: str) -> dict[str, Any]:
    """`legid.validation/1`: summed squared errors (Table V of the paper) and RMSE by run and signal."""
    return {"schema": SCHEMA, "sensors": sensors,
            "runs": [{"run": v.run, "samples": int(v.time_s.shape[0]), "horizon_s": float(v.horizon_s),
                      "diverged": bool(v.diverged), "summed_squared_error": _floats(v.sums), "rmse": _floats(v.rmse)}
                     for v in validations]}


def _floats(values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}


def validation_rows(validations: Sequence[Validation]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: one row a run, SSE and RMSE of every signal."""
    signals = list(validations[0].sums)
    header = ["run", "seconds"] + [f"{kind} {name}" for name in signals for kind in ("SSE", "RMSE")]
    rows = []
    for v in validations:
        cells = [v.run, f"{v.horizon_s:.1f}"]
        for name in signals:
            cells += [f"{v.sums[name]:.4g}", f"{v.rmse[name]:.4g}"]
        rows.append(cells)
    return header, rows


def validation_text(validations: Sequence[Validation]) -> str:
    """What a person reads after `legid validate`."""
    header, rows = validation_rows(validations)
    unit = length_unit(validations[0])
    lines = [text_table(header, rows, right=set(range(1, len(header)))), "",
             f"SSE: summed squared error, [{unit}^2] and [{unit}^2/s^2] for rates; RMSE in {unit} and {unit}/s."]
    lines += [f"{v.run}: the simulation ran away from the measurement" for v in validations if v.diverged]
    return "\n".join(lines)


def length_unit(validation: Validation) -> str:
    """rad, or m where the joint is prismatic."""
    return "m" if "q1_m" in validation.sums else "rad"


def validation_picture(validation: Validation) -> str:
    """All joints of one run in one SVG: measured, and simulated from the first state and the torque alone."""
    part = window(validation.time_s, PICTURE_SECONDS)
    lines = []
    for j in range(validation.q.shape[1]):
        measured, simulated = ((BLUE, ORANGE), (GREEN, GREY))[j % 2]
        lines += [Line(f"q{j + 1} measured", validation.reference_q[part, j], measured, 1.6),
                  Line("simulated", validation.q[part, j], simulated, 1.0, dashed=True)]
    label = "angle [rad]" if length_unit(validation) == "rad" else "position [m]"
    return plot_lines(validation.time_s[part] - validation.time_s[0], lines, label)


def validation_section(validations: Sequence[Validation]) -> Section:
    """Table of all runs, figures of the first."""
    header, rows = validation_rows(validations)
    first = validations[0]
    unit = length_unit(first)
    part = window(first.time_s, FIGURE_SECONDS)
    time_s = first.time_s[part] - first.time_s[0]
    pictures = []
    for j in range(first.q.shape[1]):
        lines = [Line("measured", first.reference_q[part, j], BLUE, 2.2),
                 Line("simulated", first.q[part, j], ORANGE, 0.9)]
        pictures.append(Picture(plot_lines(time_s, lines, f"q{j + 1} [{unit}]"),
                                f"Joint {j + 1} in run {first.run}: measured, and simulated from its first "
                                "state and the measured torque alone."))
    notes = [f"{v.run}: the simulation ran away from the measurement." for v in validations if v.diverged]
    return Section(
        "Free-run simulation against validation data",
        ["The identified model is started in the measured state and then driven by the measured torque alone, on runs "
         f"that the fit has not seen. SSE is the summed squared error of the paper's Table V, [{unit}²] and, for "
         f"rates, [{unit}²/s²]; RMSE is in {unit} and {unit}/s."],
        [Table(header, rows, right=frozenset(range(1, len(header))))], pictures, notes)
