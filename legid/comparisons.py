"""Result of `legid.compare` of two models: the document `legid.comparison/1`, with the free runs of both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from daq import Dataset
from experiments.documents import ComparisonDocument
from experiments.judge import Comparison as Found
from experiments.provenance import Origin
from experiments.reports import comparison_text, write_comparison
from legid.tables import Shown, columns, frame, or_inf

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


class Compared(NamedTuple):
    """Free runs and mechanism that a document was made from."""

    found: Found
    mechanism: str


class Comparison(Shown, ComparisonDocument, kw_only=True, dict=True):
    """`legid.comparison/1`: its fields are the keys of the JSON. `Comparison.read(path)` gives one of a file."""

    @classmethod
    def made_from(cls, found: Found, runs: Sequence[Dataset], mechanism: str, origin: Origin) -> Comparison:
        """The comparison of two models of `mechanism` on `runs`."""
        made = cls.of(found, [run for run in runs if run.name in found.runs])
        made.__dict__["made"] = Compared(found, mechanism)
        made.provenance = origin
        return made

    def page(self, path: Path | str) -> None:
        """Write the page of `legid compare --html`; that of a document of a file has no motion. Raises `InputError`."""
        made: Compared | None = vars(self).get("made")
        if made is None:
            write_comparison(path, self)
        else:
            write_comparison(path, self, made.mechanism, made.found.table)

    def to_frame(self, what: str = "errors") -> DataFrame:
        """`errors`: one row a horizon and sensor, rms errors and their ratio; `parameters`: one row a parameter.

        A horizon of infinity is a whole segment. Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "parameters":
            return frame(columns(self.parameters, "parameter=name a=a.value b=b.value z unit meaning"), "parameter")
        if what != "errors":
            raise ValueError(f"{what!r} is neither 'errors' nor 'parameters'")
        table = columns(self.errors, "horizon_s=length_s column a b ratio ratio_ci95 better")
        return frame(table | {"a": or_inf(table["a"]), "b": or_inf(table["b"]),
                              "better": [better or "" for better in table["better"]]})

    def plot(self) -> Figure:
        """The error of B over that of A at every horizon and sensor, with its 95 % interval."""
        from legid.figures import comparison_figure

        return comparison_figure(self)

    def __str__(self) -> str:
        return comparison_text(self)
