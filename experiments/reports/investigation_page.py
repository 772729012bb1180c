"""The journal of an investigation as a page: answer, next step and one figure first, every step folded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimator.diagnosis import Diagnosis
from experiments.judge import Investigation, Step
from experiments.provenance import Origin
from experiments.reports.diagnosis_figures import draw
from experiments.reports.diagnosis_page import LEVELS, verdict_words
from experiments.reports.figures import BLUE, GREY, INK, ORANGE, finish
from experiments.reports.html import Picture, Section, Table, VerdictBox, fold, write_page
from experiments.reports.investigation import belief_text, explanation
from experiments.reports.origin import origin_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADER = ["run", "experiment", "seconds", "largest torque [N m]", "expected log likelihood ratio", "ended early"]
CAPTION = ("Held-out error of the nominal model and of every explanation compared, after each step. The values of two "
           "steps are of different held-out runs. The dashed line is noise alone.")


def write_investigation(path: Path | str, done: Investigation, origin: Origin) -> None:
    """Write the page. Raises `InputError` where that place cannot be written."""
    found = done.found
    words = "no diagnosis" if found is None else verdict_words(found.verdict)
    box = VerdictBox("bad" if found is None else LEVELS[found.verdict], f"{words[:1].upper()}{words[1:]}",
                     ["No diagnosis yet." if found is None else found.sentence, done.why],
                     [] if found is None else [f"Warning: {text}" for text in found.warnings],
                     f"Next step: {done.next_step}")
    told = [step for step in done.steps if step.found is not None and step.found.error is not None]
    lead = [Section("Errors", (), (), [Picture(error_plot(done), CAPTION, leads=True)])] if told else []
    steps = [_section(k, step, done.steps[k - 2].found if k > 1 else None) for k, step in enumerate(done.steps, 1)]
    write_page(path, "Investigation", f"{len(done.runs)} runs in {done.wall_s / 60.0:.1f} min, budget "
               f"{done.budget_s / 60.0:g} min.", [*lead, *fold(steps), origin_section(origin)], origin, box)


def _section(number: int, step: Step, before: Diagnosis | None) -> Section:
    """One step: belief before, experiments with their reason, belief after."""
    rows = [[one.run, one.kind, f"{one.seconds:.0f}", f"{one.peak_nm:.3g}",
             ", ".join(f"{pair}: {value:.3g}" for pair, value in one.expected), one.ended] for one in step.experiments]
    after = "not diagnosed" if step.found is None else belief_text(step.found)
    told = [k for k, cells in enumerate(zip(*rows)) if any(cells)]  # a phone has no room for empty columns
    tables = [Table([HEADER[k] for k in told], [[row[k] for k in told] for row in rows], right=frozenset({2, 3}))]
    if step.found is not None and step.found.compared:
        tables.append(Table(["explanation", "held-out error"], _errors(step.found),
                            "rms free-run error on held-out runs, in units of noise alone", frozenset({1})))
    verdict = "not diagnosed" if step.found is None else verdict_words(step.found.verdict)
    return Section(f"Step {number}: {verdict}", [
        f"Before: {belief_text(before)}.", *dict.fromkeys(one.why for one in step.experiments),
        f"After {step.wall_s / 60.0:.1f} min: {after}."], tables)


def _errors(found: Diagnosis) -> Sequence[Sequence[str]]:
    nominal = [] if found.error is None else [["nominal model", f"{found.error[0]:.3g}"]]
    return [*nominal, *([explanation(keys), f"{error:.3g}"] for keys, error in found.compared)]


def error_plot(done: Investigation) -> str:
    """`paint_errors` as an `<svg>` element."""
    return draw("investigation", 2.6, lambda axes: paint_errors(axes, done))


def paint_errors(axes: Axes, done: Investigation) -> None:
    """Held-out error over the steps: nominal model, explanations, noise alone."""
    steps = [(k, step.found) for k, step in enumerate(done.steps, 1) if step.found is not None]
    nominal = [(k, found.error[0]) for k, found in steps if found.error is not None]
    others = [(k, error) for k, found in steps for _, error in found.compared[1:]]
    best = [(k, found.compared[0][1]) for k, found in steps if found.compared]
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
