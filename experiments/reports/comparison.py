"""Two models side by side, as text, page and document: `legid compare`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from daq import FloatArray
from experiments.console import text_table
from experiments.models import Prediction
from experiments.reports.chart import Line
from experiments.reports.diagnosis_figures import axis_label, draw
from experiments.reports.figures import BLUE, GREEN, GREY, HEIGHT_IN, INK, ORANGE, finish, picture_lines
from experiments.reports.html import Picture, Section, Table
from experiments.reports.numbers import Estimate, number
from experiments.reports.trust import Trust
from experiments.session import SetAside

SCHEMA = "legid.comparison/1"
FIGURE_SECONDS = 12.0
CHANCE = 0.1
"""Share of sensors and horizons at which one of two equal models may come out better: 95 % intervals, and several of
them of the same errors."""
NAMES = ("A", "B")
PARAMETER_HEADER = ["parameter", "A", "95 % interval", "B", "95 % interval", "z of B - A", "unit", "meaning"]
ERROR_HEADER = ["horizon", "sensor", "rms error of A", "of B", "B / A", "95 % interval", "better"]


@dataclass(frozen=True)
class ParameterPair:
    """One parameter, or size of an effect, in both models; None where a model has none."""

    name: str
    unit: str
    meaning: str
    a: Estimate | None
    b: Estimate | None

    @property
    def z(self) -> float | None:
        """Difference over its standard deviation, the two taken for independent; None where it is not known."""
        if self.a is None or self.b is None:
            return None
        std = math.hypot(self.a[1], self.b[1])
        return (self.b[0] - self.a[0]) / std if 0.0 < std < math.inf else None


@dataclass(frozen=True)
class HorizonError:
    """Free-run rms errors of one sensor over one horizon; infinite where a model ran away."""

    horizon_s: float
    """Infinite for whole stretches."""
    column: str
    a: float
    b: float
    ci95: tuple[float, float] | None
    """Of B / A, over resampled pieces of runs; None where there are too few."""

    @property
    def better(self) -> str:
        """A, B, or nothing where the interval holds 1 or is not known."""
        if math.isinf(self.a) != math.isinf(self.b):
            return "B" if math.isinf(self.a) else "A"
        return "" if self.ci95 is None else "B" if self.ci95[1] < 1.0 else "A" if self.ci95[0] > 1.0 else ""


@dataclass(frozen=True)
class Comparison:
    """Everything that `legid compare` found."""

    files: tuple[str, str]
    parameters: tuple[ParameterPair, ...]
    errors: tuple[HorizonError, ...]
    traces: tuple[Prediction, Prediction]
    """The first run under each model."""
    runs: tuple[str, ...]
    doubts: tuple[str, ...]
    """What limits the answer: runs that were fitted, rigs that differ."""
    notes: tuple[str, ...] = ()
    """What limits the reading of z."""
    set_aside: tuple[SetAside, ...] = ()
    """Runs that were not used."""


def comparison_trust(found: Comparison) -> Trust:
    """Who is better, in one line."""
    total, files = len(found.errors), dict(zip(NAMES, found.files))
    wins = {name: [e for e in found.errors if e.better == name] for name in NAMES}
    wins = {name: some if len(some) > CHANCE * total else [] for name, some in wins.items()}
    reasons = (*found.doubts, *found.notes)
    if found.errors and all(e.ci95 is None and not e.better for e in found.errors):
        smaller = sum(e.b < e.a for e in found.errors)
        return Trust("caution", "NOT DECIDED: these runs are too short for an interval, ten seconds are the least; the "
                     f"error of B is the smaller at {smaller} of {total} sensors and horizons.", reasons)
    if wins["A"] and wins["B"]:
        parts = " and ".join(f"{name} ({files[name]}) at {_places(wins[name])}" for name in NAMES)
        return Trust("caution", f"NEITHER is better throughout: {parts}.", reasons)
    for name in NAMES:
        if wins[name]:
            best = min(wins[name], key=lambda e: _ratio(e) if name == "B" else -_ratio(e))
            told = f"{_ratio(best):.2g}" + (
                "" if best.ci95 is None else f" [{best.ci95[0]:.2g}, {best.ci95[1]:.2g}]") if math.isfinite(
                    _ratio(best)) else "one of them ran away"
            return Trust("caution" if found.doubts else "good",
                         f"{name} IS BETTER ({files[name]}): at {len(wins[name])} of {total} sensors and horizons, and "
                         f"the other at no more than chance gives; most at {_place(best)}, rms error of B over that of "
                         f"A {told}.", reasons)
    return Trust("caution", f"NEITHER is better: of {total} sensors and horizons no more leave 1 out of the 95 % "
                 "interval of the ratio of errors than chance gives.", reasons)


def _ratio(error: HorizonError) -> float:
    if math.isfinite(error.a) and error.a > 0.0:
        return error.b / error.a
    return 0.0 if math.isfinite(error.b) else math.inf


def _place(error: HorizonError) -> str:
    return f"{error.column} over {horizon_text(error.horizon_s)}"


def _places(errors: Sequence[HorizonError], most: int = 3) -> str:
    more = f" and {len(errors) - most} more" if len(errors) > most else ""
    return ", ".join(map(_place, errors[:most])) + more


def horizon_text(horizon_s: float) -> str:
    """For a person."""
    return "whole runs" if math.isinf(horizon_s) else f"{horizon_s:g} s"


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
        return "ran away" if math.isinf(value) else f"{value:.4g}"

    return [[horizon_text(e.horizon_s), e.column, rms(e.a), rms(e.b),
             f"{e.b / e.a:.3f}" if math.isfinite(e.a + e.b) and e.a > 0.0 else "",
             "" if e.ci95 is None else f"{e.ci95[0]:.3f} .. {e.ci95[1]:.3f}", e.better] for e in found.errors]


def comparison_text(found: Comparison) -> str:
    """What a person reads after `legid compare`."""
    trust = comparison_trust(found)
    return "\n".join([
        trust.sentence, *trust.reasons, "", *(f"{name}: {file}" for name, file in zip(NAMES, found.files)), "",
        text_table(PARAMETER_HEADER, parameter_rows(found), {1, 2, 3, 4, 5}), "",
        f"Free runs of {', '.join(found.runs)}:", text_table(ERROR_HEADER, error_rows(found), {2, 3, 4, 5})])


def comparison_document(found: Comparison) -> dict[str, Any]:
    """`legid.comparison/1`; a horizon of null is a whole stretch, an error of null ran away."""
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


def comparison_sections(found: Comparison) -> list[Section]:
    """Errors, figures of the first run, parameters."""
    return [
        Section("Free-run errors over horizons",
                [f"A is {found.files[0]}, B is {found.files[1]}. Each piece starts from the motion that the model "
                 "itself estimates there from all sensors, and is then driven by the measured torque alone; sensors "
                 "are compared with what they read. Intervals are those of the ratio over resampled pieces of two "
                 "seconds; one is better where its interval leaves 1 out."],
                [Table(ERROR_HEADER, error_rows(found), right=frozenset({2, 3, 4, 5}))],
                [Picture(ratio_plot(found.errors), "Rms error of B over that of A with 95 % intervals: below 1, B is "
                         "better.")]),
        *_traces(found),
        Section("Parameters", ["z is the difference over its standard deviation, as if the two were independent: "
                               "beyond +-2 they differ. Where both were fitted to the same runs it is too small."],
                [Table(PARAMETER_HEADER, parameter_rows(found), right=frozenset({1, 2, 3, 4, 5}))])]


def _traces(found: Comparison) -> list[Section]:
    a, b = found.traces
    pictures = []
    for column, measured in a.measured.items():
        sides: list[tuple[str, Mapping[str, FloatArray] | None, str]] = [("A", a.whole, GREEN), ("B", b.whole, ORANGE)]
        known = [(name, values[column], colour) for name, values, colour in sides if values is not None]
        pictures += [
            picture_lines(a.time_s, [Line("measured", measured, BLUE, 2.2),
                                     *(Line(name, values, colour) for name, values, colour in known)],
                          axis_label(column), f"{column}: measured, and as simulated by both.", FIGURE_SECONDS),
            picture_lines(a.time_s, [Line(f"{name} less measured", values - measured, colour)
                                     for name, values, colour in known],
                          f"error of {axis_label(column)}", f"{column}: the errors.", FIGURE_SECONDS)] if known else []
    return [Section(f"Run {a.run}", ["Whole stretches, from the first state."], (), pictures)] if pictures else []


def ratio_plot(errors: Sequence[HorizonError]) -> str:
    """B / A with intervals by sensor and horizon."""
    shown = [e for e in errors if math.isfinite(e.a + e.b) and e.a > 0.0]
    horizons = list(dict.fromkeys(e.horizon_s for e in errors))
    columns = list(dict.fromkeys(e.column for e in errors))

    def paint(axes: Axes) -> None:
        axes.axhline(1.0, color=INK, linewidth=0.8)
        for k, (column, colour) in enumerate(zip(columns, (BLUE, ORANGE, GREEN, GREY) * len(columns))):
            some = [e for e in shown if e.column == column]
            x = np.array([horizons.index(e.horizon_s) for e in some]) + 0.12 * (k - (len(columns) - 1) / 2)
            y = np.array([e.b / e.a for e in some])
            low, high = np.array([e.ci95 or (r, r) for e, r in zip(some, y)]).reshape(-1, 2).T
            axes.errorbar(x, y, [np.maximum(y - low, 0.0), np.maximum(high - y, 0.0)], fmt="o", color=colour,
                          markersize=4.0, label=column)
        axes.set_yscale("log")
        axes.set_xticks(range(len(horizons)), [horizon_text(h) for h in horizons])
        finish(axes, len(columns), "horizon", "error of B / error of A")

    return draw("ratio", HEIGHT_IN + 0.4, paint)
