"""An investigation as text and page: what was believed, which experiment followed, what was believed then."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import Belief, Experiment, InvestigationDocument, Step, finite
from experiments.judge import verdict_title
from experiments.reports.figures import BLUE, GREY, INK, ORANGE, draw, finish
from experiments.reports.html import Picture, Section, Table, fold
from experiments.reports.origin import write_result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_COMPARED = 6
"""Explanations whose errors a text lists."""
CAPTION = ("Held-out error of the nominal model and of every explanation compared, after each step. The values of two "
           "steps are of different held-out runs. The dashed line is noise alone.")


def belief_text(found: Belief | None) -> str:
    """Verdict, rivals and their errors on held-out runs; one line."""
    if found is None:
        return "no diagnosis yet"
    causes = ", ".join(dict.fromkeys(c.effect if c.joint is None else f"{c.effect}@{c.joint}" for c in found.causes))
    text = found.verdict + (f" ({causes})" if causes else "")
    errors = "; ".join(f"{one.explanation} {inf if one.error is None else one.error:.2f}"
                       for one in found.compared[:MOST_COMPARED])
    if found.error is not None:
        text += f"; held-out error in units of noise alone: nominal model {finite(found.error.before):.2f}"
        text += f"; {errors}" if errors else ""
    return text


def expected_text(one: Experiment) -> str:
    """Pairs of rivals, each with the log likelihood ratio that is expected between them."""
    return ", ".join(f"{e.pair}: {finite(e.log_likelihood_ratio):.3g}" for e in one.expected)


def experiment_text(one: Experiment) -> str:
    """One line."""
    text = f"{one.run}: {one.kind}, {one.seconds:.0f} s, at most {one.peak_nm:.3g} N m"
    if one.expected:
        text += f"; expected log likelihood ratio {expected_text(one)}"
    return text + (f"; ended early: {one.ended}" if one.ended else "")


def step_text(step: Step) -> str:
    """Why, what was recorded, and what is believed after it."""
    lines = list(dict.fromkeys(one.why for one in step.experiments))
    lines += [f"  {experiment_text(one)}" for one in step.experiments]
    after = "not diagnosed" if step.after is None else belief_text(step.after)
    return "\n".join([*lines, f"  after {step.wall_s / 60.0:.1f} min: {after}"])


def investigation_text(done: InvestigationDocument) -> str:
    """The answer, the reason for the end, and the next step."""
    answer = "No diagnosis." if done.answer is None else f"{done.answer.verdict}: {done.answer.sentence}"
    return "\n".join([answer, f"{done.why} {len(done.runs)} runs in {done.wall_s / 60.0:.1f} min.",
                      f"Next step: {done.next_step}"])


def write_investigation(path: Path | str, done: InvestigationDocument) -> None:
    """Write the journal, every step folded. Raises `InputError` where that place cannot be written."""
    told = any(step.after is not None and step.after.error is not None for step in done.steps)
    lead = [Section("Errors", pictures=[Picture(draw("investigation", 2.6, lambda axes: paint_errors(axes, done)),
                                                CAPTION, leads=True)])] if told else []
    write_result(path, done, "Investigation", f"{len(done.runs)} runs in {done.wall_s / 60.0:.1f} min, budget "
                 f"{done.budget_s / 60.0:g} min.", [*lead, *fold(*map(_section, range(1, len(done.steps) + 1),
                                                                      done.steps))])


def _section(number: int, step: Step) -> Section:
    """One step: belief before, experiments with their reason, belief after."""
    header = ["run", "experiment", "seconds", "largest torque [N m]", "expected log likelihood ratio", "ended early"]
    rows = [[one.run, one.kind, f"{one.seconds:.0f}", f"{one.peak_nm:.3g}", expected_text(one), one.ended or ""]
            for one in step.experiments]
    found = step.after
    told = [k for k, cells in enumerate(zip(*rows)) if any(cells)]  # a phone has no room for empty columns
    tables = [Table([header[k] for k in told], [[row[k] for k in told] for row in rows], {2, 3})]
    if found is not None and found.compared:
        tables.append(Table(["explanation", "held-out error"], _errors(found), {1},
                            "rms free-run error on held-out runs, in units of noise alone"))
    verdict = "not diagnosed" if found is None else verdict_title(found.verdict)
    return Section(f"Step {number}: {verdict[:1].lower()}{verdict[1:]}", [
        f"Before: {belief_text(step.before)}.", *dict.fromkeys(one.why for one in step.experiments),
        f"After {step.wall_s / 60.0:.1f} min: {'not diagnosed' if found is None else belief_text(found)}."], tables)


def _errors(found: Belief) -> list[list[str]]:
    nominal = [] if found.error is None else [["nominal model", f"{finite(found.error.before):.3g}"]]
    return [*nominal, *([one.explanation, f"{inf if one.error is None else one.error:.3g}"] for one in found.compared)]


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
