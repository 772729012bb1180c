"""What the simulation gets wrong: score tests, re-fits, comparison, conclusion."""

from estimator.diagnosis.procedure import diagnose
from estimator.diagnosis.result import CandidateScore, Cause, Diagnosis, SensorGain, ShortRuns, Signature, Trace

__all__ = ["CandidateScore", "Cause", "Diagnosis", "SensorGain", "ShortRuns", "Signature", "Trace", "diagnose"]
