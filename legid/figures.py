"""Figures of results, as matplotlib's own: to be shown in a notebook, changed, or saved with `savefig`."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from daq import Dataset, FloatArray, WorkError
from daq.recording import Plan
from estimator import FitResult
from estimator.diagnosis import Diagnosis, Signature
from estimator.prediction import Validation
from experiments.documents import Answer, ComparisonDocument, TuningDocument
from experiments.reports import (
    BLUE,
    ERRORS,
    GREEN,
    GREY,
    ORANGE,
    axis_label,
    drawn_changes,
    paint_changes,
    paint_gains,
    window,
)

SECONDS = 12.0
"""What a figure of a fit shows of a run: more becomes a smear."""
MOST_SEGMENTS = 4


class NotebookFigure(Figure):
    """A figure that a notebook shows although pyplot, which keeps every figure it ever made, does not know it."""

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png")
        return out.getvalue()


def _panels(rows: int, columns: int = 1) -> tuple[NotebookFigure, FloatArray]:
    """A figure with (rows, columns) axes that share their time."""
    figure = NotebookFigure(figsize=(7.2 * columns ** 0.5, 0.6 + 1.7 * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, sharex="col", squeeze=False)


def _axes(height_in: float) -> tuple[NotebookFigure, Axes]:
    """A figure with one set of axes."""
    figure = NotebookFigure(figsize=(7.2, height_in), layout="constrained")
    return figure, figure.subplots()


def _legend(ax: Axes) -> None:
    """Above the axes, where no curve runs."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)


def dataset_figure(data: Dataset) -> Figure:
    """Every column over time; NaN leaves a hole."""
    figure, axes = _panels(len(data.columns))
    for ax, (name, values) in zip(axes[:, 0], data.columns.items()):
        ax.plot(data.time_s, values, color=BLUE, linewidth=0.9)
        ax.set_ylabel(axis_label(name))
    axes[0, 0].set_title(data.name)
    axes[-1, 0].set_xlabel("time [s]")
    return figure


def fit_figure(result: FitResult) -> Figure:
    """The first seconds of the longest segment: sensors measured and as estimated, torques measured and modelled.

    Figs. 4 and 5 of Dolinsky and Celikovsky (IEEE TCST 26(4), 2018).
    """
    path = max(result.trajectories, key=lambda t: t.time_s.size)
    part = window(path.time_s, SECONDS)
    sensors = [name for name in path.measured if name in path.predicted]
    figure, axes = _panels(len(sensors) + result.mechanism.n)
    rows = [(axis_label(name), path.measured[name], path.predicted[name]) for name in sensors]
    rows += [(f"torque {j + 1} [{result.mechanism.force_unit}]", path.tau_measured[:, j], path.tau[:, j])
             for j in range(result.mechanism.n)]
    for ax, (label, measured, modelled) in zip(axes[:, 0], rows):
        ax.plot(path.time_s[part], measured[part], color=BLUE, linewidth=1.8, label="measured")
        ax.plot(path.time_s[part], modelled[part], color=ORANGE, linewidth=0.9, label="model")
        ax.set_ylabel(label)
    _legend(axes[0, 0])
    axes[0, 0].set_title(f"{path.run}, {result.method}", loc="left")
    axes[-1, 0].set_xlabel("time [s]")
    return figure


def validation_figure(validations: Sequence[Validation]) -> Figure:
    """Joints down, the first segments across: measured, and simulated from the first state and the torque alone."""
    shown = validations[:MOST_SEGMENTS]
    joints = shown[0].q.shape[1]
    unit = "m" if "q1_m" in shown[0].rmse else "rad"
    figure, axes = _panels(joints, len(shown))
    for column, one in zip(axes.T, shown):
        for j, ax in enumerate(column):
            ax.plot(one.time_s, one.reference_q[:, j], color=BLUE, linewidth=1.8, label="measured")
            ax.plot(one.time_s, one.q[:, j], color=ORANGE, linewidth=0.9, label="simulated")
        column[0].set_title(one.run, loc="left")
        column[-1].set_xlabel("time [s]")
    for j, ax in enumerate(axes[:, 0]):
        ax.set_ylabel(f"q{j + 1} [{unit}]")
    _legend(axes[0, 0])
    return figure


def diagnosis_figure(diagnosis: Diagnosis) -> Figure:
    """Free-run errors before, after and by noise alone; below, what each cause leaves of its natural variable."""
    rows = 1 + len(diagnosis.signatures)
    figure = NotebookFigure(figsize=(7.2, 0.8 + 2.6 * rows), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False)[:, 0]
    paint_gains(axes[0], diagnosis.sensors)
    axes[0].set_xlabel(ERRORS)
    axes[0].legend(frameon=False)
    axes[0].set_title(diagnosis.verdict)
    for ax, signature in zip(axes[1:], diagnosis.signatures):
        _signature(ax, signature)
    return figure


def plan_figure(plan: Plan) -> Figure:
    """The torque of a plan over time."""
    figure, ax = _axes(2.3)
    ax.plot(plan.time_s, plan.torque_nm, color=BLUE, linewidth=0.9)
    ax.set_ylabel("torque [N m]")
    ax.set_xlabel("time [s]")
    return figure


def tuning_figure(document: TuningDocument) -> Figure:
    """Error of runs not fitted, a group of bars a joint: before, and with what was chosen. Raises `WorkError`."""
    trials = [(label, colour, np.array([np.inf if x is None else x for x in rmse])) for label, colour, rmse in
              (("before", BLUE, document.error_before), ("chosen", ORANGE, document.error_after)) if rmse is not None]
    trials = [one for one in trials if np.isfinite(one[2]).all()]
    if not trials:
        raise WorkError("no set-up that was tried can be simulated; record richer motion")
    figure, ax = _axes(2.6)
    for k, (label, colour, rmse) in enumerate(trials):
        ax.bar(np.arange(len(rmse)) + 0.4 * (k - 0.5 * (len(trials) - 1)), rmse, 0.38, color=colour, label=label)
    ax.set_xticks(range(len(trials[0][2])), [f"joint {j + 1}" for j in range(len(trials[0][2]))])
    ax.set_ylabel("rms error after a second")
    ax.legend(frameon=False)
    return figure


def comparison_figure(document: ComparisonDocument) -> Figure:
    """The error of B over that of A, a row each horizon and sensor, with its 95 % interval; below 1, B is better."""
    errors = [e for e in document.errors if e.ratio is not None]
    figure, ax = _axes(0.8 + 0.22 * max(len(errors), 4))
    ratio = np.array([e.ratio for e in errors])
    for k, e in enumerate(errors):
        if e.ratio_ci95 is not None:
            ax.plot(e.ratio_ci95, [k, k], color=GREY, linewidth=1.6)
    ax.plot(ratio, np.arange(len(errors)), "o", color=BLUE, markersize=4.0)
    ax.axvline(1.0, color=ORANGE, linewidth=0.9)
    ax.set_yticks(range(len(errors)), [f"{'whole' if e.horizon_s is None else f'{e.horizon_s:g} s'}, {e.column}"
                                       for e in errors])
    ax.invert_yaxis()
    ax.set_xlabel("rms error of B over that of A")
    return figure


def change_figure(answer: Answer) -> Figure:
    """Estimated change of the likeliest effects over the smallest detectable one. Raises `WorkError`."""
    some = drawn_changes(answer)
    if not some:
        raise WorkError(answer.sentence)
    figure, ax = _axes(0.9 + 0.24 * len(some))
    paint_changes(ax, some)
    ax.set_xlabel("change / smallest detectable change")
    return figure




def _signature(ax: Axes, s: Signature) -> None:
    ax.errorbar(s.x, s.before, s.before_error, fmt="o", color=BLUE, markersize=4.0, label="nominal leaves")
    ax.plot(s.x, s.curve, color=ORANGE, label="effect")
    ax.plot(s.x, s.after, "s", color=GREEN, markersize=3.5, label="extended leaves")
    ax.set_title(s.title)
    ax.set_xlabel(s.x_label)
    ax.set_ylabel(s.y_label)
    ax.legend(frameon=False)
