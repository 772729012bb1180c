"""The verdicts of a diagnosis, and a size of a cause; a separate module, so that listing them loads no mathematics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Verdict = Literal["none", "named", "partial", "one_of", "unexplained", "fit_failed"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
ChangeVerdict = Literal["no_change", "named", "partial", "one_of", "changed_unexplained", "fit_failed"]
"""Of a comparison with earlier runs."""
EVERY_VERDICT: tuple[str, ...] = tuple(dict.fromkeys((*VERDICTS, *get_args(ChangeVerdict))))
CAUSED: tuple[Verdict, ...] = ("named", "partial", "one_of")
"""Those whose causes are present: all of them, or one of them."""


@dataclass(frozen=True)
class SizeEstimate:
    """One size of a cause, or its change, with its 95 % interval."""

    name: str
    unit: str
    value: float
    ci95: tuple[float, float]
