"""Steps that a walker's model predicts, as text and section of a page: `walk` of a validation."""

from __future__ import annotations

from experiments.documents import Walk, Walked
from experiments.reports.html import Section, Table

TITLE = "Free runs across touchdowns, whose instants are the record's, with the impact map (rms in the last step):"


def walk_table(walk: Walk) -> Table:
    """One row a number of steps."""
    rows = [[str(a.steps), str(a.pieces), str(a.fell),
             *("all fell" if x is None else f"{x:.3g}" for x in a.rmse.values())] for a in walk.ahead]
    header = ["steps", "pieces", "fell", *(walk.ahead[0].rmse if walk.ahead else ())]
    return Table(header, rows, range(len(header)))


def fall_text(run: Walked) -> str:
    """Length of one run's free run."""
    if run.fell_s is None:
        return f"{run.run}: the free run from its first step walks all {run.steps} steps"
    return (f"{run.run}: the free run from its first step falls after {run.fell_s:.2f} s, in step {run.fell_in_step} "
            f"of {run.steps}; later steps are not compared")


def walk_text(walk: Walk) -> str:
    """Text for a person."""
    return "\n".join(["", TITLE, walk_table(walk).text, *map(fall_text, walk.runs)])


def walk_section(walk: Walk) -> Section:
    """The same for a page."""
    return Section("How many steps ahead the model predicts", [TITLE], [walk_table(walk)],
                   notes=[*map(fall_text, walk.runs)])
