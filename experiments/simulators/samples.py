"""`draw_models`: models of legs that the records could as well have come from.

Parameters, sizes and shapes are drawn together, normal about the model's values with its covariance, widened to its
intervals. A draw that no leg can have is drawn again: friction that drives, a size of the other sign, an inertia matrix
that is not positive definite. What is not determined stays at its value.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import structs

from daq import FloatArray, InputError, WorkError
from estimator.effects import Effect
from experiments.console import make_directory, write_text
from experiments.models import Model, build_mechanism, effect_value, effects_of, widening_of
from experiments.simulators.folder import simulator_files
from experiments.simulators.parts import parts_of

MOST_DRAWS = 1000
"""For one model; more of them cannot be is said."""
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
    effects, rng = effects_of(model), np.random.default_rng(seed)
    middle = np.concatenate([np.array(model.beta), *[size for _, size in effects]])
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
        drawn = _drawn(model, effects, values)
        if drawn is not None and _has_bodies(drawn, where):
            rows.append(values)
            models.append(drawn)
        else:
            redrawn += 1
            if redrawn > MOST_DRAWS + count:
                raise WorkError(f"{where}: {redrawn} of {redrawn + len(rows)} draws are no leg; fit on more runs, so "
                                "that its intervals are narrower")
    names = (*(p.name for p in model.parameters), *(
        f"{value.name}{f'@{value.joint}' if value.joint else ''}.{name}" for value, (effect, _) in
        zip(model.effects, effects) for name in (*(s.name for s in effect.sizes), *(s.name for s in effect.shapes))))
    return Samples(names, np.array(rows), tuple(models), redrawn, tuple(n for n, h in zip(names, held) if h))


def write_samples(samples: Samples, where: str, folder: Path, command: str) -> None:
    """Write samples.csv, and one folder a model below samples/. Raises `InputError`."""
    write_text(folder / "samples.csv", samples.table())
    for k, model in enumerate(samples.models, 1):
        own = folder / "samples" / f"{k:03d}"
        make_directory(own)
        for name, text in simulator_files(model, where, command).texts.items():
            write_text(own / name, text)
    write_text(folder / "batch.py", Path(__file__).with_name("batch.py.jinja").read_text(encoding="utf-8"))


def _drawn(model: Model, effects: Sequence[tuple[Effect, FloatArray]], values: FloatArray) -> Model | None:
    """`model` with these values (m,); None where a sign is another than in `model`, so that no leg can have them."""
    ends = np.cumsum([len(model.parameters), *(size.size for _, size in effects)])[:-1]
    beta, *sizes = np.split(values, ends)
    for p, before, after in zip(build_mechanism(model.mechanism).parameters, model.beta, beta):
        if p.term in PARTS and after < min(before, 0.0):
            return None
    for (effect, old), new in zip(effects, sizes):
        first, shapes = slice(effect.positive), slice(len(effect.sizes), None)
        if (new[first] < np.minimum(old[first], 0.0)).any() or (new[shapes] * old[shapes] <= 0.0).any():
            return None
    return structs.replace(
        model, parameters=tuple(structs.replace(p, value=value) for p, value in zip(model.parameters, beta.tolist())),
        effects=tuple(effect_value(effect, own) for (effect, _), own in zip(effects, sizes)))


def _has_bodies(drawn: Model, where: str) -> bool:
    """Whether rigid bodies can have the drawn values."""
    try:
        parts_of(drawn, where)
    except InputError:
        return False
    return True
