"""Results of `legid.diagnose(against=...)` and of `legid.compare` of sessions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.change import Change as PlainChange
from experiments.reports import (
    CAUSE_HEADER,
    Source,
    cause_rows,
    change_document,
    change_text,
    sessions_document,
    write_document,
)
from experiments.session import damaged_runs
from experiments.workflows import ChangeFound
from legid.tables import frame, html_table, paragraphs

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True)
class Change:
    """Change between two sessions of a rig."""

    found: ChangeFound
    names: tuple[str, str]
    """Of the first session, and of the one whose sizes are given less those of the first."""
    reference: bool = True
    """Whether the first session is the reference, and not a session like the other."""
    sources: tuple[tuple[Source, ...], tuple[Source, ...]] = ((), ())
    """The run files of both."""

    @property
    def plain(self) -> PlainChange:
        """The estimator's own result."""
        return self.found.change

    @property
    def verdict(self) -> str:
        """no_change, named, partial, one_of, changed_unexplained or fit_failed."""
        return self.plain.verdict

    @property
    def document(self) -> dict[str, Any]:
        """`legid.diagnosis/1` as `legid diagnose --against --json` writes it, or `legid.sessions/1` as `legid compare`.
        """
        aside = self.found.set_aside
        made = change_document(self.plain, aside, self.sources[0]) if self.reference else sessions_document(
            [(self.names, self.plain)], aside)
        return {**made, "damaged": damaged_runs(self.found.datasets)}

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document, self.sources[1] if self.reference else (*self.sources[0], *self.sources[1]))

    def to_frame(self, what: str = "causes") -> DataFrame:
        """`causes`: one row a size of a cause, with its 95 % interval; `candidates`: one row an effect, with the
        estimated and the smallest detectable change.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "candidates":
            rows = self.plain.detectable
            return frame({"effect": [d.effect for d in rows], "joint": [d.joint for d in rows],
                          "size": [d.name for d in rows], "change": [d.change for d in rows],
                          "low": [d.ci95[0] for d in rows], "high": [d.ci95[1] for d in rows],
                          "smallest_detectable": [d.size for d in rows], "unit": [d.unit for d in rows],
                          "p_value": [d.p_value for d in rows]})
        if what != "causes":
            raise ValueError(f"{what!r} is neither 'causes' nor 'candidates'")
        pairs = [(c, s) for c in self.plain.causes for s in c.size]
        return frame({"effect": [c.effect for c, _ in pairs], "kind": [c.kind for c, _ in pairs],
                      "joint": [c.joint for c, _ in pairs], "size": [s.name for _, s in pairs],
                      "value": [s.value for _, s in pairs], "low": [s.ci95[0] for _, s in pairs],
                      "high": [s.ci95[1] for _, s in pairs], "unit": [s.unit for _, s in pairs],
                      "p_value": [c.p_value for c, _ in pairs]})

    def plot(self) -> Figure:
        """Estimated change of the likeliest effects over the smallest that would have shown, with 95 % intervals.

        Raises `WorkError` for a comparison that failed.
        """
        from legid.figures import change_figure

        return change_figure(self.plain)

    def __str__(self) -> str:
        return change_text(self.plain, self.names)

    def _repr_html_(self) -> str:
        table = html_table(CAUSE_HEADER, cause_rows(self.plain)) if self.plain.causes else ""
        return paragraphs([f"{self.verdict}: {self.plain.sentence}"]) + table + paragraphs(
            [f"Warning: {text}" for text in self.plain.warnings])
