"""Two models on runs that neither was fitted to: parameters, free-run errors over horizons, who is better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import Dataset, Rig
from estimator.prediction import HORIZONS_S, predict
from experiments.console import progress
from experiments.judge import STATED, Comparison, Estimate, ParameterPair, horizon_errors, model_contradictions, normal
from experiments.models import Model, fitted_model_of, known_effects, shapes_of
from experiments.session import prepare, require_sound
from experiments.workflows.validate import require_mechanism


def compare_models(models: tuple[Model, Model], files: tuple[str, str], runs: Sequence[Dataset], rig: Rig,
                   sensors: str | None = None, horizons_s: Sequence[float] = HORIZONS_S) -> Comparison:
    """Compare `models`, read from `files`, on `runs` of `rig`. Raises `InputError` for models of other mechanisms,
    `FitError` where no motion can be estimated."""
    prepared = [prepare(runs, rig, sensors=sensors, model=model) for model in models]
    for model, file, one in zip(models, files, prepared):
        require_mechanism(model, one.setup, file)
    require_sound(prepared[0].setup)
    a, b = (predict([fitted_model_of(model)], progress(one.setup.datasets, f"simulating {file}", unit="run"),
                    one.setup.options, horizons_s, smoother=0) for model, file, one in zip(models, files, prepared))
    table, names = a.joined_with(b), [data.name for data in prepared[0].setup.datasets]
    return Comparison(files, parameter_pairs(models), tuple(horizon_errors(table)), table, tuple(names),
                      (*prepared[0].warnings, *_flags(models, files, names)), _notes(models), prepared[0].set_aside)


def parameter_pairs(models: tuple[Model, Model]) -> tuple[ParameterPair, ...]:
    """Parameters by name, then sizes and shapes of effects; the first model's order goes first."""
    sides = [_entries(model) for model in models]
    names = dict.fromkeys([*sides[0], *sides[1]])
    out = []
    for name in names:
        a, b = sides[0].get(name), sides[1].get(name)
        unit, meaning, _ = a or b or ("", "", None)
        out.append(ParameterPair(name, unit, meaning, None if a is None else a[2], None if b is None else b[2]))
    return tuple(out)


def _entries(model: Model) -> dict[str, tuple[str, str, Estimate]]:
    """Name -> (unit, meaning, estimate) in the order of the covariance."""
    found = [(p.name, p.unit, p.meaning, p.value) for p in model.parameters]
    known = known_effects()
    for effect in model.effects:
        kind = known[effect.name]
        place = effect.name if effect.joint is None else f"{effect.name}@{effect.joint}"
        found += [(f"{place} {s.name}", s.unit, kind.sentence, effect.sizes[s.name]) for s in kind.sizes]
        found += [(f"{place} {s.name}", s.unit, kind.sentence, effect.shapes[s.name])
                  for s in shapes_of(kind, effect)]
    out = {}
    for k, (name, unit, meaning, value) in enumerate(found):
        variance = model.covariance[k][k]
        one = normal(value, np.inf if variance is None else max(variance, 0.0) ** 0.5)
        told = model.ci95[k] if k < len(model.ci95) else None
        out[name] = unit, meaning, one if told is None else one._replace(low=told[0], high=told[1])
    return out


def _flags(models: tuple[Model, Model], files: tuple[str, str], runs: Sequence[str]) -> list[str]:
    found = [f"{file} was fitted to {', '.join(seen)}: there its errors are too small." for model, file in
             zip(models, files) if (seen := [run for run in runs if run in model.provenance.runs])]
    found += [f"{file} does not say which runs it was fitted to. If these are among them, its errors are too small."
              for model, file in zip(models, files) if not model.provenance.runs]
    for text in model_contradictions(models[0].mechanism, models[1].mechanism, STATED):
        facts = text.removeprefix("the model was fitted with ").replace("the rig", "B")
        found.append(f"The models differ in their rig: {facts}.")
    return found


def _notes(models: tuple[Model, Model]) -> tuple[str, ...]:
    common = sorted(set(models[0].provenance.runs) & set(models[1].provenance.runs))
    return (f"Both were fitted to {', '.join(common)}: the z of each difference is too small.",) if common else ()


