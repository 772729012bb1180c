"""The journal of an investigation as a page: answer, next step and one figure first, every step folded."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import Belief, InvestigationDocument, Step, finite
from experiments.provenance import Origin
from experiments.reports.diagnosis_figures import draw
from experiments.reports.diagnosis_page import LEVELS, verdict_words
from experiments.reports.figures import BLUE, GREY, INK, ORANGE, finish
from experiments.reports.html import Picture, Section, Table, VerdictBox, fold, write_page
from experiments.reports.investigation import belief_text, expected_text
from experiments.reports.origin import origin_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADER = ["run", "experiment", "seconds", "largest torque [N m]", "expected log likelihood ratio", "ended early"]
CAPTION = ("Held-out error of the nominal model and of every explanation compared, after each step. The values of two "
           "steps are of different held-out runs. The dashed line is noise alone.")


def write_investigation(path: Path | str, done: InvestigationDocument, origin: Origin) -> None:
    """Write the page. Raises `InputError` where that place cannot be written."""
    found = done.answer
    words = "no diagnosis" if found is None else verdict_words(found.verdict)
    box = VerdictBox("bad" if found is None else LEVELS[found.verdict], f"{words[:1].upper()}{words[1:]}",
                     ["No diagnosis yet." if found is None else found.sentence, done.why],
                     [] if found is None else [f"Warning: {text}" for text in found.warnings],
                     f"Next step: {done.next_step}")
    told = [step for step in done.steps if step.after is not None and step.after.error is not None]
    lead = [Section("Errors", (), (), [Picture(error_plot(done), CAPTION, leads=True)])] if told else []
    steps = [_section(k, step) for k, step in enumerate(done.steps, 1)]
    write_page(path, "Investigation", f"{len(done.runs)} runs in {done.wall_s / 60.0:.1f} min, budget "
               f"{done.budget_s / 60.0:g} min.", [*lead, *fold(steps), origin_section(origin)], origin, box)


def _section(number: int, step: Step) -> Section:
    """One step: belief before, experiments with their reason, belief after."""
    rows = [[one.run, one.kind, f"{one.seconds:.0f}", f"{one.peak_nm:.3g}", expected_text(one), one.ended or ""]
            for one in step.experiments]
    found = step.after
    told = [k for k, cells in enumerate(zip(*rows)) if any(cells)]  # a phone has no room for empty columns
    tables = [Table([HEADER[k] for k in told], [[row[k] for k in told] for row in rows], right=frozenset({2, 3}))]
    if found is not None and found.compared:
        tables.append(Table(["explanation", "held-out error"], _errors(found),
                            "rms free-run error on held-out runs, in units of noise alone", frozenset({1})))
    verdict = "not diagnosed" if found is None else verdict_words(found.verdict)
    return Section(f"Step {number}: {verdict}", [
        f"Before: {belief_text(step.before)}.", *dict.fromkeys(one.why for one in step.experiments),
        f"After {step.wall_s / 60.0:.1f} min: {'not diagnosed' if found is None else belief_text(found)}."], tables)


def _errors(found: Belief) -> list[list[str]]:
    nominal = [] if found.error is None else [["nominal model", f"{finite(found.error.before):.3g}"]]
    return [*nominal, *([one.explanation, f"{inf if one.error is None else one.error:.3g}"] for one in found.compared)]


def error_plot(done: InvestigationDocument) -> str:
    """`paint_errors` as an `<svg>` element."""
    return draw("investigation", 2.6, lambda axes: paint_errors(axes, done))


def paint_errors(axes: Axes, done: InvestigationDocument) -> None:
    """Held-out error over the steps: nominal model, explanations, noise alone."""
    steps = [(k, step.after) for k, step in enumerate(done.steps, 1) if step.after is not None]
    nominal = [(k, found.error.before) for k, found in steps if found.error is not None]
    others = [(k, one.error) for k, found in steps for one in found.compared[1:]]
    best = [(k, found.compared[0].error) for k, found in steps if found.compared]
    for points, colour, label in ((nominal, BLUE, "nominal"), (others, GREY, "others compared"),
                                  (best, ORANGE, "least error")):
        x, y = np.array(points, dtype=float).reshape(-1, 2).T
        seen = np.isfinite(y)
        axes.plot(x[seen], y[seen], "o", color=colour, label=label, markersize=5.0, zorder=3)
    axes.axhline(1.0, color=INK, linestyle="--", linewidth=1.0)
    axes.set_yscale("log")
    axes.set_xticks(range(1, len(done.steps) + 1))
    axes.set_xlim(0.5, len(done.steps) + 0.5)
    finish(axes, 3, "step", "rms error over that of noise alone")
