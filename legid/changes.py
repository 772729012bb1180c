"""Results about several sessions of a rig: `legid.diagnose(against=...)` and `legid.compare` of sessions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from daq import WorkError
from experiments.documents import ChangeDocument, Differing, SessionsDocument
from experiments.judge import Files
from experiments.reports import change_text, sessions_text, write_change
from legid.tables import Judged, Shown, columns, frame, or_inf

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


class Change(Judged, ChangeDocument, kw_only=True):
    """Change since earlier runs: `legid.diagnosis/1` with `against`, whose keys are its fields.

    `Change.read(path)` gives one of a file.
    """

    def text(self, files: Files | None = None) -> str:
        """Everything that `legid diagnose --against` prints; the next step names `files`."""
        return change_text(self, files)

    def page(self, path: Path | str, files: Files | None = None) -> None:
        """Write the page of `legid diagnose --against --html`. Raises `InputError`."""
        write_change(path, self, files)

    def to_frame(self, what: str = "causes") -> DataFrame:
        """`causes`: one row a size of a cause, with its 95 % interval; `candidates`: one row an effect, with the
        estimated and the smallest detectable change.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        return _frame([self], what)

    def plot(self) -> Figure:
        """Estimated change of the likeliest effects over the smallest that would have shown, with 95 % intervals.

        Raises `WorkError` for a comparison that failed.
        """
        from legid.figures import change_figure

        return change_figure(self)

    def __str__(self) -> str:
        return change_text(self)


class Sessions(Shown, SessionsDocument, kw_only=True):
    """Differences of sessions of a rig from the first one: `legid.sessions/1`, whose keys are its fields.

    `Sessions.read(path)` gives one of a file.
    """

    @property
    def verdict(self) -> str:
        """no_change, named, partial, one_of, changed_unexplained or fit_failed; of several pairs the gravest."""
        return self.worst.verdict

    @property
    def failed(self) -> bool:
        """Whether no pair could be compared."""
        return all(pair.verdict == "fit_failed" for pair in self.pairs)

    def check(self) -> None:
        """Raises `WorkError` for one that failed."""
        if self.failed:
            raise WorkError(self.pairs[0].sentence)

    def page(self, path: Path | str) -> None:
        """Write the page of `legid compare --html` of sessions. Raises `InputError`."""
        write_change(path, self)

    def to_frame(self, what: str = "causes") -> DataFrame:
        """Rows as those of `Change.to_frame`; of several pairs, `from` and `to` name the sessions.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        return _frame(self.pairs, what)

    def plot(self) -> Figure:
        """Figure as that of `Change`, of the pair with the gravest verdict. Raises `WorkError` for one that failed."""
        from legid.figures import change_figure

        return change_figure(self.worst)

    def __str__(self) -> str:
        return sessions_text(self)


def _frame(pairs: Sequence[Differing], what: str) -> DataFrame:
    """`Change.to_frame` of one or of several."""
    rows: list[tuple[object, ...]]
    if what == "candidates":
        rows = [(pair.sides, one) for pair in pairs for one in pair.candidates]
        table = columns(rows, "1.effect 1.joint size=1.size_name 1.change 1.ci95 1.smallest_detectable 1.unit "
                              "1.p_value")
        table["smallest_detectable"] = or_inf(table["smallest_detectable"])
    elif what == "causes":
        rows = [(pair.sides, cause, size) for pair in pairs for cause in pair.causes for size in cause.size]
        table = columns(rows, "1.effect 1.kind 1.joint size=2.name 2.value 2.ci95 2.unit 1.p_value")
    else:
        raise ValueError(f"{what!r} is neither 'causes' nor 'candidates'")
    return frame((columns(rows, "from=0.0.name to=0.1.name") if len(pairs) > 1 else {}) | table)
