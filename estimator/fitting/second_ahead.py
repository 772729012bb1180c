"""`errors_ahead`: how far models predict the next second, by free runs from filtered motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray
from estimator.free_runs import SHORT_S, FittedModel, predict_filtered
from estimator.options import FitOptions
from estimator.signals import SignalSet


def errors_ahead(signals: Sequence[SignalSet], models: Sequence[FittedModel], options: FitOptions) -> FloatArray:
    """(M, S) mean squared error of each of M models over each piece of `SHORT_S`, see `PredictionTable.by_block`.

    The pieces start from filtered motion, which is of no model.
    """
    with np.errstate(all="ignore"):  # what diverges counts as it does in the table
        return predict_filtered(models, signals, options, SHORT_S, each_piece=True).by_block(SHORT_S)
