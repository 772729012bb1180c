"""Changes of a rig against earlier runs of the same rig: the rig is its own reference."""

from estimator.change.detect import detect_change
from estimator.change.result import Change, ChangedCause, Detectable, HeldOut, Size

__all__ = ["Change", "ChangedCause", "Detectable", "HeldOut", "Size", "detect_change"]
