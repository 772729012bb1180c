"""Score and information of runs over parameters, effects and generic terms; projection, scatter, tests; tolerances."""

from estimator.score.enlargement import enlarged
from estimator.score.left_out import step_without, steps_without
from estimator.score.marginal import Marginal, discounted, marginalise, projected
from estimator.score.nuisances import (
    BEYOND,
    ONLY,
    STRUCTURE,
    TORQUE_GAIN,
    Nuisance,
    default_tolerances,
    nuisance_candidates,
    nuisances_of,
    small_effects,
    tolerance_sources,
    torque_power,
    with_torque_gain,
)
from estimator.score.run_scatter import agreement_of, robust_covariance
from estimator.score.run_scores import RunScores, score_runs
from estimator.score.score import HIDDEN, Score, columns_of, score_at, total
from estimator.score.score_tests import (
    ALPHA,
    NO_TESTS,
    RUNS,
    ScoreTests,
    determined,
    least_sigmas,
    own_inflation,
    project,
)

__all__ = [
    "ALPHA", "BEYOND", "HIDDEN", "NO_TESTS", "ONLY", "RUNS", "STRUCTURE", "TORQUE_GAIN", "Marginal", "Nuisance",
    "RunScores", "Score", "ScoreTests", "agreement_of", "columns_of",
    "default_tolerances", "determined", "discounted", "enlarged", "least_sigmas", "marginalise",
    "nuisance_candidates", "nuisances_of", "own_inflation", "project", "projected", "robust_covariance",
    "score_at", "score_runs", "small_effects", "step_without", "steps_without", "tolerance_sources", "torque_power",
    "total", "with_torque_gain",
]
