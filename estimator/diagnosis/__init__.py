"""Diagnosis of a simulation's errors: score tests, re-fits, an error budget, a verdict."""

from estimator.diagnosis.decision_rule import MATERIAL
from estimator.diagnosis.procedure import diagnose
from estimator.diagnosis.result import (
    BudgetRow,
    CandidateScore,
    Cause,
    Diagnosis,
    Remainder,
    Rotation,
    SensorGain,
    ShortRuns,
    Signature,
    Trace,
)

__all__ = [
    "MATERIAL", "BudgetRow", "CandidateScore", "Cause", "Diagnosis", "Remainder", "Rotation", "SensorGain", "ShortRuns",
    "Signature", "Trace", "diagnose",
]
