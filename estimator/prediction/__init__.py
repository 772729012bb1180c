"""Free-run errors of models: one table under every verb, verdict and page.

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

from estimator.prediction.floor import FloorNoise, floor_errors, white_noise
from estimator.prediction.free_runs import HORIZONS_S, SHORT_S, PredictedRun, channel_names, predict_run
from estimator.prediction.learnt_structure import (
    RunSignals,
    Structure,
    find_structure,
    outside_range,
    where_of,
    with_torques,
    words_of,
)
from estimator.prediction.predict import predict, predict_filtered
from estimator.prediction.predictor import Predictor
from estimator.prediction.replicate import draw_disturbance, draw_replicate, simulate_run
from estimator.prediction.smoothing import (
    SmoothedRun,
    filtered_motion,
    per_value,
    smooth,
    smooth_segments,
    smooth_under,
)
from estimator.prediction.structure import repeated_share, state_columns, taken
from estimator.prediction.table import BLOCK_S, PredictionTable, Ratio, tabulate, together
from estimator.prediction.torque_regression import LearntTorque
from estimator.prediction.validation import Validation, validations_of
from estimator.prediction.walking import StepsAhead, WalkAhead, Whole, walk_ahead

__all__ = [
    "BLOCK_S",
    "HORIZONS_S",
    "SHORT_S",
    "FloorNoise",
    "LearntTorque",
    "PredictedRun",
    "PredictionTable",
    "Predictor",
    "Ratio",
    "RunSignals",
    "SmoothedRun",
    "StepsAhead",
    "Structure",
    "Validation",
    "WalkAhead",
    "Whole",
    "channel_names",
    "draw_disturbance",
    "draw_replicate",
    "filtered_motion",
    "find_structure",
    "floor_errors",
    "outside_range",
    "per_value",
    "predict",
    "predict_filtered",
    "predict_run",
    "repeated_share",
    "simulate_run",
    "smooth",
    "smooth_segments",
    "smooth_under",
    "state_columns",
    "tabulate",
    "taken",
    "together",
    "validations_of",
    "walk_ahead",
    "where_of",
    "white_noise",
    "with_torques",
    "words_of",
]
