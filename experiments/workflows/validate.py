"""A saved model put to runs, and how far ahead it predicts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq import FloatArray, InputError
from estimator.fitting import (
    HORIZONS_S,
    Horizons,
    Validation,
    WalkAhead,
    predict,
    smoothed_states,
    validate,
    walk_ahead,
)
from estimator.model import Mechanism
from experiments.console import progress
from experiments.models import FreeRuns, Model, Prediction, build_mechanism, validate_extended
from experiments.provenance import Source
from experiments.reports import (
    Trust,
    horizons_document,
    model_contradictions,
    validation_document,
    validation_trust,
    walk_document,
)
from experiments.session import Prepared, Setup, contradictions, require_sound


@dataclass(frozen=True)
class ValidationReport:
    """Everything that a validation says, for a terminal, a page, a document or a notebook."""

    prepared: Prepared
    validations: list[Validation]
    predictions: list[Prediction]
    horizons: Horizons | None
    steps: WalkAhead | None
    seen: tuple[str, ...]
    """Runs that the model was fitted to."""
    trust: Trust

    @property
    def document(self) -> dict[str, Any]:
        """`legid.validation/1` of docs/formats.md."""
        found = validation_document(self.validations, self.prepared.setup.options.sensors, self.predictions)
        found |= {"trust": self.trust.document, "fitted_to": list(self.seen),
                  "set_aside": [run.document for run in self.prepared.set_aside]}
        found |= {} if self.horizons is None else {"horizons": horizons_document(self.horizons)}
        return found | ({} if self.steps is None else {"walk": walk_document(self.steps)})


def validate_prepared(model: Model, prepared: Prepared, where: str, files: Sequence[Source] = (),
                      against: Model | None = None) -> ValidationReport:
    """Free runs of `model`, named `where` in errors, on the runs of `prepared`, which were read from `files`.

    Raises `InputError` for a model of another mechanism, `FitError` for runs whose columns contradict themselves.
    """
    setup, seen = prepared.setup, seen_in_fit(model, files)
    validations, predictions = validate_runs(model, setup, where), predict_runs(model, setup)
    against_rig = [*contradictions(prepared.doubts), *model_contradictions(model.mechanism, setup.settings)]
    trust = validation_trust(predictions, seen, against_rig)
    return ValidationReport(prepared, validations, predictions, foretell(model, setup, against),
                            foretell_steps(model, setup), seen, trust)


def validate_runs(model: Model, setup: Setup, where: str) -> list[Validation]:
    """Free-run simulation of `model` against the runs of `setup`; `where` names the model in errors.

    Raises `InputError` for a model of another mechanism, `FitError` for runs whose columns contradict themselves.
    """
    if (setup.settings.model, setup.mechanism.n) != (model.mechanism.model, build_mechanism(model.mechanism).n):
        raise InputError(where, f"is a {model.mechanism.model}, the rig file says {setup.settings.model}",
                         "give the rig that the model was fitted on")
    require_sound(setup)
    mechanism = build_mechanism(model.mechanism)
    if model.effects:
        return validate_extended(model, mechanism, replace(setup.options, hold=model.hold), setup.datasets)
    return validate_setup(setup, mechanism, np.array(model.beta), model.hold)


def predict_runs(model: Model, setup: Setup) -> list[Prediction]:
    """Free runs of `model` over whole runs and over pieces, with their bands; session time starts at the first run.

    For the runs of `validate_runs`, which says whether the model fits the rig. Raises `FitError`.
    """
    mechanism, options = build_mechanism(model.mechanism), replace(setup.options, hold=model.hold)
    found, session_s = [], 0.0
    for data in progress(setup.datasets, "predicting", unit="run"):
        runs = FreeRuns(model, mechanism, options, data, session_s)
        found.append(runs.prediction())
        session_s += runs.seconds
    return found


def validate_setup(setup: Setup, mechanism: Mechanism, beta: FloatArray, hold: str) -> list[Validation]:
    """Free-run simulation with parameters `beta` (p,), and the mechanism (its friction's rounding) and the hold that
    they were fitted under, against every gap-free stretch of every run of `setup`."""
    options = replace(setup.options, hold=hold)
    return [found for data in progress(setup.datasets, "simulating", unit="run")
            for found in validate(data, mechanism, beta, options)]


def foretell(model: Model, setup: Setup, against: Model | None = None) -> Horizons | None:
    """Free runs of `model`, and of `against` from the same states, over pieces of 0.1, 0.5, 1, 5 s and the whole.

    None for a model with effects, whose states a piece does not begin in. Raises `FitError`.
    """
    models = [m for m in (model, against) if m is not None]
    if any(m.effects for m in models):
        return None
    mechanism = build_mechanism(model.mechanism)
    options = replace(setup.options, hold=model.hold)
    states = smoothed_states(setup.datasets, mechanism, np.array(model.beta), options)
    tables = [tuple(predict(states, build_mechanism(m.mechanism), np.array(m.beta), m.hold, horizon)
                    for horizon in (*HORIZONS_S, None)) for m in models]
    residual = np.concatenate([s.reference - s.q for s in states])
    columns = tuple(f"q{j + 1}_{mechanism.length_unit}" for j in range(mechanism.n))
    return Horizons(columns, tuple(t for t in tables[0] if t.pieces),
                    tuple(t for t in tables[1] if t.pieces) if against is not None else (),
                    np.sqrt(np.mean(residual**2, axis=0)))


def foretell_steps(model: Model, setup: Setup) -> WalkAhead | None:
    """Free runs of a walker's `model` across touchdowns; None for what does not walk, and for a model with effects,
    whose states a step does not begin in. Raises `FitError`."""
    mechanism = build_mechanism(model.mechanism)
    if not mechanism.exchanged or model.effects:
        return None
    return walk_ahead(setup.datasets, mechanism, np.array(model.beta), replace(setup.options, hold=model.hold))


def seen_in_fit(model: Model, files: Sequence[Source]) -> tuple[str, ...]:
    """Names of `files` that `model` was fitted to, by their SHA-256; models of earlier versions do not tell."""
    fitted = {source.sha256 for source in model.provenance.origin.runs} if model.provenance.origin else set()
    return tuple(source.file for source in files if source.sha256 in fitted)
