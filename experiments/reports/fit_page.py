"""The sections of a report on a fit: parameters, sensors, torques, noise, what is not determined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daq import BoolArray, FloatArray
from estimator import RESIDUAL_LAGS, FitResult, Trajectory
from estimator.model import Mechanism
from experiments.documents import FitDocument
from experiments.judge import (
    Correlation,
    Estimate,
    Files,
    fit_percent,
    number,
    open_torque,
    residual_tests,
    sentence_of,
    torque_fit,
)
from experiments.reports.budget import budget_section
from experiments.reports.chart import Line
from experiments.reports.figures import BLUE, GREEN, GREY, HEIGHT_IN, INK, ORANGE, draw, finish, picture_lines
from experiments.reports.fit_text import (
    VOLTS,
    noise_rows,
    parameter_table,
    run_noise_lines,
    samples_text,
)
from experiments.reports.html import Picture, Section, Table, fold
from experiments.reports.origin import write_result
from experiments.reports.prior_knowledge import knowledge_section, prior_sentence
from experiments.reports.run_agreement import agreement_section
from experiments.reports.second_opinion import opinion_section
from experiments.reports.sketch import sketch_pictures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_SECONDS = 12.0
SENSOR_LABELS = {
    "gyro_radps": "gyro [rad/s]", "accel_x_mps2": "accelerometer x [m/s²]", "accel_y_mps2": "accelerometer y [m/s²]",
}


def fit_summary(fit: FitDocument) -> str:
    """One sentence at the top of the page."""
    prior = f"{prior_sentence(fit)} " if fit.prior else ""
    return (f"{prior}{fit.model}, identified by {fit.method} from the {_sensors(fit)}, {samples_text(fit)}."
            f"{f' {VOLTS}' * (fit.force_unit == 'V')}")


def _sensors(fit: FitDocument) -> str:
    sensors = "IMU, knee encoder" if fit.sensors == "imu" else "joint encoders"
    return f"{sensors} and torque" if fit.driven else sensors.replace(", ", " and ")


def write_fit(path: Path | str, fit: FitDocument, runs: Sequence[str], result: FitResult | None = None,
              files: Files | None = None) -> None:
    """Write the page of a fit to `runs`: its document, and the motion of `result` where that is known.

    The next step names `files`. Raises `InputError` where that place cannot be written.
    """
    write_result(path, fit, f"Fit of {fit.model}: {', '.join(runs)}", fit_summary(fit), fit_sections(fit, result),
                 files)


def fit_sections(fit: FitDocument, result: FitResult | None, benchmark: FitResult | None = None) -> list[Section]:
    """Everything that a fit alone can show. `benchmark` is a second model for the torques.

    The parameters stand open, the rest is folded; the torque of the last joint with a motor leads the page.
    """
    path = max(result.trajectories if result else (), key=lambda t: t.time_s.shape[0], default=None)
    drawn, sketch = list[Section | None](), list[Picture]()
    if result is not None and path is not None:  # the longest motion
        drawn = [_sensors_section(result, path), _torques(result, path, benchmark), _residuals(result)]
        sketch = sketch_pictures(result.mechanism, path.q, path.time_s, path.run)
    return [Section("Parameters", [], [parameter_table(fit)], sketch), *fold(
        budget_section(fit), knowledge_section(fit), agreement_section(fit), opinion_section(fit), *drawn, _noise(fit),
        _limits(fit))]


def truth_section(mechanism: Mechanism, found: Mapping[str, Estimate], truth: Mapping[str, float]) -> Section:
    """Emulated rigs only: what was found, by parameter, against the plant's physics."""
    rows = []
    for p in mechanism.parameters:
        one = found[p.name]
        rows.append([p.name, number(truth[p.name], one.std), number(one.value, one.std), one.interval,
                     "yes" if one.holds(truth[p.name]) else "no", p.unit, p.meaning])
    inside = sum(row[4] == "yes" for row in rows)
    return Section(
        "Against the truth",
        [f"The rig was emulated, so its parameters are known: {inside} of {len(rows)} lie inside their 95 % intervals. "
         "The plant computes its motion from masses and lengths and shares no code with the estimator."],
        [Table(["parameter", "truth", "found", "95 % interval", "inside", "unit", "meaning"], rows, {1, 2, 3})],
        folded=True)


def _sensors_section(result: FitResult, path: Trajectory) -> Section | None:
    """What the sensors said, and what they should have said along the estimated motion."""
    pictures = []
    for column, measured in path.measured.items():
        if column not in path.predicted or not column.startswith(("gyro", "accel", "q")):
            continue
        label = SENSOR_LABELS.get(column, f"{column.rsplit('_', 1)[0]} [{result.mechanism.length_unit}]")
        lines = [Line("measured", measured, BLUE, 2.2), Line("estimate", path.predicted[column], ORANGE, 0.9)]
        rms = float(np.sqrt(np.nanmean((measured - path.predicted[column]) ** 2)))
        name, _, unit = label[:-1].partition(" [")
        if column.startswith("q"):
            name = f"{'position' if unit == 'm' else 'angle'} {name}"
        share = fit_percent(measured, path.predicted[column])
        pictures.append(picture_lines(path.time_s, lines, label,
                                      f"{name[0].upper()}{name[1:]}, measured and as estimated. Rms difference over "
                                      f"the whole run: {rms:.3g} {unit}; fit {share:.1f} %.", FIGURE_SECONDS))
    title = "Accelerometer and gyro" if result.sensors == "imu" else "Angles"
    return Section(f"{title}, measured against the estimate", [f"Run {path.run}."], pictures=pictures
                   ) if pictures else None


def _torques(result: FitResult, path: Trajectory, benchmark: FitResult | None) -> Section:
    """Measured torque against the model's; the pivot's must be zero."""
    other = _benchmark_torque(benchmark, path)
    pictures = []
    force = result.mechanism.force_unit
    for j in range(result.mechanism.n):
        driven = j in result.mechanism.actuated
        lines = [Line("measured", path.tau_measured[:, j], BLUE, 2.2)] if driven else []
        if other is not None and benchmark is not None:
            lines.append(Line(f"{benchmark.method} ({benchmark.sensors})", other[:, j], GREEN, 0.9))
        unknown = open_torque(result, path, j)
        lines.append(Line(f"model ({result.method})", np.where(unknown, np.nan, path.tau[:, j]), ORANGE, 0.9))
        if not driven:
            lines.append(Line("zero", np.zeros_like(path.time_s), GREY, 1.0, dashed=True))
        pictures.append(picture_lines(path.time_s, lines, f"torque, joint {j + 1} [{force}]",
                                      _torque_caption(result, path, j, unknown), FIGURE_SECONDS,
                                      leads=j == max(result.mechanism.actuated, default=-1)))
    return Section("Torques", [f"Run {path.run}."], pictures=pictures)


def _torque_caption(result: FitResult, path: Trajectory, j: int, unknown: BoolArray) -> str:
    driven, force = j in result.mechanism.actuated, result.mechanism.force_unit
    text = f"Torque of joint {j + 1} in run {path.run}" + ("" if driven else ", which has no motor: it must be zero")
    text += f". Rms of measured minus model: {float(result.torque_residual_rms[j]):.3g} {force}"
    left = (path.tau_measured[:, j] - path.tau[:, j])[~unknown]
    if unknown.any() and left.size:
        text += f", {float(np.sqrt(np.mean(left**2))):.3g} {force} where dry friction says what it is"
    if driven:
        text += f"; fit {torque_fit(result, j, [path]):.1f} %" + (" there" if unknown.any() else "")
    return text + (". Near rest the model's torque is not known: dry friction may hold the joint against any."
                   if unknown.any() else ".")


def _benchmark_torque(benchmark: FitResult | None, path: Trajectory) -> FloatArray | None:
    """(N, n) at the times of `path`, which ends earlier where readings of an IMU that are late were moved."""
    for other in benchmark.trajectories if benchmark else ():
        where = np.searchsorted(other.time_s, path.time_s)
        if other.run == path.run and where[-1] < len(other.time_s) and np.array_equal(other.time_s[where], path.time_s):
            return other.tau[where]
    return None


def _residuals(result: FitResult) -> Section | None:
    """MATLAB's `resid`: is the residual white and independent of the input?"""
    auto, cross = residual_tests(result)
    if not auto:
        return None
    rows = [[c.what, f"{100 * c.outside:.0f} %", f"{c.largest:.2f}", f"{c.band:.3f}"] for c in (*auto, *cross)]
    force = [c for c in auto if any(c.what == f"torque {j + 1}" for j in result.mechanism.actuated)]
    pictures = [_correlation(c, f"Autocorrelation of the residual of {c.what}, less what a right model "
                             "leaves; the band holds 99 % of that.") for c in (force or auto)]
    if cross:
        c = max(cross, key=lambda one: one.largest / max(one.band, 1e-12))  # furthest out of its band
        pictures.append(_correlation(c, f"Cross-correlation of {c.what}; at positive lags with the torque's past. The "
                                     "band holds 99 % of it if they are independent."))
    return Section(
        "Residuals: white, and independent of the input?",
        [f"Measured less estimated, at lags up to {RESIDUAL_LAGS} samples. One lag in a hundred lies outside its "
         "99 % band by chance. The motion is estimated from the same sensors, which colours residuals: of a driven "
         "joint's torque what a right model leaves is taken off. What counts is that torque, and a sensor beyond four "
         "lags: a large correlation there is something that the model lacks. The equation of a passive joint has no "
         "sensor of its own, and its residual follows its neighbours'."],
        [Table(["residual", "lags outside 99 %", "largest", "99 % band, +-"], rows, {1, 2, 3})], pictures)


def _correlation(c: Correlation, caption: str) -> Picture:
    """Stems over the band."""
    def paint(axes: Axes) -> None:
        axes.axhspan(-c.band, c.band, color=GREY, alpha=0.25, linewidth=0.0, label="99 % band")
        axes.vlines(c.lags, 0.0, c.values, color=BLUE, linewidth=1.4)
        axes.plot(c.lags, c.values, "o", color=BLUE, markersize=3.0)
        axes.axhline(0.0, color=INK, linewidth=0.6)
        finish(axes, 1, "lag [samples]", "correlation")

    return Picture(draw(c.what, HEIGHT_IN, paint), caption)


def _noise(fit: FitDocument) -> Section:
    rows = noise_rows(fit)
    if not rows:
        return Section("Noise levels", [f"{fit.method} neither uses nor estimates any."])
    return Section("Noise levels", ["One standard deviation, estimated from the data where the rig file gives none."],
                   [Table(["channel", "1 sigma", "unit"], rows, {1})],
                   notes=[*map(sentence_of, run_noise_lines(fit))])


def _limits(fit: FitDocument) -> Section:
    return Section("What is not determined, and what is assumed", notes=[
        *(f"Not determined: {one}." for one in fit.undetermined), *map(sentence_of, fit.assumptions)])
