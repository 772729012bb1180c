"""Result of `legid.fit`: the document `legid.fit/1`, with the estimate and the motion that it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from daq import Dataset, FloatArray, Rig, WorkError
from estimator import FitResult as Estimate
from estimator import Trajectory
from estimator.model import Mechanism
from experiments.documents import FitDocument, finite
from experiments.judge import Files, check_sound
from experiments.provenance import Origin
from experiments.reports import parameter_table, whole_fit_text, write_fit
from legid.tables import Shown, columns, frame, kept_with

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from experiments.workflows import Fitted


class Made(NamedTuple):
    """Fit and runs that a document was made from."""

    fitted: Fitted
    runs: tuple[Dataset, ...]
    """All that were given."""


class FitResult(Shown, FitDocument, kw_only=True, dict=True):
    """`legid.fit/1`: identified parameters, what they rest on, and whether they can be trusted.

    Its fields are the keys of the JSON. `FitResult.read(path)` gives one of a file, which has no covariance and no
    motion: `estimate` and what is read from it then raise `WorkError`.
    """

    @classmethod
    def made_from(cls, fitted: Fitted, runs: Sequence[Dataset], origin: Origin) -> FitResult:
        """The result of a fit of `runs`, from the files of `origin`."""
        result = fitted.as_document(cls)
        result.__dict__["made"] = Made(fitted, tuple(runs))
        result.provenance = origin
        return result

    def _made(self) -> Made:
        made: Made = kept_with(self, "fit", "covariance and no motion; run legid.fit")
        return made

    @property
    def fitted(self) -> Fitted:
        """The runs used, those set aside, the entries of the rig that were chosen."""
        return self._made().fitted

    @property
    def runs(self) -> tuple[Dataset, ...]:
        """All runs that were given."""
        return self._made().runs

    @property
    def rig(self) -> Rig:
        """The rig with the chosen entries."""
        return self.fitted.rig

    @property
    def estimate(self) -> Estimate:
        """The estimator's own result: all arrays, in the order of `mechanism.parameters`."""
        return self.fitted.result

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism that was identified."""
        return self.estimate.mechanism

    @property
    def covariance(self) -> FloatArray:
        """(p, p) of the parameters."""
        return self.estimate.covariance

    @property
    def trajectories(self) -> tuple[Trajectory, ...]:
        """The estimated motion, one entry a segment without gaps."""
        return self.estimate.trajectories

    @property
    def beta(self) -> FloatArray:
        """(p,) values of `parameters`; NaN where the data does not determine one, as in `std` and `ci95`."""
        return np.array([finite(p.value) for p in self.parameters])

    @property
    def std(self) -> FloatArray:
        """(p,) standard deviations."""
        return np.array([finite(p.std) for p in self.parameters])

    def ci95(self) -> FloatArray:
        """(p, 2) 95 % intervals."""
        return np.array([[finite(x) for x in p.ci95] for p in self.parameters])

    @property
    def fixed(self) -> dict[str, float]:
        """Parameters that were given, not estimated."""
        return {p.name: finite(p.value) for p in self.parameters if p.fixed}

    def check(self) -> None:
        """Raises `WorkError` for a fit that did not converge, or that knows nothing."""
        check_sound(self.estimate, for_model=False)

    def text(self, files: Files | None = None) -> str:
        """Everything that `legid fit` prints. The next step names `files`."""
        return whole_fit_text(self, files)

    def page(self, path: Path | str, files: Files | None = None) -> None:
        """Write the page of `legid fit --html`; that of a document of a file has no motion. Raises `InputError`."""
        if "made" in vars(self):
            write_fit(path, self, [run.name for run in self.fitted.setup.datasets], self.estimate, files)
        else:
            write_fit(path, self, [Path(run.file).name for run in self.provenance.runs] if self.provenance else ())

    def to_frame(self) -> DataFrame:
        """One row a parameter: value, std, low and high of its 95 % interval, unit, meaning, whether it was given.

        What the data does not determine is NaN. Raises `WorkError` without pandas.
        """
        return frame(columns(self.parameters, "parameter=name value std ci95 unit meaning fixed"), "parameter")

    def plot(self) -> Figure:
        """Sensors measured and as estimated, torques measured and modelled, over the first seconds.

        Raises `WorkError` for a fit by a method that estimates no motion, and for a document of a file.
        """
        from legid.figures import fit_figure

        if not self.trajectories:
            raise WorkError(f"a fit by {self.method} has no motion to draw; use method=\"mle\"")
        return fit_figure(self.estimate)

    def __str__(self) -> str:
        return f"{self.headline.text}\n\n{parameter_table(self).text}"
