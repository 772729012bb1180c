"""What changed on a rig, against runs of the same rig, or between two sessions: the rig is its own reference."""

from estimator.change.detect import compare_sessions, detect_change
from estimator.change.result import Change, ChangedCause, Detectable, HeldOut, Kind, NoiseChange, Size

__all__ = ["Change", "ChangedCause", "Detectable", "HeldOut", "Kind", "NoiseChange", "Size", "compare_sessions",
           "detect_change"]
