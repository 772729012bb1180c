"""Steps that a walker's model predicts, as `walk` of `legid.validation/1`."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from estimator.prediction import WalkAhead
from experiments.documents.document import Number


class Ahead(Struct, frozen=True, kw_only=True):
    """Errors in the last of so many steps."""

    steps: Annotated[int, Meta(description="number of steps; 1 is the step in which the free run begins")]
    pieces: Annotated[int, Meta(description="free runs")]
    fell: Annotated[int, Meta(description="those that had fallen by its end")]
    rmse: Annotated[dict[str, Number], Meta(description="rms error by angle [rad]; null if all fell")]


class Walked(Struct, frozen=True, kw_only=True):
    """One run from its first step on."""

    run: Annotated[str, Meta(description="the run")]
    steps: Annotated[int, Meta(description="steps in it")]
    fell_s: Annotated[float | None, Meta(description="time of the fall [s], or null")]
    fell_in_step: Annotated[int | None, Meta(description="step of the fall, or null")]


class Walk(Struct, frozen=True, kw_only=True):
    """A model's free runs across touchdowns."""

    ahead: Annotated[list[Ahead], Meta(description="by number of steps")]
    runs: Annotated[list[Walked], Meta(description="whole runs")]

    @staticmethod
    def of(ahead: WalkAhead) -> Walk:
        """The same of the estimator's result."""
        return Walk(
            ahead=[Ahead(steps=a.steps, pieces=a.pieces, fell=a.fell,
                         rmse={c: None if np.isnan(x) else float(x) for c, x in zip(ahead.columns, a.rmse)})
                   for a in ahead.ahead],
            runs=[Walked(run=r.run, steps=r.steps, fell_s=r.fell_s, fell_in_step=r.fell_step or None)
                  for r in ahead.whole])
