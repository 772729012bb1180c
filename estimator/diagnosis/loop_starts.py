"""`by_loops_first`: the order in which single effects are fitted, those of position loops in full."""

from __future__ import annotations

from collections.abc import Sequence

from estimator.diagnosis.context import Start
from estimator.diagnosis.model import Model


def is_of_loop(start: Start) -> bool:
    """Whether an effect of a position loop is in a set."""
    return any(effect.per_loop for effect, _ in start)


def by_loops_first(starts: Sequence[tuple[Model, Start]], width: int) -> list[tuple[Model, Start]]:
    """`starts` with those of position loops right after the first `width`: the nominal fit puts what a loop does
    otherwise down to noise, so neither its slope nor the error beyond that noise says how large it is."""
    return [*starts[:width], *sorted(starts[width:], key=lambda start: not is_of_loop(start[1]))]
