"""Results of the functions of `legid`: the floors' own results, which here also show themselves.

The estimator prints nothing, draws nothing and knows no file, and its results are arrays that any program may use.
Showing them is work for whoever sits in a notebook. So each type here is the floor's type of the same name with three
methods more (`_repr_html_`, `to_frame`, `plot`), and it remembers the rig and the runs that it came from; it goes
wherever the floor's own is taken, and nothing below this package knows of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from daq import Dataset as PlainDataset
from daq import Rig, WorkError
from estimator.diagnosis import Diagnosis as PlainDiagnosis
from experiments.reports import (
    Source,
    diagnosis_document,
    error_rows,
    gap_text,
    origin_from,
    short_diagnosis_text,
    size_rows,
    write_diagnosis,
    write_document,
)
from experiments.session import Prepared, damaged_runs
from legid.tables import Shown, frame, html_table, paragraphs

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

T = TypeVar("T")


def dressed(kind: type[T], plain: Any, **more: Any) -> T:
    """The floor's result `plain` as the type `kind` that is derived from its own."""
    given = {field.name: getattr(plain, field.name) for field in fields(plain) if field.name not in more}
    return kind(**given, **more)


def sources_of(runs: Sequence[PlainDataset]) -> tuple[Source, ...]:
    """The files of those that were loaded from one."""
    return tuple(run.source for run in runs if isinstance(run, Dataset) and run.source is not None)


@dataclass(frozen=True, repr=False)
class Dataset(Shown, PlainDataset):
    """One run on a uniform grid: columns of contract names in SI units, NaN where a sample is missing."""

    rig: Rig | None = None
    """The rig that it was loaded with; None for a run that was simulated or made by hand."""
    source: Source | None = None
    """The file that it was loaded from."""

    def to_frame(self) -> DataFrame:
        """One row a sample, `time_s` [s] as index, one column a signal. Raises `WorkError` without pandas."""
        return frame({"time_s": self.time_s, **self.columns}, "time_s")

    def plot(self) -> Figure:
        """Every column over time."""
        from legid.figures import dataset_figure

        return dataset_figure(self)

    def __str__(self) -> str:
        return (f"{self.name}: {len(self)} samples at {self.rate_hz:g} Hz, {len(self) / self.rate_hz:.1f} s, columns "
                f"{', '.join(self.columns)}")

    def _repr_html_(self) -> str:
        rows = []
        for name, values in self.columns.items():
            seen = values[np.isfinite(values)]
            cells = [f"{x:.4g}" for x in (seen.min(), seen.mean(), seen.max())] if seen.size else ["", "", ""]
            rows.append([name, *cells, str(values.size - seen.size)])
        seconds = len(self) / self.rate_hz
        return (paragraphs([f"{self.name}: {len(self)} samples at {self.rate_hz:g} Hz, {seconds:.1f} s"])
                + html_table(["column", "smallest", "mean", "largest", "missing"], rows))


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown, PlainDiagnosis):
    """Errors of the simulation, their causes, and the gain of extending the model."""

    fitted: tuple[PlainDataset, ...] = ()
    """The runs that it was made from, in their order."""
    rig: Rig | None = None
    prepared: Prepared | None = None
    """The runs used and those set aside."""

    @property
    def document(self) -> dict[str, Any]:
        """`legid.diagnosis/1`, as `legid diagnose --json` writes it."""
        aside, used = ((), ()) if self.prepared is None else (self.prepared.set_aside, self.prepared.setup.datasets)
        return {**diagnosis_document(self, aside, used), "damaged": damaged_runs(used)}

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document, sources_of(self.fitted))

    def page(self, path: Path | str) -> None:
        """Write the page of `legid diagnose --html`. Raises `InputError`, and `WorkError` for a result that `diagnose`
        did not give."""
        if self.prepared is None:
            raise WorkError("only a result of legid.diagnose has a page")
        write_diagnosis(path, self, self.prepared, origin_from(sources_of(self.fitted)))

    def to_frame(self, what: str = "causes") -> DataFrame:
        """`causes`: one row a size of a cause, with its 95 % interval; `candidates`: one row an effect that was scored.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "candidates":
            names = ("effect", "joint", "score", "p_value", "size", "smallest_detectable", "unit")
            return frame({name: [getattr(c, name) for c in self.candidates] for name in names})
        if what != "causes":
            raise ValueError(f"{what!r} is neither 'causes' nor 'candidates'")
        rows = [(c, s) for c in self.causes for s in c.size]
        return frame({"effect": [c.effect for c, _ in rows], "joint": [c.joint for c, _ in rows],
                      "size": [s.name for _, s in rows], "value": [s.value for _, s in rows],
                      "low": [s.ci95[0] for _, s in rows], "high": [s.ci95[1] for _, s in rows],
                      "unit": [s.unit for _, s in rows], "p_value": [c.p_value for c, _ in rows]})

    def plot(self) -> Figure:
        """Free-run errors before and after; below, the residual of each cause over its natural variable.

        Raises `WorkError` for a diagnosis that failed.
        """
        from legid.figures import diagnosis_figure

        if self.verdict == "fit_failed":
            raise WorkError(self.sentence)
        return diagnosis_figure(self)

    def __str__(self) -> str:
        return short_diagnosis_text(self)

    def _repr_html_(self) -> str:
        parts = [paragraphs([f"{self.verdict}: {self.sentence}"])]
        if self.causes:
            rows = [row for cause in self.causes for row in size_rows(cause)]
            parts.append(html_table(["effect", "size", "value", "95 % interval", "unit"], rows))
        if self.sensors:
            parts.append(html_table(["free-run error (rms)", "nominal", "extended", "noise alone"],
                                    error_rows(self.sensors)))
        parts.append(paragraphs([text for text in (gap_text(self), *(f"Warning: {w}" for w in self.warnings),
                                                   self.next_experiment) if text]))
        return "".join(parts)
