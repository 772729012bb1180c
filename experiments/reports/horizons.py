"""Prediction errors of a model by horizon, as text, section of a page and JSON: the horizons of a prediction table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from estimator.prediction import PredictionTable
from experiments.console import text_table
from experiments.reports.html import Section, Table

TITLE = "Free runs over pieces of a horizon, each from the model's smoothed state (rms):"


class _Row(NamedTuple):
    """One horizon."""

    horizon_s: float
    """Of the table"""
    length_s: float
    """The same, or that of the longest segment where the horizon is whole segments"""
    pieces: int


def _rows(table: PredictionTable) -> Iterator[_Row]:
    longest = max(run.longest_s for run in table.runs)
    for h, pieces in zip(table.horizons_s, table.pieces):
        yield _Row(h, longest if np.isinf(h) else h, int(pieces))


def _lost(table: PredictionTable, row: _Row) -> list[int]:
    """Pieces that diverged, one a model."""
    return [int(x) for x in table.lost[:, table.horizons_s.index(row.horizon_s)]]


def horizons_rows(table: PredictionTable) -> tuple[list[str], list[list[str]]]:
    """Header and rows: one row a horizon, for every joint the error of the model, of another one, of the last velocity
    kept, and of the smoothed motion itself."""
    models = range(len(table.squares))
    kinds = ("model", "against")[: len(models)]
    header = ["horizon", "pieces", "diverged"]
    header += [f"{column} {kind}" for column in table.angles for kind in (*kinds, "last velocity")]
    rows = []
    for row in _rows(table):
        cells = [f"{row.length_s:.3g} s", str(row.pieces), " / ".join(map(str, _lost(table, row)))]
        for column in table.angles:
            errors = [table.rms(m, column, row.horizon_s) for m in models]
            cells += [f"{x:.3g}" for x in (*errors, table.rms_kept(column, row.horizon_s))]
        rows.append(cells)
    rows.append(["noise alone", "", "", *(cell for column in table.angles for cell in
                                          (f"{table.rms_residual(column):.2g}", *[""] * len(models)))])
    return header, rows


def horizon_flags(table: PredictionTable) -> list[str]:
    """Reasons not to rely on some errors."""
    flags = [f"at {row.length_s:.3g} s {lost} of {row.pieces} simulations of {name} diverged; each is replaced by "
              "its initial state" for row in _rows(table) if np.isfinite(row.horizon_s)
              for name, lost in zip(("the model", "the other model"), _lost(table, row)) if lost]
    worse = [h for h in table.horizons_s if h <= 1.0 and any(
        not table.rms(0, c, h) < table.rms_kept(c, h) for c in table.angles)]
    flags += [f"at {h:g} s a constant velocity predicts a joint better than the model" for h in worse]
    return flags


def horizons_text(table: PredictionTable) -> str:
    """Text for a person."""
    header, rows = horizons_rows(table)
    return "\n".join(["", TITLE, text_table(header, rows, right=set(range(1, len(header)))),
                      *(f"warning: {flag}" for flag in horizon_flags(table))])


def horizons_section(table: PredictionTable) -> Section:
    """The same for a page."""
    header, rows = horizons_rows(table)
    return Section(
        "How far ahead the model predicts",
        ["Free runs over pieces of a horizon, each from the model's own smoothed state: rms errors in the unit of the "
         "column, next to those of the last velocity kept. Noise alone: the readings about the smoothed motion."],
        [Table(header, rows, right=frozenset(range(1, len(header))))], notes=[*horizon_flags(table)], folded=True)


def horizons_document(table: PredictionTable) -> list[dict[str, Any]]:
    """`horizons` of `legid.validation/1`, one entry a horizon; null where a whole segment diverges."""
    def by_joint(value: Callable[[str], float]) -> dict[str, float]:
        return {column: float(value(column)) for column in table.angles}

    def entry(row: _Row) -> dict[str, Any]:
        h, lost = row.horizon_s, _lost(table, row)
        found: dict[str, Any] = {
            "horizon_s": float(row.length_s), "pieces": row.pieces, "blown_up": lost[0],
            "rmse": by_joint(lambda c: table.rms(0, c, h)), "last_velocity": by_joint(lambda c: table.rms_kept(c, h)),
            "noise": by_joint(table.rms_residual)}
        if len(lost) > 1:
            found["against"] = {"rmse": by_joint(lambda c: table.rms(1, c, h)), "blown_up": lost[1]}
        return found

    return [entry(row) for row in _rows(table)]
