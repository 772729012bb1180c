"""Predictions: runs smoothed under a model, free runs from there, the noise floor, the structure that repeats.

What a free run, a horizon and an error are: see `estimator.free_runs`, whose names this room hands on.
"""

from estimator.free_runs import (
    HORIZONS_S,
    SHORT_S,
    FittedModel,
    PredictedRun,
    PredictionTable,
    SmoothedRun,
    channel_names,
    filtered_motion,
    predict_filtered,
    predict_run,
    tabulate,
    together,
)
from estimator.prediction.floor import FloorNoise, floor_errors, white_noise
from estimator.prediction.learnt_structure import (
    RunSignals,
    Structure,
    find_structure,
    outside_range,
    where_of,
    with_torques,
    words_of,
)
from estimator.prediction.predict import predict
from estimator.prediction.replicate import draw_replicate, simulate_run
from estimator.prediction.smoothing import per_value, smooth, smooth_segments, smooth_under
from estimator.prediction.structure import driven_columns, repeated_share, state_columns, taken
from estimator.prediction.torque_regression import LearntTorque
from estimator.prediction.uses import USE_HORIZONS_S, predict_left_out, uses_of
from estimator.prediction.validation import Validation, segments_as, validations_of
from estimator.prediction.walking import WalkAhead, walk_ahead

__all__ = [
    "HORIZONS_S",
    "SHORT_S",
    "USE_HORIZONS_S",
    "FittedModel",
    "FloorNoise",
    "LearntTorque",
    "PredictedRun",
    "PredictionTable",
    "RunSignals",
    "SmoothedRun",
    "Structure",
    "Validation",
    "WalkAhead",
    "channel_names",
    "draw_replicate",
    "driven_columns",
    "filtered_motion",
    "find_structure",
    "floor_errors",
    "outside_range",
    "per_value",
    "predict",
    "predict_filtered",
    "predict_left_out",
    "predict_run",
    "repeated_share",
    "segments_as",
    "simulate_run",
    "smooth",
    "smooth_segments",
    "smooth_under",
    "state_columns",
    "tabulate",
    "taken",
    "together",
    "uses_of",
    "validations_of",
    "walk_ahead",
    "where_of",
    "white_noise",
    "with_torques",
    "words_of",
]
