"""An investigation: experiments, what was believed after each, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from estimator.diagnosis import Diagnosis
from experiments.judge.next_steps import next_step

Ending = Literal["settled", "exhausted", "budget", "declined", "stopped", "failed"]


@dataclass(frozen=True)
class Experiment:
    """One recording, or one that was asked for."""

    run: str
    """File name."""
    kind: str
    """first | large | small | ramps | ... (kinds of `legid excite --session`) | separate"""
    why: str
    seconds: float
    """Length of the plan."""
    peak_nm: float
    expected: tuple[tuple[str, float], ...] = ()
    """Pairs of rivals, `A or B`, and the log likelihood ratio that this run is expected to give between them."""
    ended: str = ""
    """Why it ended early; empty for a whole run."""


@dataclass(frozen=True)
class Step:
    """Experiments, and the diagnosis of all runs after them."""

    experiments: tuple[Experiment, ...]
    found: Diagnosis | None
    """None where the investigation ended before it."""
    wall_s: float
    """Since the start of the investigation."""


@dataclass(frozen=True)
class Investigation:
    """Steps in their order, and how they ended."""

    steps: tuple[Step, ...]
    ending: Ending | None
    """settled: one cause stands, or nothing material is left; exhausted: a further run would not change the answer;
    budget, declined (by a person), stopped (by Ctrl-C), failed (a recording); None while it runs."""
    why: str
    """The reason for the end, one sentence."""
    budget_s: float
    wall_s: float

    @property
    def found(self) -> Diagnosis | None:
        """The last diagnosis."""
        return next((step.found for step in reversed(self.steps) if step.found is not None), None)

    @property
    def runs(self) -> tuple[str, ...]:
        """File names of all runs that were recorded, in their order."""
        return tuple(one.run for step in self.steps for one in step.experiments)

    @property
    def diagnosed(self) -> tuple[str, ...]:
        """File names of the runs that the last diagnosis had."""
        last = max((k for k, step in enumerate(self.steps) if step.found is not None), default=-1)
        return tuple(one.run for step in self.steps[: last + 1] for one in step.experiments)

    @property
    def next_step(self) -> str:
        """One line."""
        if self.found is None:
            return "Record by hand: legid record --rig RIG --plan PLAN --out RUN.mcap"
        if len(self.runs) > len(self.diagnosed):
            return "Diagnose with the runs that the answer lacks: legid diagnose RUN... --rig RIG"
        if self.ending == "exhausted" and self.found.next_experiment:
            return self.found.next_experiment
        if self.ending in ("budget", "declined", "stopped") and self.found.verdict not in ("none", "named"):
            return "Go on with a larger budget: legid investigate --rig RIG --budget MINUTES --out DIR"
        return next_step(self.found)
