"""How far ahead a model predicts, as text, section of a page and JSON: `Horizons` of a validation."""

from __future__ import annotations

from typing import Any

from estimator.fitting import Horizons
from experiments.console import text_table
from experiments.reports.html import Section, Table


def horizons_rows(found: Horizons) -> tuple[list[str], list[list[str]]]:
    """Header and rows: one row a horizon, for every joint the error of the model, of another one, of the last velocity
    kept, and of the readings alone."""
    against = found.against
    header = ["horizon", "pieces", "blown up"]
    kinds = ("model", *["against"] * bool(against), "last velocity")
    header += [f"{column} {kind}" for column in found.columns for kind in kinds]
    rows = []
    for k, p in enumerate(found.model):
        blown = [str(x.blown) for x in (p, *against[k : k + 1])]
        cells = [f"{p.horizon_s:.3g} s", str(p.pieces), " / ".join(blown)]
        for j in range(len(found.columns)):
            cells += [f"{x.rmse[j]:.3g}" for x in (p, *against[k : k + 1])] + [f"{p.baseline[j]:.3g}"]
        rows.append(cells)
    rows.append(["noise alone", "", "", *(cell for level in found.noise for cell in
                                          (f"{level:.2g}", *[""] * bool(against), ""))])
    return header, rows


def horizons_doubts(found: Horizons) -> list[str]:
    """What of it is not to be relied on."""
    doubts = [f"at {p.horizon_s:g} s {p.blown} of {p.pieces} simulations of {name} blew up; they are not in its errors"
              for name, table in (("the model", found.model), ("the other model", found.against))
              for p in table if p.blown]
    worse = [p for p in found.model if p.horizon_s <= 1.0 and not bool((p.rmse < p.baseline).all())]
    doubts += [f"at {p.horizon_s:g} s the last velocity, kept, predicts a joint better than the model" for p in worse]
    return doubts


def horizons_text(found: Horizons) -> str:
    """What a person reads."""
    header, rows = horizons_rows(found)
    return "\n".join(["", "Free runs over pieces of a horizon, each from the measured state (rms):",
                      text_table(header, rows, right=set(range(1, len(header)))),
                      *(f"warning: {doubt}" for doubt in horizons_doubts(found))])


def horizons_section(found: Horizons) -> Section:
    """The same for a page."""
    header, rows = horizons_rows(found)
    return Section(
        "How far ahead the model predicts",
        ["Free runs over pieces of a horizon, each from the measured state: rms errors in the unit of the column, "
         "beside those of the last velocity kept, and the readings' own noise."],
        [Table(header, rows, right=frozenset(range(1, len(header))))], notes=[*horizons_doubts(found)])


def horizons_document(found: Horizons) -> list[dict[str, Any]]:
    """`horizons` of `legid.validation/1`, one entry a horizon."""
    def by_joint(values: Any) -> dict[str, float]:
        return dict(zip(found.columns, map(float, values)))

    return [{"horizon_s": float(p.horizon_s), "pieces": p.pieces, "blown_up": p.blown, "rmse": by_joint(p.rmse),
             "last_velocity": by_joint(p.baseline), "noise": by_joint(found.noise),
             **({"against": {"rmse": by_joint(found.against[k].rmse), "blown_up": found.against[k].blown}}
                if found.against else {})} for k, p in enumerate(found.model)]
