"""Score and information of runs over parameters, effects and generic terms; projection, scatter, tests."""

from estimator.score.run_scatter import agreement_of, robust_covariance, student_quantile
from estimator.score.run_scores import RunScores, score_runs
from estimator.score.score import HIDDEN, Score, columns_of, score_alone, score_at, total
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
    "ALPHA", "HIDDEN", "NO_TESTS", "RUNS", "RunScores", "Score", "ScoreTests", "agreement_of", "columns_of",
    "determined", "least_sigmas", "own_inflation", "project", "robust_covariance", "score_alone", "score_at",
    "score_runs", "student_quantile", "total",
]
