"""`rotate`: k-fold cross-validation of a few models (Stone 1974).

If the test runs are inconclusive, the split rotates until every run has been a test run once. The sizes of the effects
are fitted without the test runs; which effects are tried was chosen with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.data_split import RunSplit, held_out
from estimator.diagnosis.error_table import ErrorTable, measure_errors
from estimator.diagnosis.refit import Model, fit_nominal, refit
from estimator.diagnosis.result import Rotation
from estimator.errors import FitError
from estimator.parallel import parallel_map
from estimator.prediction import FloorNoise


@dataclass(frozen=True)
class Turn:
    """Errors of models on one set of held-out runs, fitted to the others."""

    runs: tuple[str, ...]
    values: FloatArray
    """(M, B, C), as in `ErrorTable`"""
    agreement: FloatArray
    """(M, R)"""
    places: NDArray[np.intp]
    """(B,) the run of each block"""
    sizes: tuple[FloatArray, ...]
    """Of each effect of the second model."""


def rotate(split: RunSplit, table: ErrorTable, rng: np.random.Generator) -> tuple[ErrorTable, tuple[Turn, ...]] | None:
    """`table` with the errors of its models on all other runs in addition to the held-out runs; and the rotations.

    `table` must contain its own unit. None where there are no other runs, or a model cannot be fitted or simulated.
    """
    others = [g for g in held_out(len(split.runs)) if g != split.confirm and len(g) < len(split.runs)]
    seeds = rng.integers(2**63, size=(len(others), len(split.runs)))
    if not others:
        return None
    unit = next(k for k, model in enumerate(table.models) if model is table.unit.reference)
    smoother = next((k for k, model in enumerate(table.models) if model is table.unit.smoother), unit)
    try:
        turns = parallel_map(lambda k: turn(split, others[k], table.models, unit, smoother, seeds[k], table.unit.noise),
                             len(others), split.workers)
    except (FitError, np.linalg.LinAlgError):
        return None
    first = np.cumsum([table.agreement.shape[1], *(t.agreement.shape[1] for t in turns[:-1])])
    return replace(table, values=np.concatenate([table.values, *(t.values for t in turns)], axis=1),
                   agreement=np.concatenate([table.agreement, *(t.agreement for t in turns)], axis=1),
                   runs=np.concatenate([table.runs, *(t.places + n for t, n in zip(turns, first))])), tuple(turns)


def turn(split: RunSplit, confirm: tuple[int, ...], models: Sequence[Model], unit: int, smoother: int,
         seeds: NDArray[np.int64], noise: FloorNoise) -> Turn:
    """Errors on `confirm` of `models` fitted to all other runs, in units of the noise floor of model `unit`.

    The smoother of model `smoother` supplies the pivot angle. Raises `FitError`.
    """
    rest = tuple(k for k in range(len(split.runs)) if k not in confirm)
    other = replace(split, fit=rest, screen=(), confirm=confirm, workers=1)
    nominal = fit_nominal(other)
    fitted = [nominal, *(refit(nominal, list(zip(m.effects, m.sizes()))) for m in models[1:])]
    found = measure_errors(fitted, fitted[unit], seeds[: len(confirm)], [smoother], noise)
    return Turn(tuple(split.names[k] for k in confirm), found.values, found.agreement, found.runs,
                tuple(fitted[1].sizes()))


def account(split: RunSplit, turns: Sequence[Turn], table: ErrorTable, row: int, material: float
            ) -> tuple[Rotation, ...]:
    """Sizes of the effects of the model in `row`, and whether the error falls by the share `material`, by rotation.

    The held-out runs come first, then each of `turns`. Empty without `turns`.
    """
    if not turns:
        return ()
    model = table.models[row]
    groups = [(tuple(split.names[k] for k in split.confirm), model.sizes()), *((t.runs, t.sizes) for t in turns)]
    out, first = [], 0
    for runs, sizes in groups:
        here = np.flatnonzero((table.runs >= first) & (table.runs < first + len(runs)))
        first += len(runs)
        named = {f"{effect.key}.{size.name}": float(value)
                 for effect, values in zip(model.effects, sizes) for size, value in zip(effect.sizes, values)}
        falls = table.error(0, here) - table.error(row, here) > material * table.error(0, here)
        out.append(Rotation(runs, named, falls))
    return tuple(out)
