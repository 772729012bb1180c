"""Results about several sessions or steps of a rig: `legid.compare` of sessions, `watch`, `investigate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from daq import WorkError
from experiments.documents import (
    ChangeDocument,
    Differing,
    InvestigationDocument,
    SessionsDocument,
    WatchDocument,
)
from experiments.judge import Files
from experiments.reports import (
    cause_table,
    change_text,
    investigation_text,
    line_text,
    sessions_text,
    step_text,
    watch_text,
    write_change,
    write_investigation,
    write_watch,
)
from legid.tables import Judged, Shown, columns, frame, or_inf, paragraphs, tables_html

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

    def _repr_html_(self) -> str:
        return _html(self)


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

    def _repr_html_(self) -> str:
        return "".join(map(_html, self.pairs))


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


def _html(found: Differing) -> str:
    return paragraphs(found.headline.told) + tables_html(cause_table(found))


class Watching(Shown, WatchDocument, kw_only=True):
    """Runs of a rig, each tested for a change since the reference runs: `legid.watch/1`, whose keys are its fields.

    `Watching.read(path)` gives one of a file.
    """

    @property
    def alarms(self) -> tuple[str, ...]:
        """Names of the runs with an alarm."""
        return tuple(one.run for one in self.watched if one.alarm is not None)

    def page(self, path: Path | str) -> None:
        """Write the page of `legid watch --html`. Raises `InputError`."""
        write_watch(path, self)

    def to_frame(self) -> DataFrame:
        """One row a run: state, motion [s], end of the block with the alarm [s], likeliest change, false alarms per
        hour.

        Raises `WorkError` without pandas.
        """
        return frame(columns(self.watched, "run state seconds alarm_s=alarm.end_s worst.effect worst.joint "
                             "worst.per_hour"), "run")

    def plot(self) -> Figure:
        """The test over the runs, with its threshold."""
        from legid.figures import watch_figure

        return watch_figure(self)

    def __str__(self) -> str:
        return watch_text(self)

    def _repr_html_(self) -> str:
        return paragraphs([*self.headline.told, *map(line_text, self.watched)])


class Investigation(Shown, InvestigationDocument, kw_only=True):
    """Recordings and diagnoses of a rig, step by step: `legid.investigation/1`, whose keys are its fields.

    `Investigation.read(path)` gives the journal of a folder.
    """

    @property
    def verdict(self) -> str | None:
        """Verdict of the last diagnosis; None without one."""
        return None if self.answer is None else self.answer.verdict

    def check(self) -> None:
        """Raises `WorkError` for one that failed."""
        if self.ending == "failed":
            raise WorkError(self.why)

    def page(self, path: Path | str) -> None:
        """Write the journal as a page. Raises `InputError`."""
        write_investigation(path, self)

    def to_frame(self) -> DataFrame:
        """One row a run: step, kind, plan [s], largest torque [N m], verdict after the step.

        Raises `WorkError` without pandas.
        """
        rows = [(k, one, step.after) for k, step in enumerate(self.steps, 1) for one in step.experiments]
        return frame(columns(rows, "1.run step=0 1.kind 1.seconds 1.peak_nm 2.verdict"), "run")

    def plot(self) -> Figure:
        """Held-out error of the nominal model and of every explanation, over the steps.

        Raises `WorkError` where no step has a diagnosis.
        """
        from legid.figures import investigation_figure

        return investigation_figure(self)

    def __str__(self) -> str:
        return "\n".join([*map(step_text, self.steps), investigation_text(self)])

    def _repr_html_(self) -> str:
        return paragraphs([*self.headline.told, *map(step_text, self.steps)])
