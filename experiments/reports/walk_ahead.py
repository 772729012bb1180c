"""Steps that a walker's model predicts, as text, section of a page and JSON: `WalkAhead` of a validation."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator.prediction import WalkAhead, Whole
from experiments.console import text_table
from experiments.reports.html import Section, Table

TITLE = "Free runs across touchdowns, whose instants are the record's, with the impact map (rms in the last step):"


def walk_rows(found: WalkAhead) -> tuple[list[str], list[list[str]]]:
    """Header and rows: one row a number of steps."""
    rows = [[str(a.steps), str(a.pieces), str(a.fell),
             *("all fell" if np.isnan(x) else f"{x:.3g}" for x in a.rmse)] for a in found.ahead]
    return ["steps", "pieces", "fell", *found.columns], rows


def fall_text(run: Whole) -> str:
    """Length of one run's free run."""
    if run.fell_s is None:
        return f"{run.run}: the free run from its first step walks all {run.steps} steps"
    return (f"{run.run}: the free run from its first step falls after {run.fell_s:.2f} s, in step {run.fell_step} of "
            f"{run.steps}; later steps are not compared")


def walk_text(found: WalkAhead) -> str:
    """Text for a person."""
    header, rows = walk_rows(found)
    return "\n".join(["", TITLE, text_table(header, rows, right=set(range(len(header)))),
                      *(fall_text(run) for run in found.whole)])


def walk_section(found: WalkAhead) -> Section:
    """The same for a page."""
    header, rows = walk_rows(found)
    return Section("How many steps ahead the model predicts", [TITLE],
                   [Table(header, rows, right=frozenset(range(len(header))))],
                   notes=[fall_text(run) for run in found.whole], folded=True)


def walk_document(found: WalkAhead) -> dict[str, Any]:
    """`walk` of `legid.validation/1`; no error, null, where all fell."""
    return {"ahead": [{"steps": a.steps, "pieces": a.pieces, "fell": a.fell,
                       "rmse": {c: None if np.isnan(x) else float(x) for c, x in zip(found.columns, a.rmse)}}
                      for a in found.ahead],
            "runs": [{"run": r.run, "steps": r.steps, "fell_s": r.fell_s, "fell_in_step": r.fell_step or None}
                     for r in found.whole]}
