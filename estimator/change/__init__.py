"""Changes of a rig against runs of the same rig, or between two sessions: the rig is its own reference."""

from estimator.change.detect import compare_sessions, detect_change
from estimator.change.loop_law import with_changed_law
from estimator.change.noise import LogLevels
from estimator.change.reference import Reference, learn_reference
from estimator.change.result import Change, ChangedCause, Detectable, HeldOut, Kind, LevelChange, Size
from estimator.change.scores import known_reference, score_run
from estimator.change.structure import Structure
from estimator.change.watch import Block, Watch, WatchedRun, start_watch

__all__ = ["Block", "Change", "ChangedCause", "Detectable", "HeldOut", "Kind", "LevelChange", "LogLevels",
           "Reference", "Size", "Structure", "Watch", "WatchedRun", "compare_sessions", "detect_change",
           "known_reference", "learn_reference", "score_run", "start_watch", "with_changed_law"]
