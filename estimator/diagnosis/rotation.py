"""`rotate`: errors of a few models on every run, each fitted without the runs that it is tried on.

The runs kept back chose nothing, and are few: where the error neither surely falls on them nor surely does not, every
other run is kept back in its turn, the models are fitted to the rest, and the fall is judged over all
(cross-validation, Stone 1974). Which effects are tried was chosen with those other runs; their sizes were not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.data_split import RunSplit, kept_back
from estimator.diagnosis.error_table import ErrorTable, measure_errors
from estimator.diagnosis.refit import Model, fit_nominal, refit
from estimator.diagnosis.result import Rotation
from estimator.errors import FitError
from estimator.parallel import parallel_map
from estimator.prediction import FloorNoise


@dataclass(frozen=True)
class Turn:
    """What one set of runs kept back says of models fitted to the others."""

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
    """`table`, which holds what its errors are counted in, with the errors of its models on all other runs beside those
    on the runs kept back; None where there are no others, or where one of the models cannot be fitted or simulated."""
    others = [g for g in kept_back(len(split.runs)) if g != split.confirm and len(g) < len(split.runs)]
    seeds = rng.integers(2**63, size=(len(others), len(split.runs)))
    if not others:
        return None
    unit = next(k for k, model in enumerate(table.models) if model is table.unit.reference)
    reader = next((k for k, model in enumerate(table.models) if model is table.unit.reader), unit)
    try:
        turns = parallel_map(lambda k: turn(split, others[k], table.models, unit, reader, seeds[k], table.unit.noise),
                             len(others), split.workers)
    except (FitError, np.linalg.LinAlgError):
        return None
    first = np.cumsum([table.agreement.shape[1], *(t.agreement.shape[1] for t in turns[:-1])])
    return replace(table, values=np.concatenate([table.values, *(t.values for t in turns)], axis=1),
                   agreement=np.concatenate([table.agreement, *(t.agreement for t in turns)], axis=1),
                   runs=np.concatenate([table.runs, *(t.places + n for t, n in zip(turns, first))])), tuple(turns)


def turn(split: RunSplit, confirm: tuple[int, ...], models: Sequence[Model], unit: int, reader: int,
         seeds: NDArray[np.int64], noise: FloorNoise) -> Turn:
    """`models` fitted to all runs but `confirm`, tried on those, in units of what `noise` leaves of the one in `unit`;
    the one in `reader` reads the pivot's angle. Raises `FitError`."""
    rest = tuple(k for k in range(len(split.runs)) if k not in confirm)
    other = replace(split, fit=rest, screen=(), confirm=confirm, workers=1)
    nominal = fit_nominal(other)
    fitted = [nominal, *(refit(nominal, list(zip(m.effects, m.sizes()))) for m in models[1:])]
    found = measure_errors(fitted, fitted[unit], seeds[: len(confirm)], [reader], noise)
    return Turn(tuple(split.names[k] for k in confirm), found.values, found.agreement, found.runs,
                tuple(fitted[1].sizes()))


def account(split: RunSplit, turns: Sequence[Turn], table: ErrorTable, row: int, material: float
            ) -> tuple[Rotation, ...]:
    """Sizes of the effects of the model in `row`, and whether the error falls with it by the share `material`: on the
    runs kept back, then in each of the `turns`. Empty without these."""
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
