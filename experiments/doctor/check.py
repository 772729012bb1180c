"""`Check`: one line of a preflight; `Heard`: what the devices said while nobody commanded anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from daq.runs import RawRun

Status = Literal["ok", "warn", "FAIL"]


@dataclass(frozen=True)
class Check:
    """One line: what was looked at, how it stands, what was found and, where it is not ok, what to do."""

    name: str
    status: Status
    words: str


@dataclass(frozen=True)
class Heard:
    """Readings of the devices while nothing was commanded."""

    raw: RawRun
    seconds: float
    bad: int
    """Frames with a wrong check sum or length."""
    lost: int
    """Telemetry missing by its sequence numbers."""
