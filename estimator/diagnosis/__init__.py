"""What the simulation gets wrong: score tests, re-fits, comparison, conclusion."""

from estimator.diagnosis.procedure import diagnose
from estimator.diagnosis.result import Cause, Diagnosis, Ranked, SensorGain, ShortRuns, Signature, Trace

__all__ = ["Cause", "Diagnosis", "Ranked", "SensorGain", "ShortRuns", "Signature", "Trace", "diagnose"]
