"""Uses that a fit or a diagnosis states, held against runs that it has not seen."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from daq import load_rig
from estimator.prediction import USE_HORIZONS_S, predict
from estimator.use import Speed
from experiments.models import fitted_model_of, load_model
from experiments.session import as_datasets, prepare


class Held(NamedTuple):
    """One stated figure against one new run."""

    model: str
    what: str
    """Use, or speed of a torque's error."""
    stated: float
    found: float
    within: bool | None
    """None where the figure has no interval"""
    supported: bool


def on_new_runs(label: str, uses: Iterable[Mapping[str, Any]], model: Path, rig: Path, seen: Sequence[Path],
                runs: Sequence[Path]) -> Iterator[Held]:
    """Each figure of `uses` against each of `runs`. They and those `seen` by the fit set the units of errors."""
    found = load_model(model)
    setup = prepare(as_datasets([*seen, *runs], load_rig(rig), False), load_rig(rig), model=found).setup
    errors = predict([fitted_model_of(found)], setup.datasets, setup.options, USE_HORIZONS_S)
    size = errors.samples.max(axis=1)
    driven = list(setup.mechanism.actuated)

    def by_run(squares: np.ndarray, sizes: np.ndarray) -> Iterator[float]:
        for run in range(len(seen), len(seen) + len(runs)):
            inside = errors.run == run
            if sizes[inside].sum() > 0.0:
                yield float(np.sqrt(squares[inside].sum() / sizes[inside].sum()))

    def against(what: str, one: Mapping[str, Any], stated: float, supported: bool, measured: Iterable[float]
                ) -> Iterator[Held]:
        for error in measured:
            inside = None if one["ci95"] is None else one["ci95"][0] <= error <= one["ci95"][1]
            yield Held(label, what, stated, error, inside, supported)

    for one in uses:
        if one["use"] == "simulation":
            horizon = one["horizon_s"] if one["horizon_s"] in USE_HORIZONS_S else inf
            measured = by_run(errors.by_block(horizon)[0] * size, size)
        elif one["use"] == "feedforward":
            measured = by_run(*errors.torques(0, driven))
            for each in one["by_speed"]:
                squares, counts = errors.torques_by_speed(0, each["joint"] - 1)
                k = get_args(Speed).index(each["speed"])
                yield from against(each["speed"], each, each["rms"], False, by_run(squares[k], counts[k]))
        else:
            continue
        yield from against(one["use"], one, one["figure"], one["supported"], measured)
