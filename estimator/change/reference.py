"""`Reference`: everything that a later comparison needs of the reference runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from daq import Dataset
from estimator.change.contrast import seen
from estimator.change.free_runs import error_levels
from estimator.change.noise import LogLevels, levels_of
from estimator.change.scores import ReferenceFit, fit_reference, score_run
from estimator.change.structure import Structure, find_structure
from estimator.errors import FitError
from estimator.loops import LawSizes
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.score import Score, total

FEWEST_RUNS = 2


@dataclass(frozen=True)
class Reference:
    """Statistics of reference runs, without the runs."""

    fit: ReferenceFit
    structure: Structure
    known: Score
    """Sum of the runs' scores and informations, each run's own structure integrated out"""
    noise: LogLevels
    errors: LogLevels
    """Of the free run of each run under the model of the others; without levels where some run cannot be simulated"""
    runs: tuple[str, ...]
    law: LawSizes = field(default_factory=LawSizes)
    """Of position loops whose input, command and angle were all measured"""


def learn_reference(runs: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float = 1.0
                    ) -> Reference:
    """Reference of at least two runs. Raises `FitError`."""
    require_runs(runs)
    with np.errstate(all="ignore"):  # a search may diverge on its way; where it ends is checked
        fit = fit_reference(runs, mechanism, options, gear_ratio)
        scores = [score_run(fit, run) for run in runs]
        structure = find_structure([scores], fit.model.mechanism.p)
        return Reference(fit, structure, total(seen(scores, structure)), levels_of(runs, mechanism, options),
                         error_levels(fit, runs, scores), tuple(run.name for run in runs),
                         LawSizes.of(runs, mechanism))


def require_runs(runs: Sequence[Dataset]) -> None:
    """Raises `FitError` for fewer than show a scatter."""
    if len(runs) < FEWEST_RUNS:
        raise FitError(f"{len(runs)} run{'s' * (len(runs) != 1)} cannot show how runs scatter; give at least "
                       f"{FEWEST_RUNS} of each session, better four")
