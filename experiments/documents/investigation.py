"""`legid.investigation/1`: the journal of an investigation, as `legid investigate` writes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from msgspec import UNSET, Meta, Struct

from estimator import Verdict
from estimator.diagnosis import Diagnosis
from experiments.documents.diagnosis_parts import Before, Named, contract_joint, split_key
from experiments.documents.document import Document, From, Number
from experiments.judge import VERDICTS, Ending, Headline, Investigation, verdict_title
from experiments.judge import Experiment as FoundExperiment
from experiments.judge import Step as FoundStep


class Explanation(Struct, frozen=True, kw_only=True):
    """One explanation that was compared."""

    explanation: Annotated[str, Meta(description="its effects")]
    error: Annotated[Number, Meta(description="held-out error; null if diverged")]


class Belief(Struct, frozen=True, kw_only=True):
    """Answer of one diagnosis."""

    verdict: Annotated[Verdict, Meta(description="as of a diagnosis")]
    sentence: Annotated[str, Meta(description="the answer")]
    causes: Annotated[tuple[Named, ...], Meta(description="one entry a cause")]
    error: Annotated[Before | None, Meta(description="held-out error in units of noise alone, or null")]
    compared: Annotated[tuple[Explanation, ...], Meta(description="the likeliest first")]
    warnings: Annotated[tuple[str, ...], Meta(description="of the diagnosis")] = ()

    @classmethod
    def of(cls, found: Diagnosis | None) -> Self | None:
        """The answer of a diagnosis, if there is one."""
        if found is None:
            return None
        return cls(verdict=found.verdict, sentence=found.sentence, warnings=tuple(found.warnings),
                   causes=tuple(Named(effect=c.effect, joint=contract_joint(c.effect, c.joint))
                                for c in found.causes),
                   error=None if found.error is None else Before(before=found.error[0], after=found.error[1]),
                   compared=tuple(Explanation(explanation=explanation(keys),
                                              error=float(error) if np.isfinite(error) else None)
                                  for keys, error in found.compared))


class Expected(Struct, frozen=True, kw_only=True):
    """Evidence that a run is expected to give between two rivals."""

    pair: Annotated[str, Meta(description="the rivals, `A or B`")]
    log_likelihood_ratio: Annotated[Number, Meta(description="expected between them")]


class Experiment(Struct, frozen=True, kw_only=True):
    """One recording."""

    run: Annotated[str, Meta(description="its file")]
    kind: Annotated[str, Meta(description="of motion; `separate`: rivals")]
    why: Annotated[str, Meta(description="the reason for it")]
    seconds: Annotated[float, Meta(description="length of the plan [s]")]
    peak_nm: Annotated[float, Meta(description="largest torque [N m]")]
    ended: Annotated[str | None, Meta(description="why it ended early, or null")] = None
    expected: Annotated[tuple[Expected, ...], Meta(description="one entry a pair of rivals")] = ()

    @classmethod
    def of(cls, one: FoundExperiment) -> Self:
        """The entry of a recording."""
        return cls(run=one.run, kind=one.kind, why=one.why, seconds=one.seconds, peak_nm=one.peak_nm,
                   ended=one.ended or None, expected=tuple(
                       Expected(pair=pair, log_likelihood_ratio=value) for pair, value in one.expected))


class Step(Struct, frozen=True, kw_only=True):
    """Experiments, and the diagnosis of all runs after them."""

    before: Annotated[Belief | None, Meta(description="answer before them, or null")]
    after: Annotated[Belief | None, Meta(description="answer after them, or null")]
    wall_s: Annotated[float, Meta(description="since the start [s]")]
    experiments: Annotated[tuple[Experiment, ...], Meta(description="one entry a recording")]

    @classmethod
    def of(cls, step: FoundStep, before: Diagnosis | None = None) -> Self:
        """The entry of a step that came after the diagnosis `before`."""
        return cls(before=Belief.of(before), after=Belief.of(step.found), wall_s=step.wall_s,
                   experiments=tuple(map(Experiment.of, step.experiments)))


class InvestigationDocument(Document, kw_only=True):
    """Recordings and diagnoses of a rig, step by step, and how they ended."""

    schema: Annotated[Literal["legid.investigation/1"], Meta(description="of this document")] = "legid.investigation/1"
    ending: Annotated[Ending | None, Meta(
        description="settled, exhausted, budget, declined, stopped or failed; null while it runs")]
    why: Annotated[str, Meta(description="the reason for the end")]
    next_step: Annotated[str, Meta(description="what to do, and the command")]
    answer: Annotated[Belief | None, Meta(description="of the last diagnosis, or null")]
    diagnosed: Annotated[tuple[str, ...], Meta(description="runs that it had")]
    budget_s: Annotated[float, Meta(description="wall time that was given [s]")]
    wall_s: Annotated[float, Meta(description="wall time that was spent [s]")]
    steps: Annotated[tuple[Step, ...], Meta(description="one entry a step")]
    provenance: From = UNSET

    @classmethod
    def of(cls, done: Investigation) -> Self:
        """The document of what is known by now."""
        beliefs = [None, *(step.found for step in done.steps)]
        return cls(ending=done.ending, why=done.why, next_step=done.next_step, answer=Belief.of(done.found),
                   diagnosed=done.diagnosed, budget_s=done.budget_s, wall_s=done.wall_s,
                   steps=tuple(Step.of(step, before) for step, before in zip(done.steps, beliefs)))

    @property
    def headline(self) -> Headline:
        """First lines: the last answer, and why it ended."""
        found = self.answer
        return Headline("bad" if found is None else VERDICTS[found.verdict][0],
                        verdict_title(None if found is None else found.verdict),
                        ["No diagnosis yet." if found is None else found.sentence, self.why],
                        () if found is None else found.warnings, self.next_step)

    @property
    def runs(self) -> tuple[str, ...]:
        """File names of all runs that were recorded, in their order."""
        return tuple(one.run for step in self.steps for one in step.experiments)


def explanation(keys: Sequence[str]) -> str:
    """Effects of one explanation as a text has them."""
    places = [(effect, contract_joint(effect, joint)) for effect, joint in map(split_key, keys)]
    return " with ".join(effect if joint is None else f"{effect}@{joint}" for effect, joint in places)
