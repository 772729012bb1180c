"""`with_changed_law`: a comparison of sessions joined with what the laws of position loops say has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from estimator.change.groups import kind_of
from estimator.change.result import Change, ChangedCause
from estimator.effects import named
from estimator.loops import LawChange
from estimator.model import Mechanism
from estimator.verdicts import ChangeVerdict


def with_changed_law(found: Change, changes: Sequence[LawChange], mechanism: Mechanism, volts: float) -> Change:
    """`found`, whose test runs are corrected for `changes`, with these as causes; `volts` is what a duty of 1 is."""
    if not changes or found.verdict == "fit_failed":
        return found
    causes = tuple(_cause(change, mechanism, volts) for change in changes)
    words = "; ".join(f"{cause.sentence} ({', '.join(f'{s.name} {s.value:+.3g} {s.unit}' for s in cause.size)})"
                      for cause in causes)
    alone = found.verdict == "no_change"
    sentence = f"Changed, by the law of the loop alone: {words}." + ("" if alone else f" {found.sentence}")
    verdict: ChangeVerdict = "named" if found.verdict in ("no_change", "named") else "partial"
    rivals = [name for change in changes for name in change.cause.rivals]
    if alone and rivals:
        verdict = "one_of"
        causes += tuple(replace(causes[0], effect=name, sentence=named(name).sentence, size=()) for name in rivals)
    own = {cause.effect for cause in causes}
    return replace(found, verdict=verdict, sentence=sentence, p_any=min(found.p_any, causes[0].p_value),
                   causes=(*causes, *(cause for cause in found.causes if cause.effect not in own)))


def _cause(change: LawChange, mechanism: Mechanism, volts: float) -> ChangedCause:
    effect, *_, sizes = change.cause.told(mechanism, volts)
    return ChangedCause(effect.name, kind_of(type(effect)), effect.joint_number, effect.sentence, sizes,
                        change.cause.p_value)
