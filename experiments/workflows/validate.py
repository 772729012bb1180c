"""A saved model put to runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq import FloatArray, InputError
from estimator.fitting import Validation, validate
from experiments.console import progress
from experiments.models import Model, build_mechanism, validate_extended
from experiments.rig import Setup


def validate_runs(model: Model, setup: Setup, where: str) -> list[Validation]:
    """Free-run simulation of `model` against the runs of `setup`; `where` names the model in errors."""
    if (setup.settings.model, setup.mechanism.n) != (model.mechanism.model, build_mechanism(model.mechanism).n):
        raise InputError(where, f"is a {model.mechanism.model}, the rig file says {setup.settings.model}",
                         "give the rig that the model was fitted on")
    mechanism, options = build_mechanism(model.mechanism), replace(setup.options, hold=model.hold)
    if model.effects:
        return validate_extended(model, mechanism, options, setup.datasets)
    return validate_setup(replace(setup, mechanism=mechanism, options=options), np.array(model.beta))


def validate_setup(setup: Setup, beta: FloatArray) -> list[Validation]:
    """Free-run simulation with parameters `beta` (p,) against every gap-free stretch of every run of `setup`."""
    return [found for data in progress(setup.datasets, "simulating", unit="run")
            for found in validate(data, setup.mechanism, beta, setup.options)]
