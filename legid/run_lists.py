"""Results about many run files, one by one: `legid.fit_each` and `legid.list_runs`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from experiments.documents import finite
from experiments.provenance import Origin
from experiments.reports import RunLine, runs_document, runs_text
from experiments.workflows import refits_document, refits_text, verdict
from legid.listings import Listing
from legid.tables import frame_of

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, repr=False)
class Fits(Listing):
    """Fits of runs one by one: `legid.fits/1`."""

    fits: tuple[Mapping[str, Any], ...]
    """Of each run the document `legid.fit/1` with its name `run`; or `run` and `error`."""

    @property
    def document(self) -> dict[str, Any]:
        """`legid.fits/1`, as `legid fit --each --json` writes it."""
        return refits_document(self.fits)

    @property
    def status(self) -> int:
        """2 where a run could not be read, 1 where one was not fitted or did not converge, else 0."""
        return verdict(self.fits)

    def to_frame(self) -> DataFrame:
        """One row a run that was fitted, one column a parameter. Raises `WorkError` without pandas."""
        good = [fit for fit in self.fits if "error" not in fit]
        rows = [{"run": fit["run"], "converged": fit["converged"],
                 **{p["name"]: finite(p["value"]) for p in fit["parameters"]}} for fit in good]
        return frame_of(rows, "run")

    def __str__(self) -> str:
        return refits_text(self.fits)


@dataclass(frozen=True, repr=False)
class RunList(Listing):
    """Recorded runs: `legid.runs/1`."""

    lines: tuple[RunLine, ...]
    of: int
    """So many run files are there; `lines` has those that were asked for."""
    provenance: Origin | None = None

    @property
    def document(self) -> dict[str, Any]:
        """`legid.runs/1`, as `legid runs --json` writes it."""
        return runs_document(self.lines)

    def __len__(self) -> int:
        return len(self.lines)

    def to_frame(self) -> DataFrame:
        """One row a run with the keys of the JSON. Raises `WorkError` without pandas."""
        return frame_of(self.document["runs"], "file")

    def __str__(self) -> str:
        return runs_text(self.lines) if self.lines else ""
