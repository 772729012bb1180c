"""Diagnosis of a simulation's errors: score tests, re-fits, an error budget, a verdict."""

from estimator.diagnosis.decision_rule import MATERIAL
from estimator.diagnosis.loop_law import with_law
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
    SizeEstimate,
    Trace,
)

__all__ = [
    "MATERIAL", "BudgetRow", "CandidateScore", "Cause", "Diagnosis", "Remainder", "Rotation", "SensorGain", "ShortRuns",
    "Signature", "SizeEstimate", "Trace", "diagnose", "with_law",
]
