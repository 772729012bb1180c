"""Free-run simulation against runs not used for the fit: text, tables and the report's sections."""

from __future__ import annotations

from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np

from estimator.prediction import SHORT_S, PredictionTable, Validation, validations_of
from experiments.documents import RunFit, Segment, ValidationDocument, finite
from experiments.judge import Files, sentence_of, with_names
from experiments.models import Model
from experiments.reports.chart import Line
from experiments.reports.figures import BLUE, GREEN, GREY, ORANGE, picture_lines, plot_lines, window
from experiments.reports.horizons import horizons_section, horizons_text
from experiments.reports.html import Picture, Section, Table, fold
from experiments.reports.origin import write_result
from experiments.reports.walk_ahead import walk_section, walk_text

FIGURE_SECONDS = 20.0
PICTURE_SECONDS = 10.0
INITIAL = "Initial states, estimated from the readings by the model's smoother:"


def state_table(segments: Sequence[Segment]) -> Table:
    """One row a segment: its start in the run's own time and every signal there."""
    header = ["run", "start [s]", *segments[0].initial_state]
    return Table(header, [[one.run, "" if one.start_s is None else f"{one.start_s:.3f}",
                           *(f"{finite(x):.5g}" for x in one.initial_state.values())] for one in segments],
                 range(1, len(header)), INITIAL.removesuffix(":"))


def segment_table(segments: Sequence[Segment], caption: str = "") -> Table:
    """One row a segment: SSE and RMSE of every signal."""
    signals = list(segments[0].rmse)
    header = ["run", "seconds"] + [f"{kind} {name}" for name in signals for kind in ("SSE", "RMSE")]
    return Table(header, [[one.run, f"{one.horizon_s:.1f}",
                           *(f"{finite(values[name]):.4g}" for name in signals
                             for values in (one.summed_squared_error, one.rmse))] for one in segments],
                 range(1, len(header)), caption)


def fit_table(run_fits: Sequence[RunFit]) -> Table:
    """One row a sensor of a run."""
    def share(value: float | None) -> str:
        return f"{value:.1f} %" if value is not None and np.isfinite(value) else "diverged"

    return Table(["run", "sensor", "fit, whole run", f"fit, pieces of {SHORT_S:g} s"], [
        [one.run, name, share(value), share(one.short[name])] for one in run_fits for name, value in one.whole.items()],
        {2, 3}, "Fit: 100 % is exact, 0 % no better than the mean")


def validation_text(document: ValidationDocument) -> str:
    """Errors of whole runs, as `legid validate` prints them."""
    unit = unit_of(document.runs[0].rmse)
    lines = [segment_table(document.runs).text, "", fit_table(document.fit_percent).text, "",
             "fit: 100 % is exact, 0 % no better than the mean.",
             f"SSE: summed squared error, [{unit}^2] and [{unit}^2/s^2] for rates; RMSE in {unit} and {unit}/s.",
             "", INITIAL, state_table(document.runs).text]
    lines += [f"{one.run}: the simulation diverged" for one in document.runs if one.diverged]
    return "\n".join(lines)


def whole_validation_text(document: ValidationDocument, files: Files | None = None) -> str:
    """Text after `legid validate`. The next step names `files`."""
    return "\n".join([with_names(document.headline.text, files), "", validation_text(document),
                      horizons_text(document.horizons), *([walk_text(document.walk)] if document.walk else [])])


def unit_of(by_signal: Container[str]) -> str:
    """rad, or m where the joint is prismatic."""
    return "m" if "q1_m" in by_signal else "rad"


def validation_picture(validation: Validation) -> str:
    """All joints of one run in one SVG: measured, and simulated from the first state and the torque alone."""
    part = window(validation.time_s, PICTURE_SECONDS)
    lines = []
    for j in range(validation.q.shape[1]):
        measured, simulated = ((BLUE, ORANGE), (GREEN, GREY))[j % 2]
        lines += [Line(f"q{j + 1} measured", validation.reference_q[part, j], measured, 1.6),
                  Line("simulated", validation.q[part, j], simulated, 1.0, dashed=True)]
    label = "angle [rad]" if unit_of(validation.sums) == "rad" else "position [m]"
    return plot_lines(validation.time_s[part] - validation.time_s[0], lines, label)


def validation_section(document: ValidationDocument, table: PredictionTable | None) -> Section:
    """Table of all runs, and figures of the first in `table`. The joint with the worst fit leads the page."""
    unit = unit_of(document.runs[0].rmse)
    notes = [f"{one.run}: the simulation diverged." for one in document.runs if one.diverged]
    tables = [fit_table(document.fit_percent), segment_table(document.runs), state_table(document.runs)]
    return Section(
        "Free-run simulation against validation data",
        ["The simulation starts in the measured state and is then driven by the measured torque alone. Only runs that "
         "the fit has not seen test the model. "
         f"SSE is the summed squared error of the paper's Table V, [{unit}²] and, for "
         f"rates, [{unit}²/s²]; RMSE is in {unit} and {unit}/s."], tables, _pictures(document, table) if table else (),
        notes, folded=True)


def _pictures(document: ValidationDocument, table: PredictionTable) -> list[Picture]:
    """Motion and error of each joint in the first segment."""
    first = validations_of(table)[0]
    unit = unit_of(first.sums)
    fits = document.fit_percent[0].whole
    worst = min(range(first.q.shape[1]), key=lambda j: finite(fits.get(f"q{j + 1}_{unit}", np.inf)))
    pictures = []
    for j in range(first.q.shape[1]):
        q = first.q[:, j]
        lines = [Line("measured", first.reference_q[:, j], BLUE, 2.2), Line("simulated", q, ORANGE, 0.9)]
        pictures += [
            picture_lines(first.time_s, lines, f"q{j + 1} [{unit}]", f"Joint {j + 1} in run {first.run}: measured, and "
                          "simulated from its first state and the measured torque alone.", FIGURE_SECONDS,
                          leads=j == worst),
            picture_lines(first.time_s, [Line("simulated less measured", q - first.reference_q[:, j],
                                              ORANGE)], f"error of q{j + 1} [{unit}]",
                          f"Joint {j + 1}: the error.", FIGURE_SECONDS)]
    return pictures


def write_validation(path: Path | str, found: ValidationDocument, where: str, model: Model | None = None,
                     table: PredictionTable | None = None, files: Files | None = None) -> None:
    """Write the page of a validation of the model that `where` names, with the motion of `table` where that is known.

    The next step names `files`. Raises `InputError` where that place cannot be written.
    """
    count = len(found.fit_percent)
    fitted = "" if model is None else (f"{model.mechanism.model}, fitted by {model.provenance.method} to "
                                       f"{', '.join(model.provenance.runs)}, ")
    told = sentence_of(f"{fitted}simulated against {count} run{'s' * (count != 1)}")
    write_result(path, found, f"Validation of {where}", told,
                 fold(validation_section(found, table), horizons_section(found.horizons) if found.horizons else None,
                      walk_section(found.walk) if found.walk else None), files)
