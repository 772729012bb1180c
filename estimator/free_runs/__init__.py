"""Free runs of models over runs, and one table of their errors under every verb, verdict and page.

Definitions, once for all:

- A *free run* starts from the model's own smoothed state and is driven by the measured torque alone. That state is of
  the likeliest motion given all sensors of the run, the model's parameters held, noise levels estimated from that run.
- A *horizon* h cuts each gap-free segment into pieces of about h, each with its own start. Infinity is one piece a
  segment.
- An *error* is what the sensor read less what the simulation reads, squared and averaged. An angle that no encoder
  measures, and every rate, is compared with the smoothed motion of one model, the *smoother*.
- A piece that diverges is replaced by its initial state and counted. A whole segment that diverges has an infinite
  error.
- The *noise floor* is the same error of records that the model itself would have given, with its noise.
- Baselines: the last velocity kept; a constant prediction at the sensor's mean.
"""

from estimator.free_runs.filtered import filtered_motion, predict_filtered
from estimator.free_runs.fitted_model import FittedModel
from estimator.free_runs.measured_use import measured_use, on_one_more
from estimator.free_runs.predicted_run import (
    HORIZONS_S,
    SHORT_S,
    PredictedRun,
    channel_names,
    predict_run,
    rows_of,
)
from estimator.free_runs.smoothed_run import SmoothedRun
from estimator.free_runs.table import BLOCK_S, PredictionTable, Ratio, log_ratio, paired_ratio, tabulate, together

__all__ = [
    "BLOCK_S",
    "HORIZONS_S",
    "SHORT_S",
    "FittedModel",
    "PredictedRun",
    "PredictionTable",
    "Ratio",
    "SmoothedRun",
    "channel_names",
    "filtered_motion",
    "log_ratio",
    "measured_use",
    "on_one_more",
    "paired_ratio",
    "predict_filtered",
    "predict_run",
    "rows_of",
    "tabulate",
    "together",
]
