"""Findings about a run in addition to its samples: damage of its file, flags, faults of readings, steps of a walker."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Literal

DamageKind = Literal["cut", "recovered", "check_sum", "messages", "form", "imu_missing", "imu_twice"]
FlagKind = Literal["imu_rate", "imu_missing", "imu_unmarked", "imu_repeated", "gravity", "rig", "rows", "grid", "clock",
                   "readings"]
FaultKind = Literal["clipped", "wrapped", "isolated", "stepped", "frozen", "repeated", "denormal", "standstill", "lost",
                    "refused", "start"]
RemedyKind = Literal["left_out", "unwrapped", "joined", "zeroed", "kept"]
DONE = {"left_out": "Left out", "unwrapped": "Unwrapped", "joined": "Joined", "zeroed": "Taken for zero",
        "kept": "Left as read"}


@dataclass(frozen=True)
class Damage:
    """One way in which a run file is not what was recorded."""

    kind: DamageKind
    text: str
    """For a person, one sentence."""

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Flag:
    """One thing in a run that cannot be true of its rig, or contradicts the rig file in use."""

    kind: FlagKind
    text: str
    """For a person, one sentence."""

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class ReadingFault:
    """Readings of one column that the device cannot have measured, and what was done with them."""

    column: str
    what: FaultKind
    rows: tuple[tuple[int, int], ...]
    """First and last sample of each place, counted from 1."""
    size: float
    """The level, the jump or the error, in the column's unit; for repeats how often each reading stands."""
    done: RemedyKind
    text: str
    """For a person, one sentence without a full stop."""
    time_s: float = nan
    """Of a step."""

    @property
    def document(self) -> dict[str, object]:
        """For the JSON documents."""
        return {"column": self.column, "what": self.what, "rows": [list(place) for place in self.rows],
                "size": self.size, "done": self.done, "text": str(self)}

    def __str__(self) -> str:
        return f"{self.text}. {DONE[self.done]}"


@dataclass(frozen=True)
class Steps:
    """The touchdowns by which a walker's run was cut."""

    touchdowns: int
    within_s: float | None
    """How well they are placed by the angles [s]; None where a column gave them."""

    def __str__(self) -> str:
        by = "its column stance says" if self.within_s is None else \
            f"its angles show, to {1e3 * self.within_s:.1f} ms, for it has no column stance"
        return f"{self.touchdowns} touchdowns, as {by}"
