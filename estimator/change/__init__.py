"""Changes of a rig against runs of the same rig, or between two sessions: the rig is its own reference."""

from estimator.change.detect import compare_sessions, detect_change
from estimator.change.loop_law import with_changed_law
from estimator.change.noise import LogLevels
from estimator.change.reference import Reference, learn_reference
from estimator.change.result import Change, ChangedCause, Kind, LevelChange
from estimator.change.scores import known_reference
from estimator.change.structure import Structure

__all__ = ["Change", "ChangedCause", "Kind", "LevelChange", "LogLevels", "Reference",
           "Structure", "compare_sessions", "detect_change", "known_reference", "learn_reference", "with_changed_law"]
