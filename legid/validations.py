"""Result of `legid.validate`: the document `legid.validation/1`, with the motion that it was made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from estimator.prediction import Validation as PlainValidation
from estimator.prediction import segments_as
from experiments import workflows
from experiments.documents import ValidationDocument, finite
from experiments.judge import Files
from experiments.models import Model
from experiments.provenance import Origin
from experiments.reports import segment_table, whole_validation_text, write_validation
from legid.tables import Shown, columns, frame, kept_with

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from experiments.workflows import ValidationReport


@dataclass(frozen=True, repr=False)
class Validation(Shown, PlainValidation):
    """One gap-free segment of one run: measured against simulated from its first state and torque alone."""

    def to_frame(self) -> DataFrame:
        """One row a sample, `time_s` [s] as index: angles simulated and measured. Raises `WorkError` without pandas."""
        unit = "m" if "q1_m" in self.rmse else "rad"
        columns = {f"q{j + 1}_{what}_{unit}": values[:, j] for j in range(self.q.shape[1])
                   for what, values in (("simulated", self.q), ("measured", self.reference_q))}
        return frame({"time_s": self.time_s, **columns}, "time_s")

    def plot(self) -> Figure:
        """Every joint over time, measured and simulated."""
        from legid.figures import validation_figure

        return validation_figure([self])

    def __str__(self) -> str:
        errors = ", ".join(f"{name} {value:.4g}" for name, value in self.rmse.items())
        return f"{self.run}: {self.horizon_s:.1f} s simulated, rms errors {errors}"


class Measured(NamedTuple):
    """Free runs, model and files that a document was made from."""

    report: ValidationReport
    model: Model
    where: str
    """Names the model."""
    segments: Sequence[Validation]


class Validations(Shown, ValidationDocument, kw_only=True, dict=True):
    """`legid.validation/1` whose segments can be drawn: a sequence of `Validation`.

    Its fields are the keys of the JSON. `Validations.read(path)` gives one of a file, without the segments.
    """

    @classmethod
    def made_from(cls, report: ValidationReport, model: Model, where: str, origin: Origin) -> Validations:
        """Validations of `model`, which `where` names, made from the files of `origin`."""
        validations = report.as_document(cls)
        validations.__dict__["made"] = Measured(report, model, where, segments_as(Validation, report.table))
        validations.provenance = origin
        return validations

    def _measured(self) -> Measured:
        made: Measured = kept_with(self, "validation", "motion; run legid.validate")
        return made

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Validation]:
        return iter(self._measured().segments)

    def __getitem__(self, k: int) -> Validation:
        return self._measured().segments[k]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings to be read before the result: runs left out, flags of the others."""
        return tuple(self._measured().report.prepared.warnings)

    def text(self, files: Files | None = None) -> str:
        """Everything that `legid validate` prints. The next step names `files`."""
        compared = workflows.compared_text(self._measured().report)
        return (f"{compared}\n\n" if compared else "") + whole_validation_text(self, files)

    def page(self, path: Path | str, files: Files | None = None) -> None:
        """Write the page of `legid validate --html`; of a file, without the motion. Raises `InputError`."""
        if "made" in vars(self):
            made = self._measured()
            write_validation(path, self, made.where, made.model, made.report.table, files)
        else:
            source = self.provenance.model if self.provenance else None
            write_validation(path, self, source.file if source else "a model")

    def to_frame(self) -> DataFrame:
        """One row a segment: run, seconds, whether it diverged, rms error by signal.

        Raises `WorkError` without pandas.
        """
        return frame({**columns(self.runs, "run seconds=horizon_s diverged"),
                      **{name: [finite(one.rmse[name]) for one in self.runs] for name in self.runs[0].rmse}}, "run")

    def plot(self) -> Figure:
        """Joints down, the first segments across. Raises `WorkError` for a document of a file."""
        from legid.figures import validation_figure

        return validation_figure(self._measured().segments)

    def __str__(self) -> str:
        return f"{self.headline.text}\n\n{segment_table(self.runs).text}"
