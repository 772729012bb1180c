"""`legid.tuning/1`: entries of a rig file chosen by its records, as `legid tune --json` writes them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, field

from experiments.documents.document import Aside, Damaged, Document, From, Number

What = Literal["rate", "hold", "delay"]


class Entry(Struct, frozen=True, kw_only=True):
    """One entry of rig.toml that the records chose."""

    table: Annotated[str, Meta(description="its table")]
    key: Annotated[str, Meta(description="its key")]
    value: Annotated[Any, Meta(description="its value")]
    why: Annotated[str, Meta(description="what it is for")]
    changes: Annotated[str, Meta(description="what it changes, measured")]


class Time(Struct, frozen=True, kw_only=True):
    """Gain of one of rate, hold and delay, which are varied together."""

    what: Annotated[What, Meta(description="rate, hold or delay")]
    before: Annotated[Any, Meta(description="[Hz], name or [s] in rig.toml")]
    after: Annotated[Any, Meta(description="the same as chosen")]
    gain: Annotated[Number, Meta(description="relative fall of the error against `before`, the others as chosen")]


class Tried(Struct, frozen=True, kw_only=True):
    """One value that was tried."""

    entry: Annotated[str, Meta(description="the entries")]
    value: Annotated[str, Meta(description="their values")]
    error: Annotated[str, Meta(description="error of runs not fitted, by joint")]


Errors = tuple[Number, ...] | None


class TuningDocument(Document, kw_only=True):
    """Entries of a rig file that predict its records best, and what else was tried."""

    schema: Annotated[Literal["legid.tuning/1"], Meta(description="of this document")] = "legid.tuning/1"
    chosen: Annotated[tuple[Entry, ...], Meta(description="one entry an entry of rig.toml")]
    times: Annotated[tuple[Time, ...], Meta(description="empty where no fit predicts")] = ()
    tried: Annotated[tuple[Tried, ...], Meta(description="one entry a value")] = ()
    error_before: Annotated[Errors, Meta(description="rms error of runs not fitted, by joint")] = None
    error_after: Annotated[Errors, Meta(description="the same with what was chosen")] = None
    horizon_s: Annotated[float, Meta(description="over which they predict [s]")]
    flags: Annotated[tuple[str, ...], Meta(description="warnings")] = field(name="doubts", default=())
    set_aside: Aside = ()
    damaged: Damaged = ()
    provenance: From = UNSET

    @property
    def predicts(self) -> bool:
        """Whether any fit to half of the runs predicts the other half; if none does, nothing is chosen."""
        return bool(self.times)
