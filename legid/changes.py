"""Results about several sessions or steps of a rig: `legid.compare` of sessions, `watch`, `investigate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.change import Change as PlainChange
from experiments.judge import Investigation as PlainInvestigation
from experiments.judge import Watched
from experiments.reports import (
    CAUSE_HEADER,
    Source,
    cause_rows,
    change_document,
    change_text,
    investigation_document,
    investigation_text,
    line_text,
    origin_from,
    sessions_document,
    source_of,
    step_text,
    watch_document,
    watch_summary,
    write_change,
    write_document,
    write_watch,
)
from experiments.session import damaged_runs
from experiments.workflows import ChangeFound
from legid.tables import Shown, frame, html_table, paragraphs

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from experiments.judge import Step


@dataclass(frozen=True, repr=False)
class Change(Shown):
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

    def page(self, path: Path | str) -> None:
        """Write the page of `legid diagnose --against --html`, or of `legid compare`. Raises `InputError`."""
        origin = origin_from(self.sources[1] if self.reference else (*self.sources[0], *self.sources[1]))
        write_change(path, [(self.names, self.plain)], origin, self.found.datasets)

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


@dataclass(frozen=True, repr=False)
class Watching(Shown):
    """Runs of a rig, each tested for a change since the reference runs."""

    lines: tuple[Watched, ...]
    """One a run, in their order."""
    false_alarms: float
    """Allowed per hour of motion."""
    reference: tuple[str, ...]
    """Names of the reference runs."""
    sources: tuple[tuple[Source, ...], tuple[Source, ...]] = ((), ())
    """The run files of the reference, and of the tested runs."""

    @property
    def alarms(self) -> tuple[str, ...]:
        """Names of the runs with an alarm."""
        return tuple(one.found.run for one in self.lines if one.found.alarm is not None)

    @property
    def document(self) -> dict[str, Any]:
        """`legid.watch/1`, as `legid watch --json` writes it."""
        return watch_document(self.lines, self.false_alarms, self.reference, self.sources[0])

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document, self.sources[1])

    def page(self, path: Path | str) -> None:
        """Write the page of `legid watch --html`. Raises `InputError`."""
        write_watch(path, self.lines, self.false_alarms, origin_from(self.sources[1]))

    def to_frame(self) -> DataFrame:
        """One row a run: state, motion [s], end of the block with the alarm [s], likeliest change, false alarms per
        hour.

        Raises `WorkError` without pandas.
        """
        worst = [one.found.alarm or one.found.worst for one in self.lines]
        return frame({"run": [one.found.run for one in self.lines], "state": [one.state for one in self.lines],
                      "seconds": [one.found.seconds for one in self.lines],
                      "alarm_s": [None if one.found.alarm is None else one.found.alarm.end_s for one in self.lines],
                      "effect": [None if block is None else block.effect for block in worst],
                      "joint": [None if block is None else block.joint for block in worst],
                      "per_hour": [None if block is None else block.per_hour for block in worst]}, "run")

    def plot(self) -> Figure:
        """The test over the runs, with its threshold."""
        from legid.figures import watch_figure

        return watch_figure(self.lines, self.false_alarms)

    def __str__(self) -> str:
        return "\n".join([*map(line_text, self.lines), watch_summary(self.lines, self.false_alarms)])

    def _repr_html_(self) -> str:
        return paragraphs(str(self).splitlines())


@dataclass(frozen=True, repr=False)
class Investigation(Shown):
    """Recordings and diagnoses of a rig, step by step, until one cause stood or the investigation ended otherwise."""

    plain: PlainInvestigation
    """The steps, with their diagnoses."""
    folder: Path
    """Where the runs, the diagnoses, the model and the journal are."""

    @property
    def verdict(self) -> str | None:
        """Verdict of the last diagnosis; None without one."""
        return None if self.plain.found is None else self.plain.found.verdict

    @property
    def ending(self) -> str | None:
        """Reason for the end: settled, exhausted, budget, declined, stopped or failed."""
        return self.plain.ending

    @property
    def steps(self) -> tuple[Step, ...]:
        """Experiments and the diagnosis after them, in their order."""
        return self.plain.steps

    @property
    def document(self) -> dict[str, Any]:
        """`legid.investigation/1`, as `legid investigate` writes it."""
        return investigation_document(self.plain)

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document, tuple(source_of(self.folder / run) for run in self.plain.runs))

    def to_frame(self) -> DataFrame:
        """One row a run: step, kind, plan [s], largest torque [N m], verdict after the step.

        Raises `WorkError` without pandas.
        """
        rows = [(k, one, step.found) for k, step in enumerate(self.steps, 1) for one in step.experiments]
        return frame({"run": [one.run for _, one, _ in rows], "step": [k for k, _, _ in rows],
                      "kind": [one.kind for _, one, _ in rows], "seconds": [one.seconds for _, one, _ in rows],
                      "peak_nm": [one.peak_nm for _, one, _ in rows],
                      "verdict": [None if found is None else found.verdict for _, _, found in rows]}, "run")

    def plot(self) -> Figure:
        """Held-out error of the nominal model and of every explanation, over the steps.

        Raises `WorkError` where no step has a diagnosis.
        """
        from legid.figures import investigation_figure

        return investigation_figure(self.plain)

    def __str__(self) -> str:
        return "\n".join([*map(step_text, self.steps), investigation_text(self.plain)])

    def _repr_html_(self) -> str:
        return paragraphs(str(self).splitlines())
