"""A saved model put to runs: the table of its free-run errors, and how many steps ahead a walker's goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from msgspec import structs

from daq import Dataset, InputError
from estimator import FitResult
from estimator.prediction import (
    HORIZONS_S,
    SHORT_S,
    FittedModel,
    PredictionTable,
    SmoothedRun,
    WalkAhead,
    predict,
    walk_ahead,
)
from experiments.console import progress
from experiments.documents import ValidationDocument
from experiments.judge import Trust, model_contradictions, validation_trust, with_fit_trust
from experiments.models import Model, build_mechanism, fitted_model_of, range_note
from experiments.provenance import Source
from experiments.session import Prepared, Setup, contradictions, require_sound

D = TypeVar("D", bound=ValidationDocument)

@dataclass(frozen=True)
class ValidationReport:
    """Free runs of a model with their trust, from which the document is made."""

    prepared: Prepared
    table: PredictionTable
    steps: WalkAhead | None
    seen: tuple[str, ...]
    """Runs that the model was fitted to."""
    trust: Trust
    smoothed: tuple[SmoothedRun, ...] = ()
    """Each run as the model's smoother has it."""
    told: tuple[str, ...] = ()
    """What else contradicts the rig or the model."""

    simulator: str = "legid"
    own: PredictionTable | None = None
    """legid's own free runs, where another program has simulated."""

    def as_document(self, kind: type[D]) -> D:
        """`legid.validation/1` as `kind`, the struct or one derived from it, without its provenance."""
        made = kind.of(self.table, self.trust, self.prepared, self.seen, self.steps)
        return made if self.simulator == "legid" else structs.replace(made, simulator=self.simulator)


def validate_prepared(model: Model, prepared: Prepared, where: str, files: Sequence[Source] = (),
                      against: Model | None = None, horizons_s: Sequence[float] = HORIZONS_S
                      ) -> ValidationReport:
    """Report like that of `validate_model`, on the runs of `prepared`, which were read from `files`, with its trust."""
    setup, seen = prepared.setup, seen_in_fit(model, files)
    table, steps, notes, smoothed = validate_model(model, setup, where, against, horizons_s)
    told = (*contradictions(prepared.flags), *model_contradictions(model.mechanism, setup.settings), *notes)
    trust = with_fit_trust(validation_trust(table, seen, told), model.trust)
    return ValidationReport(prepared, table, steps, seen, trust, smoothed, told)


class Validated(NamedTuple):
    """Result of a validation."""

    table: PredictionTable
    """Of the model, then of the other one it is held against"""
    steps: WalkAhead | None
    """Of a walker"""
    notes: tuple[str, ...] = ()
    """Runs that leave the range of the model's structure"""
    smoothed: tuple[SmoothedRun, ...] = ()
    """Each run as the model's smoother has it"""


def validate_model(model: Model, setup: Setup, where: str, against: Model | None = None,
                   horizons_s: Sequence[float] = HORIZONS_S) -> Validated:
    """Free runs of `model` on the runs of `setup`, next to those of the model `against`; `where` names it in errors.

    The horizon `SHORT_S` and whole segments are always among the horizons.
    Raises `InputError` for a model of another mechanism, `FitError` for runs whose columns contradict themselves.
    """
    require_mechanism(model, setup, where)
    require_sound(setup)
    models = [fitted_model_of(m) for m in (model, against) if m is not None]
    walked: list[tuple[Dataset, SmoothedRun]] = []
    table = predict_setup(models, setup, horizons_s, walked)
    steps = walk_ahead(walked) if models[0].mechanism.exchanged and not models[0].effects else None
    notes = [(data.name, range_note(model, one.state.x.q, one.state.x.v, one.drive)) for data, one in walked]
    return Validated(table, steps, tuple(f"{run}: {note}" for run, note in notes if note),
                     tuple(one for _, one in walked))


def predict_setup(models: Sequence[FittedModel], setup: Setup, horizons_s: Sequence[float] = HORIZONS_S,
                  walked: list[tuple[Dataset, SmoothedRun]] | None = None) -> PredictionTable:
    """The table of free-run errors of `models` on the runs of `setup`; the first reads what no sensor does. `walked`
    takes each run with the first model's smoothed motion. Raises `FitError`."""
    def seen(data: Dataset, smoothed: Sequence[SmoothedRun]) -> None:
        if walked is not None:
            walked.append((data, smoothed[0]))

    return predict(models, progress(setup.datasets, "simulating", unit="run"), setup.options,
                   {*horizons_s, SHORT_S}, smoother=0, seen=seen)


def model_of_fit(result: FitResult) -> FittedModel:
    """The model of a fit, with the friction smoothing velocity and the hold that it was fitted under."""
    return FittedModel(result.mechanism, result.hold, result.beta, covariance=result.covariance)


def require_mechanism(model: Model, setup: Setup, where: str) -> None:
    """Raises `InputError` for a model of another mechanism than the rig's."""
    if (setup.settings.model, setup.mechanism.n) != (model.mechanism.model, build_mechanism(model.mechanism).n):
        raise InputError(where, f"is a {model.mechanism.model}, the rig file says {setup.settings.model}",
                         "give the rig that the model was fitted on")


def seen_in_fit(model: Model, files: Sequence[Source]) -> tuple[str, ...]:
    """Names of `files` that `model` was fitted to, by their SHA-256; models of earlier versions do not tell."""
    fitted = {source.sha256 for source in model.provenance.origin.runs} if model.provenance.origin else set()
    return tuple(source.file for source in files if source.sha256 in fitted)
