"""`Change`: what differs between test runs and reference runs of one rig, or between two sessions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from estimator.verdicts import ChangeVerdict, SizeEstimate

Kind = Literal["parameters", "mechanics", "sensors", "timing", "environment", "noise"]
"""What a cause is a change of."""


@dataclass(frozen=True)
class HeldOut:
    """Gain on held-out runs, which chose neither the cause nor its size."""

    runs: tuple[str, ...]
    gain: tuple[float, ...]
    """Fall of -2 log predictive density of each run; positive where the cause predicts the run better."""


@dataclass(frozen=True)
class ChangedCause:
    """One change that accounts for the difference, alone or with others."""

    effect: str
    kind: Kind
    joint: int | None
    """1-based; of a payload the link it sits on; None for the whole rig."""
    sentence: str
    size: tuple[SizeEstimate, ...]
    p_value: float
    """Over all candidates tried."""


@dataclass(frozen=True)
class LevelChange:
    """Level of one column's noise or free-run error in the test runs over that in the reference runs."""

    column: str
    ratio: float
    ci95: tuple[float, float]
    p_value: float
    """Over all columns."""


@dataclass(frozen=True)
class Detectable:
    """Smallest change of one effect that these runs would have shown."""

    effect: str
    joint: int | None
    name: str
    unit: str
    size: float
    """Infinite where no run shows it. Found with probability 0.8 at the level of the verdict."""
    change: float
    """What these runs estimate of it, all else unchanged."""
    ci95: tuple[float, float]
    p_value: float
    """Of this candidate alone, corrected for all candidates tried."""


@dataclass(frozen=True)
class Change:
    """The whole answer."""

    verdict: ChangeVerdict
    sentence: str
    causes: tuple[ChangedCause, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    held_out: HeldOut | None = None
    noise: tuple[LevelChange, ...] = ()
    """Of every column whose samples show their noise."""
    structure: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of unexplained structure: common to a session's runs, and of each run, drifts aside. Their
    unit is the standard deviation of an effect's size estimated from one run."""
    p_any: float = 1.0
    """Probability of the strongest candidate under no change, over all candidates tried."""
    free_runs: LevelChange | None = None
    """Likeliest rise of a free-run error over that of left-out runs; asked where no listed change is significant, None
    where none rose."""
    not_testable: tuple[tuple[str, str], ...] = ()
    """(effect, why)"""
    reference: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    wall_s: float = 0.0
