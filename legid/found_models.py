"""The models that fits and diagnoses found, with the files that they came from."""

from __future__ import annotations

from collections.abc import Sequence

from daq import Dataset, Rig, WorkError
from estimator import FitResult
from estimator.diagnosis import Diagnosis
from experiments.judge import check_sound, diagnosed_model, model_of
from experiments.models import Model
from experiments.provenance import Origin
from experiments.reports import model_with_origin
from experiments.session import Setup
from legid.results import origin_from, sources_of


def model_of_fit(fit: FitResult, setup: Setup, runs: Sequence[Dataset], origin: Origin | None = None) -> Model:
    """The identified model. Raises `WorkError` for a fit that is not sure of every parameter."""
    check_sound(fit, for_model=True)
    made = model_of(fit, setup.settings, setup.options.hold, [run.name for run in setup.datasets])
    return _with_origin(made, setup, runs, origin)


def model_of_diagnosis(found: Diagnosis, setup: Setup, rig: Rig, runs: Sequence[Dataset], origin: Origin | None = None
                       ) -> Model:
    """The extended model. Raises `WorkError` for a diagnosis that failed."""
    if found.verdict == "fit_failed":
        raise WorkError(found.sentence)
    return _with_origin(diagnosed_model(found, setup, rig.motor.gear_ratio), setup, runs, origin)


def _with_origin(made: Model, setup: Setup, runs: Sequence[Dataset], origin: Origin | None) -> Model:
    """`made` with its files; runs made by hand have none to be named."""
    sources = sources_of(runs)
    return made if len(sources) < len(runs) else model_with_origin(made, origin or origin_from(sources),
                                                                   setup.datasets)
