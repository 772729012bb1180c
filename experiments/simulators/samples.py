"""`draw_models`: models of legs that the records could as well have come from.

Parameters, sizes and shapes are drawn together, normal about the model's values with its covariance, widened to its
intervals. A draw that no leg can have is drawn again: friction that drives, a size of the other sign, an inertia matrix
that is not positive definite. What is not determined stays at its value.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import structs

from daq import FloatArray, InputError, WorkError
from estimator.effects import Effect
from experiments.console import make_directory, write_text
from experiments.models import EffectValue, Model, build_mechanism, known_effects, shapes_of, widening_of
from experiments.simulators.folder import simulator_files
from experiments.simulators.parts import parts_of

MOST_DRAWS = 1000
"""For one model; more of them cannot be is said."""
Kinds = Mapping[str, type[Effect]]
PARTS = ("viscous", "coulomb", "rotor")


@dataclass(frozen=True)
class Samples:
    """Models drawn from the uncertainty of one."""

    names: tuple[str, ...]
    """(m,) of parameters, then of sizes and shapes as `effect.size`"""
    values: FloatArray
    """(N, m)"""
    models: tuple[Model, ...]
    redrawn: int
    """Draws that no leg can have."""
    held: tuple[str, ...]
    """Names of what is not determined."""

    def table(self) -> str:
        """The values as CSV, one row a model."""
        out = io.StringIO()
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow(["model", *self.names])
        rows.writerows([f"{k:03d}", *map(repr, row.tolist())] for k, row in enumerate(self.values, 1))
        return out.getvalue()


def draw_models(model: Model, where: str, count: int, seed: int) -> Samples:
    """`count` models by the covariance of `model`. Raises `InputError` for a model that states none, `WorkError` where
    hardly any draw is a leg."""
    kinds = known_effects()
    rng, middle, names = np.random.default_rng(seed), _values(model, kinds), _names(model, kinds)
    wide = np.array(widening_of(model))
    covariance = np.array([[np.nan if c is None else c for c in row] for row in model.covariance], dtype=float)
    held = ~np.isfinite(np.diag(covariance))
    if held.all() or not np.nan_to_num(covariance).any():
        raise InputError(where, "states no covariance: nothing can be drawn", "give a model that legid fit wrote")
    covariance[held] = 0.0
    covariance[:, held] = 0.0
    levels, axes = np.linalg.eigh(wide[:, None] * np.nan_to_num(covariance) * wide)
    root = axes * np.sqrt(np.maximum(levels, 0.0))
    root[np.diag(covariance) == 0.0] = 0.0  # held, to the last bit
    rows: list[FloatArray] = []
    models: list[Model] = []
    redrawn = 0
    while len(rows) < count:
        values = middle + root @ rng.standard_normal(middle.size)
        drawn = _with_values(model, values, kinds)
        if _can_be(model, drawn, where, kinds):
            rows.append(values)
            models.append(drawn)
        else:
            redrawn += 1
            if redrawn > MOST_DRAWS + count:
                raise WorkError(f"{where}: {redrawn} of {redrawn + len(rows)} draws are no leg; fit on more runs, so "
                                "that its intervals are narrower")
    return Samples(names, np.array(rows), tuple(models), redrawn, tuple(n for n, h in zip(names, held) if h))


def _names(model: Model, kinds: Kinds) -> tuple[str, ...]:
    """(m,) names of the covariance's rows."""
    return (*(p.name for p in model.parameters),
            *(f"{e.name}{f'@{e.joint}' if e.joint else ''}.{key}" for e in model.effects
              for key in (*_order(e, kinds)[0], *_order(e, kinds)[1])))


def write_samples(samples: Samples, where: str, folder: Path, command: str) -> None:
    """Write samples.csv, and one folder a model below samples/. Raises `InputError`."""
    write_text(folder / "samples.csv", samples.table())
    for k, model in enumerate(samples.models, 1):
        own = folder / "samples" / f"{k:03d}"
        make_directory(own)
        for name, text in simulator_files(model, where, command).texts.items():
            write_text(own / name, text)
    write_text(folder / "batch.py", Path(__file__).with_name("batch.py.jinja").read_text(encoding="utf-8"))


def _order(effect: EffectValue, kinds: Kinds) -> tuple[Sequence[str], Sequence[str]]:
    """Names of sizes and shapes in the estimator's order."""
    kind = kinds[effect.name]
    return [s.name for s in kind.sizes], [s.name for s in shapes_of(kind, effect)]


def _values(model: Model, kinds: Kinds) -> FloatArray:
    effects = [value for e in model.effects for names, of in zip(_order(e, kinds), (e.sizes, e.shapes))
               for value in (of[name] for name in names)]
    return np.array([*model.beta, *effects])


def _with_values(model: Model, values: FloatArray, kinds: Kinds) -> Model:
    rest = iter(values.tolist())
    parameters = tuple(structs.replace(p, value=next(rest)) for p in model.parameters)
    effects = tuple(structs.replace(e, sizes={name: next(rest) for name in _order(e, kinds)[0]},
                                    shapes={name: next(rest) for name in _order(e, kinds)[1]}) for e in model.effects)
    return structs.replace(model, parameters=parameters, effects=effects)


def _can_be(model: Model, drawn: Model, where: str, kinds: Kinds) -> bool:
    """Whether a leg can have the drawn values: signs as those of `model`, bodies with inertia."""
    mechanism = build_mechanism(model.mechanism)
    for p, before, after in zip(mechanism.parameters, model.beta, drawn.beta):
        if p.term in PARTS and after < min(before, 0.0):
            return False
    for old, new in zip(model.effects, drawn.effects):
        first = list(_order(old, kinds)[0])[: kinds[old.name].positive]
        if any(new.sizes[name] < min(old.sizes[name], 0.0) for name in first):
            return False
        if any(new.shapes[name] * old.shapes[name] <= 0.0 for name in old.shapes):
            return False
    try:
        parts_of(drawn, where)
    except InputError:
        return False
    return True
