"""`legid.watch/1`: runs tested one after the other, as `legid watch --json` writes them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Annotated, Literal, Self

from msgspec import UNSET, Meta, Struct

from estimator.change import Block as FoundBlock
from estimator.change import Change
from estimator.change import WatchedRun as FoundRun
from experiments.documents.change import ChangeDocument
from experiments.documents.document import Document, From
from experiments.judge import Headline
from experiments.provenance import Source

State = Literal["ok", "alarm", "changed", "not tested"]


class Block(Struct, frozen=True, kw_only=True):
    """The test at the end of one block of motion."""

    end_s: Annotated[float, Meta(description="its end, from the run's first sample [s]")]
    seconds: Annotated[float, Meta(description="its motion [s]")]
    per_hour: Annotated[float, Meta(description="false alarms per hour of a threshold that it just reaches")]
    effect: Annotated[str, Meta(description="the likeliest change")]
    joint: Annotated[int | None, Meta(description="from 1; of a payload its link; or null")]
    since_s: Annotated[float, Meta(description="motion from where that change began to the end [s]")]

    @classmethod
    def of(cls, found: FoundBlock) -> Self:
        """The same of the estimator's result."""
        return cls(**vars(found))


class WatchedRun(Struct, frozen=True, kw_only=True):
    """One run, tested."""

    run: Annotated[str, Meta(description="the run")]
    state: Annotated[State, Meta(description="ok, alarm, changed (since an earlier alarm) or not tested")]
    recorded: Annotated[str | None, Meta(description="begin of its recording, UTC; of a native run, or null")] = None
    seconds: Annotated[float, Meta(description="motion that was tested [s]")]
    alarm: Annotated[Block | None, Meta(description="the first block below the threshold, or null")] = None
    blocks: Annotated[tuple[Block, ...], Meta(description="of 5 s, with the same keys")] = ()
    failed: Annotated[str | None, Meta(description="why it was not tested, or null")] = None
    change: Annotated[ChangeDocument | None, Meta(
        description="with two runs after an alarm: the change, as [a diagnosis](#against-earlier-runs)")] = None

    @classmethod
    def of(cls, found: FoundRun, change: Change | None = None, recorded: datetime | None = None) -> Self:
        """The entry of a run whose recording began at `recorded`; `change` is that since the run with an alarm."""
        state: State = ("alarm" if found.alarm is not None else "not tested" if found.failed else
                        "changed" if change is not None and change.verdict != "no_change" else "ok")
        return cls(run=found.run, state=state, recorded=None if recorded is None else recorded.isoformat(),
                   seconds=found.seconds, alarm=None if found.alarm is None else Block.of(found.alarm),
                   blocks=tuple(map(Block.of, found.blocks)), failed=found.failed or None,
                   change=None if change is None else ChangeDocument.of(change))

    @property
    def worst(self) -> Block | None:
        """The alarm, or else the likeliest change."""
        return self.alarm or min(self.blocks, key=lambda b: b.per_hour, default=None)


class Reference(Struct, frozen=True, kw_only=True):
    """Runs that the others are held against."""

    runs: Annotated[tuple[str, ...], Meta(description="their names")]
    sources: Annotated[tuple[dict[str, str], ...], Meta(description="their files: `file`, `sha256`")] = ()


class WatchDocument(Document, kw_only=True):
    """Every run, tested for a change since the reference runs."""

    schema: Annotated[Literal["legid.watch/1"], Meta(description="of this document")] = "legid.watch/1"
    false_alarms_per_hour: Annotated[float, Meta(description="that are allowed")]
    reference: Annotated[Reference, Meta(description="the earlier runs")]
    watched: Annotated[list[WatchedRun], Meta(description="one entry a run, in their order")]
    provenance: From = UNSET

    @classmethod
    def begun(cls, reference: Sequence[str], false_alarms: float, sources: Sequence[Source] = ()) -> Self:
        """The document of no run yet."""
        return cls(false_alarms_per_hour=false_alarms, watched=[], reference=Reference(
            runs=tuple(reference), sources=tuple({"file": s.file, "sha256": s.sha256} for s in sources)))

    @property
    def summary(self) -> str:
        """Sentence over all runs."""
        tested = [one for one in self.watched if not one.failed]
        alarms = [one.run for one in tested if one.alarm is not None]
        hours = sum(one.seconds for one in tested) / 3600.0
        return (f"{len(tested)} runs, {hours:.2g} h of motion, at most {self.false_alarms_per_hour:g} false alarms an "
                f"hour: {f'{len(alarms)} with an alarm, first {alarms[0]}' if alarms else 'no alarm'}")

    @property
    def change(self) -> ChangeDocument | None:
        """The last one that was named."""
        return next((one.change for one in reversed(self.watched) if one.change is not None), None)

    @property
    def headline(self) -> Headline:
        """First lines: whether there is an alarm, over which runs, and what changed."""
        alarm = any(one.alarm for one in self.watched)
        return Headline("bad" if alarm else "good", "The rig changed" if alarm else "No alarm",
                        [self.summary, *([self.change.sentence] if self.change else [])],
                        [f"{one.run} was not tested: {one.failed}" for one in self.watched if one.failed])
