"""Result of `legid.diagnose`: the document `legid.diagnosis/1`, with the models and curves that it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from daq import Dataset, Rig
from estimator.diagnosis import Diagnosis as Details
from experiments.documents import DiagnosisDocument
from experiments.judge import Files
from experiments.provenance import Origin
from experiments.reports import (
    diagnosis_text,
    short_diagnosis_text,
    write_diagnosis,
)
from experiments.session import Prepared
from legid.tables import Judged, columns, frame, kept_with, or_inf

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


class Made(NamedTuple):
    """Answer and runs that a document was made from."""

    details: Details
    prepared: Prepared
    fitted: tuple[Dataset, ...]
    """All runs that were given."""
    rig: Rig


class Diagnosis(Judged, DiagnosisDocument, kw_only=True, dict=True):
    """`legid.diagnosis/1`: errors of the simulation, their causes, and the gain of extending the model.

    Its fields are the keys of the JSON. `Diagnosis.read(path)` gives one of a file, which has no models and no curves:
    `details` and what is read from it then raise `WorkError`.
    """

    @classmethod
    def made_from(cls, details: Details, prepared: Prepared, runs: Sequence[Dataset], rig: Rig, origin: Origin
                  ) -> Diagnosis:
        """The diagnosis of `runs`, from the files of `origin`."""
        diagnosis = cls.of(details, prepared.set_aside, prepared.setup.datasets, prepared.setup.settings.model)
        diagnosis.__dict__["made"] = Made(details, prepared, tuple(runs), rig)
        diagnosis.provenance = origin
        return diagnosis

    def _made(self) -> Made:
        made: Made = kept_with(self, "diagnosis", "models and no curves; run legid.diagnose")
        return made

    @property
    def details(self) -> Details:
        """The estimator's own result: models with their covariance, curves, simulated runs."""
        return self._made().details

    @property
    def prepared(self) -> Prepared:
        """The runs used and those set aside."""
        return self._made().prepared

    @property
    def fitted(self) -> tuple[Dataset, ...]:
        """All runs that were given, in their order."""
        return self._made().fitted

    @property
    def rig(self) -> Rig:
        """The rig of these runs."""
        return self._made().rig

    def text(self, files: Files | None = None) -> str:
        """Everything that `legid diagnose` prints. The next step names `files`."""
        return diagnosis_text(self, files)

    def page(self, path: Path | str, files: Files | None = None) -> None:
        """Write the page of `legid diagnose --html`, whose next step names `files`; that of a document of a file has
        no curves.

        Raises `InputError`.
        """
        write_diagnosis(path, self, self.details if "made" in vars(self) else None, files)

    def to_frame(self, what: str = "causes") -> DataFrame:
        """`causes`: one row a size of a cause, with its 95 % interval; `candidates`: one row an effect that was scored.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "candidates":
            table = columns(self.candidates, "effect joint score p_value size unit smallest_detectable")
            return frame(table | {"smallest_detectable": or_inf(table["smallest_detectable"])})
        if what != "causes":
            raise ValueError(f"{what!r} is neither 'causes' nor 'candidates'")
        rows = [(c, s) for c in self.causes for s in c.size]
        return frame(columns(rows, "0.effect 0.joint size=1.name 1.value 1.ci95 1.unit 0.p_value"))

    def plot(self) -> Figure:
        """Free-run errors before and after; below, the residual of each cause over its natural variable.

        Raises `WorkError` for a diagnosis that failed, and for a document of a file.
        """
        from legid.figures import diagnosis_figure

        self.check()
        return diagnosis_figure(self.details)

    def __str__(self) -> str:
        return short_diagnosis_text(self)
