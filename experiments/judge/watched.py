"""One watched run, and its state."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from estimator.change import Change, WatchedRun


@dataclass(frozen=True)
class Watched:
    """One run, tested."""

    found: WatchedRun
    change: Change | None = None
    """After an alarm, from two runs on: what changed since the run with the alarm."""
    recorded: datetime | None = None
    """When its recording began [UTC], of a native run file."""

    @property
    def state(self) -> str:
        """alarm, not tested, changed (since an earlier alarm) or ok."""
        if self.found.alarm is not None:
            return "alarm"
        if self.found.failed:
            return "not tested"
        return "changed" if self.change is not None and self.change.verdict != "no_change" else "ok"
