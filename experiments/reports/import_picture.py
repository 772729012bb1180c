"""The picture of a guessed map of columns: each reading, and the same computed from the other columns."""

from __future__ import annotations

import numpy as np

from experiments.exchange import Guess, si_unit
from experiments.judge import Headline
from experiments.reports.chart import Line
from experiments.reports.figures import BLUE, ORANGE, picture_lines
from experiments.reports.html import Section, Table

SECONDS = 15.0


def guess_table(guess: Guess) -> Table:
    """One row a column."""
    return Table(["run's column", "file's column", "unit", "sign", "why"], [
        [name, " - ".join(filter(None, (column.name, column.minus))), column.unit or si_unit(name),
         f"{column.sign:+d}", guess.notes.get(name, "").replace("\n", "; ")] for name, column in guess.columns.items()])


def guess_verdict(guess: Guess) -> Headline:
    """Whether the guess explains the data, and what to look at before it is used."""
    if guess.unexplained:
        return Headline("bad", "NOT TO BE USED AS IT IS: these columns do not explain each other.",
                       ["What the table calls NOT KNOWN stands in the map as the file has it. Correct it there."],
                       [*guess.unexplained, *guess.warnings])
    if guess.warnings:
        return Headline("caution", "Look at this before you use the guess.", warnings=guess.warnings)
    return Headline("good", "Units and signs explain the readings.")


def guess_section(guess: Guess, file: str) -> Section:
    """The guess as a table, and the curves by which to judge it."""
    pictures = []
    for title, (read, made) in guess.curves.items():
        time_s = np.arange(read.size) / guess.run.rate_hz
        lines = [Line("measured", read, BLUE, 2.0), Line("computed", made, ORANGE, 1.0)]
        column, unit = title.split(":")[0], title[title.rindex("["):]
        pictures.append(picture_lines(time_s, lines, f"{column} {unit}", title, SECONDS))
    return Section("Columns", [f"Guessed from {file}. Unit and sign are right if a figure's two curves agree. No "
                               "figure shows the torque's scale."], [guess_table(guess)], pictures)
