"""Prediction errors of a model by horizon, as text and section of a page: `horizons` of a validation."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.documents import Horizon, finite
from experiments.reports.html import Section, Table

TITLE = "Free runs over pieces of a horizon, each from the model's smoothed state (rms):"


def _lost(row: Horizon) -> list[int]:
    """Pieces that diverged, one a model."""
    return [row.blown_up, *([row.against.blown_up] if row.against else [])]


def horizon_table(horizons: Sequence[Horizon]) -> Table:
    """One row a horizon: for every joint the error of the model, of another one, of the last velocity kept, and of the
    smoothed motion itself."""
    first = horizons[0]
    kinds = ("model", "against") if first.against else ("model",)
    header = ["horizon", "pieces", "diverged"]
    header += [f"{column} {kind}" for column in first.rmse for kind in (*kinds, "last velocity")]
    rows = []
    for row in horizons:
        cells = [f"{row.horizon_s:.3g} s", str(row.pieces), " / ".join(map(str, _lost(row)))]
        for column in first.rmse:
            kept = (row.rmse, *([row.against.rmse] if row.against else []), row.last_velocity)
            cells += [f"{finite(errors[column]):.3g}" for errors in kept]
        rows.append(cells)
    rows.append(["noise alone", "", "", *(cell for column in first.noise for cell in
                                          (f"{finite(first.noise[column]):.2g}", *[""] * len(kinds)))])
    return Table(header, rows, range(1, len(header)))


def horizon_flags(horizons: Sequence[Horizon]) -> list[str]:
    """Reasons not to rely on some errors; the last entry is whole segments."""
    flags = [f"at {row.horizon_s:.3g} s {lost} of {row.pieces} simulations of {name} diverged; each is replaced by "
             "its initial state" for row in horizons[:-1]
             for name, lost in zip(("the model", "the other model"), _lost(row)) if lost]
    worse = [row.horizon_s for row in horizons[:-1] if row.horizon_s <= 1.0 and any(
        not finite(row.rmse[c]) < finite(row.last_velocity[c]) for c in row.rmse)]
    flags += [f"at {h:g} s a constant velocity predicts a joint better than the model" for h in worse]
    return flags


def horizons_text(found: Sequence[Horizon]) -> str:
    """Text for a person."""
    return "\n".join(["", TITLE, horizon_table(found).text, *(f"warning: {flag}" for flag in horizon_flags(found))])


def horizons_section(horizons: Sequence[Horizon]) -> Section:
    """The same for a page."""
    return Section(
        "How far ahead the model predicts",
        ["Free runs over pieces of a horizon, each from the model's own smoothed state: rms errors in the unit of the "
         "column, next to those of the last velocity kept. Noise alone: the readings about the smoothed motion."],
        [horizon_table(horizons)], notes=horizon_flags(horizons))
