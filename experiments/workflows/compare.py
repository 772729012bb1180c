"""Two models on runs that neither was fitted to: parameters, free-run errors over horizons, who is better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, FloatArray, InputError, Rig
from experiments.console import progress
from experiments.models import FreeRuns, Model, build_mechanism, known_effects
from experiments.reports import Comparison, Estimate, HorizonError, ParameterPair, model_contradictions, normal
from experiments.session import Prepared, prepare, require_sound

HORIZONS_S = (0.25, 0.5, 1.0, 2.0, 5.0, np.inf)
BLOCK_S = 2.0
"""Errors further apart than this count as independent."""
LEAST_BLOCKS = 5
DRAWS = 2000


def compare_models(models: tuple[Model, Model], files: tuple[str, str], runs: Sequence[Dataset], rig: Rig,
                   sensors: str | None = None) -> Comparison:
    """Compare `models`, read from `files`, on `runs` of `rig`. Raises `InputError` for models of other mechanisms,
    `FitError` where no motion can be estimated."""
    prepared = [prepare(runs, rig, sensors=sensors, beta=np.array(model.beta)) for model in models]
    sides = [_free_runs(model, file, one) for model, file, one in zip(models, files, prepared)]
    names = [data.name for data in prepared[0].setup.datasets]
    traces = sides[0][0].prediction(), sides[1][0].prediction()
    errors = [error for horizon in HORIZONS_S if np.isinf(horizon) or any(p.longest_s > horizon for p in traces)
              for error in _errors(sides, horizon)]
    return Comparison(files, parameter_pairs(models), tuple(errors), traces, tuple(names),
                      (*prepared[0].warnings, *_doubts(models, files, names)), _notes(models),
                      prepared[0].set_aside)


def _free_runs(model: Model, file: str, prepared: Prepared) -> list[FreeRuns]:
    setup = prepared.setup
    mechanism = build_mechanism(model.mechanism)
    if (setup.settings.model, setup.mechanism.n) != (model.mechanism.model, mechanism.n):
        raise InputError(file, f"is a {model.mechanism.model}, the rig file says {setup.settings.model}",
                         "give the rig that the model was fitted on")
    require_sound(setup)
    options, found, session_s = replace(setup.options, hold=model.hold), [], 0.0
    for data in progress(setup.datasets, f"simulating {file}", unit="run"):
        found.append(FreeRuns(model, mechanism, options, data, session_s))
        session_s += found[-1].seconds
    return found


def _errors(sides: Sequence[Sequence[FreeRuns]], horizon_s: float) -> list[HorizonError]:
    """One a column that all runs have."""
    squares: list[dict[str, list[FloatArray] | None]] = []
    columns = [c for c in sides[0][0].measured if all(c in runs.measured for side in sides for runs in side)]
    for side in sides:
        blocks: dict[str, list[FloatArray] | None] = {c: [] for c in columns}
        for runs in side:
            simulated = runs.simulated(horizon_s)
            parts = max(1, round(runs.seconds / BLOCK_S))
            for c in columns:
                kept = blocks[c]
                if simulated is None or kept is None:
                    blocks[c] = None
                    continue
                kept += np.array_split((simulated[c] - runs.measured[c]) ** 2, parts)
        squares.append(blocks)
    return [_error(horizon_s, c, squares[0][c], squares[1][c]) for c in columns]


def _error(horizon_s: float, column: str, a: list[FloatArray] | None, b: list[FloatArray] | None) -> HorizonError:
    rms = [np.inf if x is None else float(np.sqrt(np.nanmean(np.concatenate(x)))) for x in (a, b)]
    if a is None or b is None or len(a) < LEAST_BLOCKS:
        return HorizonError(horizon_s, column, rms[0], rms[1], None)
    means = np.array([[np.nanmean(x), np.nanmean(y)] for x, y in zip(a, b) if np.isfinite(x).any()])
    rng = np.random.default_rng(0)
    drawn = means[rng.integers(0, len(means), (DRAWS, len(means)))].mean(axis=1)
    low, high = np.quantile(np.sqrt(drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300)), [0.025, 0.975])
    return HorizonError(horizon_s, column, rms[0], rms[1], (float(low), float(high)))


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
        found += [(f"{place} {s.name}", s.unit, kind.sentence, effect.shapes[s.name]) for s in kind.shapes]
    out = {}
    for k, (name, unit, meaning, value) in enumerate(found):
        variance = model.covariance[k][k]
        one = normal(value, np.inf if variance is None else max(variance, 0.0) ** 0.5)
        told = model.ci95[k] if k < len(model.ci95) else None
        out[name] = unit, meaning, one if told is None else one._replace(low=told[0], high=told[1])
    return out


def _doubts(models: tuple[Model, Model], files: tuple[str, str], runs: Sequence[str]) -> list[str]:
    found = [f"{file} was fitted to {', '.join(seen)}: there its errors are too small." for model, file in
             zip(models, files) if (seen := [run for run in runs if run in model.provenance.runs])]
    for text in model_contradictions(models[0].mechanism, models[1].mechanism):
        facts = text.removeprefix("the model was fitted with ").replace("the rig", "B")
        found.append(f"The models differ in their rig: {facts}.")
    return found


def _notes(models: tuple[Model, Model]) -> tuple[str, ...]:
    common = sorted(set(models[0].provenance.runs) & set(models[1].provenance.runs))
    return (f"Both were fitted to {', '.join(common)}: z of their differences is too small.",) if common else ()


