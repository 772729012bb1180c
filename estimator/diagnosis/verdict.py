"""`decide`: the verdict on what the train runs chose, by its errors on test runs.

It fits nothing, simulates nothing and draws nothing: it is a function of a table and of which model is in which row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from estimator.diagnosis.decision_rule import EDGE, SUFFICES, SURE
from estimator.diagnosis.error_table import NOMINAL, ErrorTable
from estimator.diagnosis.explanation import (
    LEAST_APART,
    Explanation,
    indistinguishable_set,
    margin,
    nested,
    set_apart,
)
from estimator.verdicts import Verdict

GENERIC_ALONE = "generic terms reduce the error, but it does not"
GENERIC_MORE = "generic terms reduce the error more than it does"
HALF = "it explains less than half of the error"
IMITATES = "one further effect or generic term explains more of the readings than it does"
NOT_PRESENT = "a defining size is not significant, or has an impossible sign"
UNCHANGED = "it does not reduce the free-run error of the held-out runs"
WITHIN = "the tolerances of the rig hold its size, and it leaves more than noise"
UNSURE = ("it reduces the free-run error of the held-out runs, but not significantly, or not on every run, or without "
          "a larger likelihood")


@dataclass(frozen=True)
class Answer:
    """An explanation that the train runs chose, and the rows of its models."""

    best: tuple[Explanation, ...]
    """With those that cannot be told apart from it, the likeliest first"""
    row: int
    """Of the first"""
    without: tuple[int, ...]
    """Of the first without each of its effects, where it has several"""
    with_generic: int
    """Of the first with generic terms; its own where none is significant"""
    imitates: bool = False
    """Whether one further effect or generic term explains more of the readings than it does"""


@dataclass(frozen=True)
class Hidden:
    """A model whose noise may hide motion, and the same with the noise that its sensors are known to have."""

    row: int
    declared: int | None
    """Row of the second; None where it cannot be fitted"""
    text: str
    """The sensor in words"""
    stated: bool
    """Whether the rig declares that noise; what neighbouring samples show is no more than a guess."""


@dataclass(frozen=True)
class Family:
    """Findings of a search, by rows of a table whose first is the nominal model."""

    own: int
    """Of the nominal model with generic terms; NOMINAL where none is significant"""
    answer: Answer | None = None
    """None where no set of effects is admissible"""
    second: Answer | None = None
    """One effect more, which lowers the error of the train runs by a material amount, too"""
    minor: tuple[Explanation, int] | None = None
    """One effect more, which only the readings show, and its row"""
    rivals: tuple[tuple[Explanation, int], ...] = ()
    """Other admissible sets of as many effects as an answer has"""
    closest: Explanation | None = None
    """Where there is no answer: the likeliest set, whose effects are not all present"""
    hidden: tuple[Hidden, ...] = ()
    dominated: str = ""
    """Why nothing found does not mean that nothing is wrong; empty where it does"""

    @property
    def core(self) -> tuple[int, ...]:
        """Rows without which no verdict can be passed, in rising order: not those of rivals and of a minor cause."""
        answers = [a for a in (self.answer, self.second) if a is not None]
        rows = {NOMINAL, self.own, *(r for a in answers for r in (a.row, a.with_generic, *a.without))}
        return tuple(sorted(rows | {r for h in self.hidden for r in (h.row, h.declared) if r is not None}))


Terms = Literal["", "nominal", "answer"]


@dataclass(frozen=True)
class Decision:
    """The verdict and what it rests on."""

    verdict: Verdict
    """Not `one_of`, which `named` becomes with several `best`."""
    answer: Answer | None = None
    """Accepted; for `unexplained` the closest, for `none` a present but small one"""
    why: str = ""
    """Why the closest explanation is not accepted"""
    terms: Terms = ""
    """Whose generic terms tell where the residual is: those with the nominal model, or those with the answer"""
    refused: bool = False
    """Whether a name was refused: no probability is stated of such an answer"""
    open: bool = False
    """Whether these runs leave it open, so that every run should be a test run once"""
    minor: Explanation | None = None
    """The answer with an effect that each test run shows, too"""
    within: bool = False
    """Whether the answer is no fault: the tolerances of the rig hold all its sizes"""

    @property
    def best(self) -> Explanation | None:
        """The first of the accepted explanations."""
        return None if self.answer is None else self.answer.best[0]

    def same_as(self, other: Decision) -> bool:
        """Whether the other states the same: `partial` states that its causes are present, as `named` does."""
        alike = ("named", "partial") if self.verdict == "partial" else (self.verdict,)
        return other.verdict in alike and _keys(self.answer) == _keys(other.answer)


def _keys(answer: Answer | None) -> frozenset[str]:
    return frozenset() if answer is None else answer.best[0].keys


def decide(table: ErrorTable, family: Family, material: float) -> Decision:
    """The verdict by the errors in `table`; `material` is the least relative reduction that counts."""
    decision = excused(table, _decide(table, family, material))
    if decision.verdict != "none" or decision.within:
        return decision
    row = NOMINAL if decision.answer is None else decision.answer.row
    hidden = next((h for h in family.hidden if h.row == row), None)
    why = ""
    if hidden is not None and hides(table, hidden, material):
        why = hidden.text
    elif family.answer is None and family.dominated:
        why = family.dominated
    return replace(decision, verdict="unexplained", why=why, refused=True) if why else decision


def excused(table: ErrorTable, found: Decision) -> Decision:
    """`found`, or no fault where the tolerances of the rig hold the sizes of all that it names, and leave no more than
    noise may."""
    if found.answer is None or found.verdict not in ("named", "partial") or found.answer.best[0].beyond:
        return found
    if table.error(found.answer.row) <= EDGE:
        return Decision("none", found.answer, within=True)
    return Decision("unexplained", found.answer, WITHIN, found.terms, refused=True, open=found.open)


def _decide(table: ErrorTable, family: Family, material: float) -> Decision:
    answer = family.answer
    if answer is None:
        return without_answer(table, family, material)
    found = judge(table, family, answer, material)
    # a large residual must show on all runs, not on these alone
    unsure = found.verdict == "partial" or (found.verdict != "named"
                                            and is_open(table, answer.row, NOMINAL, material))
    second = family.second
    if found.verdict == "named" and second is not None:
        unsure = unsure or is_open(table, second.row, answer.row, material)
        if is_material(table, second.row, answer.row, material):
            both = judge(table, family, second, material)
            found = both if both.verdict in ("named", "partial") else found
    if family.minor is not None and found.answer is answer and found.verdict in ("named", "partial"):
        minor, row = family.minor
        gains = table.agreement[row] - table.agreement[answer.row]
        if np.all(gains[np.isfinite(gains)] > 0.0):  # of the runs on which it was simulated
            found = replace(found, minor=minor)
    return replace(found, open=unsure)


def without_answer(table: ErrorTable, family: Family, material: float) -> Decision:
    """The verdict where no listed effect is an answer."""
    whole = table.error(NOMINAL)
    structure = is_material(table, family.own, NOMINAL, material)
    terms: Terms = "nominal" if structure else ""
    if whole <= EDGE:
        return Decision("none", terms=terms)
    why = f"the free-run error is {whole:.1f} times that of noise alone" if family.closest is None else NOT_PRESENT
    return Decision("unexplained", why=why, terms="nominal" if family.own else "", open=True)


def judge(table: ErrorTable, family: Family, answer: Answer, material: float) -> Decision:
    """The verdict on one answer."""
    row, more, own = answer.row, answer.with_generic, family.own
    whole = table.error(NOMINAL)
    structure = is_material(table, own, NOMINAL, material)
    terms: Terms = "nominal" if structure else ""
    enough = suffices(table, row)
    if not (enough or is_material(table, row, NOMINAL, material)):
        if whole > EDGE:
            return Decision("unexplained", answer, GENERIC_ALONE if structure else shortfall(table, row, material),
                            terms)
        small = table.lowers(row, NOMINAL, 0.0, NOMINAL) >= SURE and bool(np.all(table.agreement[row] > 0.0))
        return Decision("none", answer if small else None, terms=terms)
    left = table.error(row) - min(table.error(more), table.error(own) if own else np.inf)
    why = ""
    if (whole - table.error(row)) < SUFFICES * (whole - table.error(row) + max(left, 0.0)):
        why = GENERIC_MORE
    elif table.error(row) > 1.0 + material and table.excess(row) > SUFFICES * table.excess(NOMINAL):
        why = HALF
    elif answer.imitates:
        why = IMITATES
    if why and not enough:
        if whole > EDGE:
            return Decision("unexplained", answer, why, terms, refused=True)
        return Decision("none", terms=terms, refused=True)
    if whole <= EDGE and not all(is_material(table, row, k, material) for k in answer.without):
        return Decision("none", answer, terms=terms)  # several faults, not each of which is material alone
    beyond = table.error(row) > max(EDGE, 1.0 + material * whole)
    partial = beyond or is_material(table, more, row, material, NOMINAL)  # of the whole
    return Decision("partial" if partial else "named", answer, terms="answer" if partial else "")


def suffices(table: ErrorTable, row: int) -> bool:
    """Whether a model explains nearly all of an error that is large, and leaves no more than noise may: then no other
    rule refuses it."""
    whole = table.error(NOMINAL)
    return (whole > EDGE and table.error(row) <= EDGE
            and table.excess(row) <= (1.0 - SURE) * table.excess(NOMINAL))


def hides(table: ErrorTable, hidden: Hidden, material: float) -> bool:
    """Whether a sensor that is noisier than it is known to be hides motion.

    It does if the model with the known noise predicts materially better, or, where the rig declares it, worse. A model
    that cannot be fitted with a declared noise hides motion, too.
    """
    if hidden.declared is None:
        return hidden.stated
    better, worse = (hidden.declared, hidden.row), (hidden.row, hidden.declared)
    asked = (better, worse) if hidden.stated else (better,)
    return max(table.lowers(a, b, material, b) for a, b in asked) >= SURE


def choose(possible: Sequence[tuple[Explanation, int]], table: ErrorTable, material: float
           ) -> tuple[list[Explanation], int]:
    """The smallest set of effects that no larger set improves by a material amount, with its equivalents, and its row.

    A larger set is compared with the best smaller one. If no improvement is significant, the errors decide.
    """
    counts = sorted({len(o.model.effects) for o, _ in possible})

    def surely(k: int, row: int) -> bool:
        return is_material(table, k, row, material)

    def likely(k: int, row: int) -> bool:
        return table.falls(k, row, material)

    for better in (surely, likely):
        best: list[Explanation] = []
        row = NOMINAL
        for count in counts:
            found, k = likeliest([(o, k) for o, k in possible if len(o.model.effects) == count], table, material, row)
            if better(k, row):
                best, row = found, k
        if best:
            return best, row
    return likeliest([(o, k) for o, k in possible if len(o.model.effects) == counts[0]], table, material, NOMINAL)


def likeliest(among: Sequence[tuple[Explanation, int]], table: ErrorTable, material: float, than: int
              ) -> tuple[list[Explanation], int]:
    """The likeliest of those that do not surely err materially more than the best, with its equivalents, and its row.

    Material is a share of the error of the model `than`.
    """
    lowest = min((k for _, k in among), key=table.error)
    best = indistinguishable_set([o for o, k in among if table.lowers(lowest, k, material, than) < SURE])
    return best, next(k for o, k in among if o is best[0])


def is_material(table: ErrorTable, model: int, than: int, material: float, of: int | None = None) -> bool:
    """Whether error(than) - error(model) > material * error(of), significantly; `of` is by default `than`.

    In addition no run's error may rise by as much, and the runs together must be likelier with `model`.
    """
    of = than if of is None else of
    if model == than or not table.falls(model, than, material, of) or table.raises(model, than, material, of):
        return False
    return table.lowers(model, than, material, of) >= SURE and table.likelier(model, than)


def is_open(table: ErrorTable, model: int, than: int, material: float) -> bool:
    """Whether it is inconclusive that `model` reduces the error of `than` by a material amount.

    The runs must be likelier with `model`.
    """
    return table.lowers(model, than, material, than) > 1.0 - SURE and table.likelier(model, than)


def shortfall(table: ErrorTable, model: int, material: float) -> str:
    """Why `model` is not material: the error does not fall by `material`, or not significantly."""
    return UNSURE if table.falls(model, NOMINAL, material) else UNCHANGED


def probability_of(decision: Decision, table: ErrorTable, family: Family, first: ErrorTable, material: float
                   ) -> float | None:
    """Probability (0 to 1) that the answer is true if its causes are among the effects that were tried.

    It is that the stated causes are exactly those present; for `one_of` that one of the sets is; for `partial` that the
    listed causes are present; for `none` that nothing material is. None for `unexplained`, which names no cause.

        P = mean_d 1{V(d) = V} * mean_d [sum_A w_s(d) / sum_s w_s(d)]
        w_s(d) = 1{E_s(d) <= min_t E_t(d) + m E_0(d)} exp(-(G - G_s) / (2 T_s)),  T_s = 1 + L_s / L_0

    d is a resampling of the blocks of `table`, V(d) what is decided on it; in the second factor of those of the `first`
    test runs. E_s(d) is the free-run error of the set s, 0 the nominal model and m the material
    share. A has the stated sets, and s counts all sets of as many effects. G_s is their gain, G the largest. T_s
    tempers the likelihood by what both models have wrong: L_s is the `margin` of s and L_0 LEAST_APART. So a set at the
    limit of a tie has the odds (1 - SURE) / SURE. For `none` the second factor is mean_d 1{min_s E_s(d) >= (1 - m)
    E_0(d)} over all sets s.
    """
    if decision.refused or decision.verdict not in ("none", "named", "partial"):
        return None
    same = np.mean([decision.same_as(decide(table.resampled(d), family, material)) for d in range(len(table.draws))])
    if decision.answer is None or (decision.verdict == "none" and not decision.within):
        return float(same) * share_without_cause(first, family, material)
    return float(same) * share_of_stated(first, decision.answer, family.rivals, material)


def share_of_stated(table: ErrorTable, stated: Answer, rivals: Sequence[tuple[Explanation, int]], material: float
                    ) -> float:
    """Share of the stated sets in the weights w_s(d) of `probability_of`, a mean over the resamplings.

    A set that is a stated one with another size of zero, as a spring without stiffness is an offset, is no rival.
    """
    keys = {e.keys for e in stated.best}
    count = len(stated.best[0].model.effects)
    others = [(e, row) for e, row in rivals if len(e.model.effects) == count and e.keys != stated.best[0].keys
              and (e.keys in keys or set_apart(e) or not any(nested(best, e) for best in stated.best))]
    sets, rows = zip(*[(stated.best[0], stated.row), *others])
    most = max(sets, key=lambda e: e.gain)
    tempered = np.array([1.0 + margin(e, most) / LEAST_APART for e in sets])
    log_odds = np.array([e.gain - most.gain for e in sets]) / (2.0 * tempered)
    own = np.array([e.keys in keys for e in sets])
    shares, nominal = [], table.errors(NOMINAL, table.draws)
    for errors, whole in zip(np.stack([table.errors(row, table.draws) for row in rows], axis=1), nominal):
        near = errors <= errors.min() + material * whole
        weights = np.exp(np.where(near, log_odds - log_odds[near].max(), -np.inf))
        shares.append(weights[own].sum() / weights.sum())
    return float(np.mean(shares))


def share_without_cause(table: ErrorTable, family: Family, material: float) -> float:
    """Share of the resamplings in which no set reduces the error by a material amount."""
    least = (1.0 - material) * table.errors(NOMINAL, table.draws)
    rows = [row for _, row in family.rivals] + ([] if family.answer is None else [family.answer.row])
    stays = [table.errors(row, table.draws) >= least for row in rows]
    return float(np.mean(np.all([np.ones(least.shape, bool), *stays], axis=0)))
