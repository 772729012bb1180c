"""Change of a rig since earlier runs (`legid.diagnosis/1` with `against`), and that between sessions
(`legid.sessions/1`)."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Annotated, Any, Literal, Self

from msgspec import UNSET, Meta, Struct

from daq import Dataset
from estimator import ChangeVerdict
from estimator.change import Change, Kind, LevelChange
from experiments.documents.diagnosis_parts import CauseSize, Interval
from experiments.documents.document import Aside, Damaged, Document, From, Number
from experiments.judge import CHANGES, Headline, next_of_change
from experiments.provenance import Source
from experiments.session import SetAside, damaged_runs

REFERENCE_NAMES = ("the reference runs", "these runs")
Joint = Annotated[int | None, Meta(description="from 1; of a payload its link; null for the whole rig")]


class Cause(Struct, frozen=True, kw_only=True):
    """One change that accounts for the difference, alone or with others."""

    effect: Annotated[str, Meta(description="of the library, `parameter`, `payload` or `links` (all rigid parameters)")]
    kind: Annotated[Kind, Meta(description="a change of parameters, mechanics, sensors, timing, environment or noise")]
    joint: Joint
    meaning: Annotated[str, Meta(description="in words")]
    p_value: Annotated[float, Meta(description="over all candidates tried")]
    size: Annotated[tuple[CauseSize, ...], Meta(description="one entry a size")]
    confusable_with: Annotated[tuple[str, ...], Meta(description="empty")] = ()


class Candidate(Struct, frozen=True, kw_only=True):
    """One effect that was tried."""

    effect: Annotated[str, Meta(description="the effect")]
    joint: Joint
    size_name: Annotated[str, Meta(description="the size, or parameter")]
    p_value: Annotated[float, Meta(description="corrected for all candidates tried")]
    change: Annotated[float, Meta(description="the estimate, all else unchanged")]
    ci95: Annotated[tuple[Number, Number] | None, Meta(description="its 95 % interval; null where no run shows it")]
    smallest_detectable: Annotated[Number, Meta(description="change found with probability 0.8; null: none")]
    unit: Annotated[str, Meta(description="of the three")]


class Level(Struct, frozen=True, kw_only=True):
    """Level of a column in the later runs over that in the earlier ones."""

    column: Annotated[str, Meta(description="the column")]
    ratio: Annotated[float, Meta(description="later over earlier, B / A")]
    ci95: Interval
    p_value: Annotated[float, Meta(description="over all columns")]

    @classmethod
    def of(cls, change: LevelChange) -> Self:
        """The same of the estimator's result."""
        return cls(column=change.column, ratio=change.ratio, ci95=change.ci95, p_value=change.p_value)


class HeldOut(Struct, frozen=True, kw_only=True):
    """Gain of the change on runs that it was not fitted to."""

    runs: Annotated[tuple[str, ...], Meta(description="later runs, each left out once")]
    gain: Annotated[tuple[Number, ...], Meta(description="fall of -2 log predictive density of each")]


class Untestable(Struct, frozen=True, kw_only=True):
    """One effect that these runs cannot show."""

    effect: Annotated[str, Meta(description="the effect")]
    joint: Joint
    why: Annotated[str, Meta(description="the reason")]


class Session(Struct, frozen=True, kw_only=True):
    """Runs that are held against others."""

    name: Annotated[str, Meta(description="its name")]
    runs: Annotated[tuple[str, ...], Meta(description="its runs")]


class Answer(Document, kw_only=True):
    """Difference, and the smallest ones that would have shown."""

    verdict: Annotated[ChangeVerdict, Meta(
        description="no_change, named, partial, one_of, changed_unexplained or fit_failed")]
    sentence: Annotated[str, Meta(description="the first line")]
    causes: Annotated[tuple[Cause, ...], Meta(description="one entry a cause")] = ()
    candidates: Annotated[tuple[Candidate, ...], Meta(description="the likeliest first")] = ()
    noise: Annotated[tuple[Level, ...], Meta(description="noise by column")] = ()
    free_runs: Annotated[Level | None, Meta(description="likeliest rise of a free-run error, or null")] = None
    held_out: Annotated[HeldOut | None, Meta(description="on runs left out, or null")] = None
    not_testable: Annotated[tuple[Untestable, ...], Meta(description="effects that these runs cannot show")] = ()
    warnings: Annotated[tuple[str, ...], Meta(description="to be read with it")] = ()
    next_step: Annotated[str, Meta(description="what to do, and the command")] = ""
    wall_s: Annotated[float, Meta(description="time that it took [s]")] = 0.0

    @classmethod
    def made(cls, change: Change, **more: Any) -> Self:
        """The answer of the estimator, with the keys `more`."""
        return cls(
            verdict=change.verdict, sentence=change.sentence, **more,
            causes=tuple(Cause(effect=c.effect, kind=c.kind, joint=c.joint, meaning=c.sentence, p_value=c.p_value,
                               size=tuple(CauseSize(name=s.name, unit=s.unit, value=s.value, ci95=s.ci95)
                                          for s in c.size))
                         for c in change.causes),
            candidates=tuple(Candidate(
                effect=d.effect, joint=d.joint, size_name=d.name, p_value=d.p_value, change=d.change, unit=d.unit,
                ci95=d.ci95 if isfinite(d.size) else None, smallest_detectable=d.size if isfinite(d.size) else None)
                for d in change.detectable),
            noise=tuple(map(Level.of, change.noise)),
            free_runs=None if change.free_runs is None else Level.of(change.free_runs),
            held_out=None if change.held_out is None else HeldOut(runs=change.held_out.runs, gain=change.held_out.gain),
            not_testable=tuple(Untestable(effect=effect, joint=int(joint) if joint else None, why=why)
                               for key, why in change.not_testable for effect, _, joint in [key.partition("@")]),
            warnings=change.warnings, next_step=next_of_change(change), wall_s=change.wall_s)

    @property
    def headline(self) -> Headline:
        """First lines: the verdict and its sentence."""
        return Headline(*CHANGES[self.verdict], [self.sentence], self.warnings, self.next_step)


Structure = Annotated[tuple[float, float], Meta(description="unexplained structure, in standard deviations of a size "
                                                "estimated from one run: common to a session's runs, and of each run")]
AnyChance = Annotated[float, Meta(description="of the strongest candidate under no change, over all tried")]


class Against(Struct, frozen=True, kw_only=True):
    """The earlier runs."""

    runs: Annotated[tuple[str, ...], Meta(description="the reference runs")]
    structure: Structure = (0.0, 0.0)
    p_any: AnyChance = 1.0
    sources: Annotated[tuple[dict[str, str], ...], Meta(description="their files: `file`, `sha256`")] = ()


class ChangeDocument(Answer, kw_only=True):
    """Change since earlier runs of a rig. Sizes are changes."""

    schema: Annotated[Literal["legid.diagnosis/1"], Meta(description="of this document")] = "legid.diagnosis/1"
    against: Annotated[Against, Meta(description="the earlier runs")]
    runs: Annotated[dict[str, tuple[str, ...]], Meta(description="`test`: the later runs")]
    set_aside: Aside = ()
    damaged: Damaged = ()
    provenance: From = UNSET

    @classmethod
    def of(cls, change: Change, set_aside: Sequence[SetAside] = (), sources: Sequence[Source] = (),
           runs: Sequence[Dataset] = ()) -> Self:
        """The document of a change since the runs of the files `sources`; `runs` are all that are used."""
        return cls.made(change, set_aside=tuple(set_aside), damaged=tuple(damaged_runs(runs)),
                        runs={"test": change.test},
                        against=Against(runs=change.reference, structure=change.structure, p_any=change.p_any,
                                        sources=tuple({"file": s.file, "sha256": s.sha256} for s in sources)))

    @property
    def pairs(self) -> tuple[ChangeDocument]:
        """Itself, the only pair."""
        return (self,)

    @property
    def sides(self) -> tuple[Session, Session]:
        """Earlier and later runs."""
        names = zip(REFERENCE_NAMES, (self.against.runs, self.runs["test"]))
        first, second = (Session(name=name, runs=runs) for name, runs in names)
        return first, second

    @property
    def structure(self) -> tuple[float, float]:
        """Unexplained structure of the reference."""
        return self.against.structure


class Pair(Answer, kw_only=True):
    """Difference between two sessions. Sizes are those of B less those of A."""

    a: Annotated[Session, Meta(description="session A")]
    b: Annotated[Session, Meta(description="session B")]
    structure: Structure = (0.0, 0.0)
    p_any: AnyChance = 1.0

    @classmethod
    def of(cls, change: Change, names: tuple[str, str]) -> Self:
        """The entry of two sessions that are called `names`."""
        return cls.made(change, a=Session(name=names[0], runs=change.reference),
                        b=Session(name=names[1], runs=change.test), structure=change.structure, p_any=change.p_any)

    @property
    def sides(self) -> tuple[Session, Session]:
        """A and B."""
        return self.a, self.b


Differing = ChangeDocument | Pair


class SessionsDocument(Document, kw_only=True):
    """Differences of sessions of a rig from the first of them."""

    schema: Annotated[Literal["legid.sessions/1"], Meta(description="of this document")] = "legid.sessions/1"
    set_aside: Aside = ()
    pairs: Annotated[tuple[Pair, ...], Meta(description="the first session with each other one")]
    damaged: Damaged = ()
    provenance: From = UNSET

    @classmethod
    def of(cls, pairs: Sequence[Pair], set_aside: Sequence[SetAside] = (), runs: Sequence[Dataset] = ()) -> Self:
        """The document of `pairs`; `runs` are all that are used."""
        return cls(pairs=tuple(pairs), set_aside=tuple(dict.fromkeys(set_aside)), damaged=tuple(damaged_runs(runs)))

    @property
    def worst(self) -> Pair:
        """The pair that differs most."""
        return max(self.pairs, key=lambda pair: list(CHANGES).index(pair.verdict))

    @property
    def headline(self) -> Headline:
        """First lines: the gravest verdict, and the sentence of each pair."""
        lines = [pair.sentence if len(self.pairs) == 1 else f"{pair.b.name} against {pair.a.name}: {pair.sentence}"
                 for pair in self.pairs]
        warnings = dict.fromkeys(text for pair in self.pairs for text in pair.warnings)
        return Headline(*CHANGES[self.worst.verdict], lines, list(warnings), self.worst.next_step)
