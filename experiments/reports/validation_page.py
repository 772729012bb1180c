"""Free-run simulation against runs not used for the fit: JSON, text and the report's section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimator.prediction import SHORT_S, PredictionTable, Validation, validations_of
from experiments.console import text_table
from experiments.judge import fits_of
from experiments.reports.chart import Band, Line
from experiments.reports.figures import BLUE, GREEN, GREY, ORANGE, picture_lines, plot_lines, window
from experiments.reports.html import Section, Table

SCHEMA = "legid.validation/1"
FIGURE_SECONDS = 20.0
PICTURE_SECONDS = 10.0


def validation_document(table: PredictionTable, sensors: str) -> dict[str, Any]:
    """`legid.validation/1`: summed squared errors (Table V of the paper) and RMSE by run and signal, and the fit by
    sensor [%], null where the simulation diverges."""
    return {"schema": SCHEMA, "sensors": sensors,
            "fit_percent": [{"run": one.run, "whole": fits_of(table, k, np.inf), "short": fits_of(table, k, SHORT_S),
                             "short_s": SHORT_S} for k, one in enumerate(table.runs)],
            "runs": [{"run": v.run, "samples": int(v.time_s.shape[0]), "horizon_s": float(v.horizon_s),
                      "diverged": bool(v.diverged), "initial_state": initial_state(v),
                      "summed_squared_error": _floats(v.sums), "rmse": _floats(v.rmse)}
                     for v in validations_of(table)]}


def initial_state(v: Validation) -> dict[str, float]:
    """Signal -> its value at the start of the free run: angles [rad] or positions [m], and their rates."""
    names, state = list(v.sums), [x for pair in zip(v.q[0], v.qd[0]) for x in pair]
    return {name: float(x) for name, x in zip(names, state, strict=True)}


INITIAL = "Initial states, estimated from the readings by the model's smoother:"


def state_rows(validations: Sequence[Validation]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: one row a segment, its start in the run's own time and every signal there."""
    header = ["run", "start [s]", *validations[0].sums]
    return header, [[v.run, f"{v.time_s[0]:.3f}", *(f"{x:.5g}" for x in initial_state(v).values())]
                    for v in validations]


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


def errors_text(validations: Sequence[Validation]) -> str:
    """The same as text."""
    header, rows = validation_rows(validations)
    return text_table(header, rows, right=set(range(1, len(header))))


FIT_HEADER = ["run", "sensor", "fit, whole run", f"fit, pieces of {SHORT_S:g} s", "95 % band by parameters"]


def fit_rows(table: PredictionTable) -> list[list[str]]:
    """One row of FIT_HEADER a sensor of a run; the band as its rms half width, in the sensor's unit."""
    def share(value: float) -> str:
        return f"{value:.1f} %" if np.isfinite(value) else "diverged"

    rows = []
    for k, one in enumerate(table.runs):
        band = one.bands[0] if one.bands else None
        short = fits_of(table, k, SHORT_S)
        rows += [[one.run, name, share(value), share(short[name]), "" if band is None else
                  f"+-{np.sqrt(np.mean(band[table.channels.index(name)] ** 2)):.2g}"]
                 for name, value in fits_of(table, k, np.inf).items()]
    return rows


def validation_text(table: PredictionTable) -> str:
    """Text after `legid validate`."""
    validations = validations_of(table)
    unit = length_unit(validations[0])
    lines = [errors_text(validations), "",
             text_table(FIT_HEADER, fit_rows(table), right={2, 3, 4}), "",
             "fit: 100 % is exact, 0 % no better than the mean. Band: change of the simulation by the parameters' "
             "uncertainty; a much larger error means that the model lacks something.",
             f"SSE: summed squared error, [{unit}^2] and [{unit}^2/s^2] for rates; RMSE in {unit} and {unit}/s."]
    state_header, states = state_rows(validations)
    lines += ["", INITIAL, text_table(state_header, states, right=set(range(1, len(state_header))))]
    lines += [f"{v.run}: the simulation diverged" for v in validations if v.diverged]
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


def validation_section(table: PredictionTable) -> Section:
    """Table of all runs, figures of the first, with their bands where the table has them. The joint with the worst fit
    leads the page."""
    validations = validations_of(table)
    header, rows = validation_rows(validations)
    state_header, states = state_rows(validations)
    first = validations[0]
    unit = length_unit(first)
    band = table.runs[0].bands[0] if table.runs[0].bands else None
    fits = fits_of(table, 0, np.inf)
    worst = min(range(first.q.shape[1]), key=lambda j: fits.get(f"q{j + 1}_{unit}", np.inf))
    pictures = []
    for j in range(first.q.shape[1]):
        q = first.q[:, j]
        lines = [Line("measured", first.reference_q[:, j], BLUE, 2.2), Line("simulated", q, ORANGE, 0.9)]
        half = None if band is None else band[j, : first.time_s.size]
        shade = "" if half is None else "; shaded, its 95 % band by the parameters' uncertainty"
        shaded = [] if half is None else [Band("95 % by parameters", q - half, q + half, ORANGE)]
        pictures += [
            picture_lines(first.time_s, lines, f"q{j + 1} [{unit}]", f"Joint {j + 1} in run {first.run}: measured, and "
                          f"simulated from its first state and the measured torque alone{shade}.", FIGURE_SECONDS,
                          bands=shaded, leads=j == worst),
            picture_lines(first.time_s, [Line("simulated less measured", q - first.reference_q[:, j],
                                              ORANGE)], f"error of q{j + 1} [{unit}]",
                          f"Joint {j + 1}: the error" + ("; shaded, what the parameters' uncertainty explains of it."
                                                        if half is not None else "."), FIGURE_SECONDS,
                          bands=[] if half is None else [Band("95 % by parameters", -half, half, GREY)])]
    notes = [f"{v.run}: the simulation diverged." for v in validations if v.diverged]
    tables = [Table(FIT_HEADER, fit_rows(table), "Fit: 100 % is exact, 0 % no better than the mean; the band is the "
                    "rms of its half width, in the sensor's unit", frozenset({2, 3, 4})),
              Table(header, rows, right=frozenset(range(1, len(header)))),
              Table(state_header, states, INITIAL.removesuffix(":"), frozenset(range(1, len(state_header))))]
    return Section(
        "Free-run simulation against validation data",
        ["The simulation starts in the measured state and is then driven by the measured torque alone. Only runs that "
         "the fit has not seen test the model. "
         f"SSE is the summed squared error of the paper's Table V, [{unit}²] and, for "
         f"rates, [{unit}²/s²]; RMSE is in {unit} and {unit}/s."], tables, pictures, notes, folded=True)
