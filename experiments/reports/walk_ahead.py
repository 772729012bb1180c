"""Steps that a walker's model predicts, as text and section of a page: `walk` of a validation."""

from __future__ import annotations

from experiments.documents import Walk, Walked
from experiments.reports.html import Section, Table

TITLE = "Free runs across touchdowns, whose instants are the record's, with the impact map (rms in the last step):"


def walk_table(found: Walk) -> Table:
    """One row a number of steps."""
    rows = [[str(a.steps), str(a.pieces), str(a.fell),
             *("all fell" if x is None else f"{x:.3g}" for x in a.rmse.values())] for a in found.ahead]
    header = ["steps", "pieces", "fell", *(found.ahead[0].rmse if found.ahead else ())]
    return Table(header, rows, range(len(header)))


def fall_text(run: Walked) -> str:
    """Length of one run's free run."""
    if run.fell_s is None:
        return f"{run.run}: the free run from its first step walks all {run.steps} steps"
    return (f"{run.run}: the free run from its first step falls after {run.fell_s:.2f} s, in step {run.fell_in_step} "
            f"of {run.steps}; later steps are not compared")


def walk_text(found: Walk) -> str:
    """Text for a person."""
    return "\n".join(["", TITLE, walk_table(found).text, *map(fall_text, found.runs)])


def walk_section(found: Walk) -> Section:
    """The same for a page."""
    return Section("How many steps ahead the model predicts", [TITLE], [walk_table(found)],
                   notes=[*map(fall_text, found.runs)])
