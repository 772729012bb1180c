"""`conclude`: the verdict of a comparison by the scores of all candidates, with sizes and held-out gains."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import fdtrc, fdtri, stdtrit

from daq import FloatArray
from estimator.change.contrast import Contrast
from estimator.change.groups import Group
from estimator.change.payload import fieller
from estimator.change.result import Change, ChangedCause, Detectable, HeldOut, LevelChange
from estimator.change.scores import ReferenceFit
from estimator.change.structure import Structure
from estimator.fit_errors import FIT_ERRORS
from estimator.score import ALPHA, HIDDEN, Score
from estimator.verdicts import SizeEstimate

POWER = 0.8
RIVAL = 6.0
"""Fall of -2 log likelihood below which two candidates are not told apart. Each further size must gain as much."""


@dataclass(frozen=True)
class Words:
    """Wording of the answers of a comparison."""

    same: str
    something: str
    changed: str
    one_of: str


AGAINST = Words("No change: the test runs differ from the reference runs by no more than these differ among "
                "themselves.", "Something changed", "Changed", "One of these changed")
SESSIONS = Words("No difference beyond what the runs of one session show.", "Something differs", "Different",
                 "One of these differs")


@dataclass(frozen=True)
class Fold:
    """A run that is predicted by the other runs."""

    run: str
    others: Contrast
    own: Contrast


@dataclass(frozen=True)
class Scored:
    """All candidates on one contrast."""

    groups: tuple[Group, ...]
    contrast: Contrast
    structure: Structure
    pairs: int = 1
    """Comparisons that are made, each over all groups"""

    @property
    def freedom(self) -> float:
        """Degrees of freedom of a size's variance."""
        return self.structure.freedom

    @cached_property
    def gains(self) -> list[float]:
        """Fall of -2 log likelihood by each group."""
        return [group.fit(self.contrast.along(group.basis))[1] for group in self.groups]

    @cached_property
    def worth(self) -> list[float]:
        """Gain of each group less the price of its further sizes."""
        return [gain - RIVAL * (len(group.names) - 1) for gain, group in zip(self.gains, self.groups)]

    @cached_property
    def order(self) -> list[int]:
        """Groups, the likeliest first."""
        return sorted(range(len(self.groups)), key=self.p_value)

    def p_value(self, k: int) -> float:
        width = len(self.groups[k].names)
        return min(1.0, self.pairs * len(self.groups) * float(fdtrc(width, self.freedom, self.gains[k] / width)))


def conclude(fit: ReferenceFit, scored: Scored, folds: Sequence[Fold], noise: tuple[LevelChange, ...], words: Words
             ) -> Change:
    """Verdict, sizes, and the held-out gain by run."""
    groups = scored.groups
    order = scored.order
    best = order[0]
    p_any, tried = scored.p_value(best), {g.effect for g in groups}
    refused = tuple((k, why) for k, why in fit.refused.items() if k not in tried)
    base = Change("no_change", words.same, detectable=_detectable(scored), noise=noise, p_any=p_any,
                  structure=(scored.structure.common**0.5, scored.structure.own**0.5), not_testable=refused)
    if p_any >= ALPHA:
        noisier = tuple(_noise_cause(n) for n in noise if n.p_value < ALPHA)
        return base if not noisier else replace(base, verdict="named", causes=noisier,
                                               sentence=f"{words.changed}: {_words(noisier)}.")
    chosen = likeliest_changes(scored, order)
    held = _held_out(groups, folds, chosen)
    if not replicates(held.gain):
        return replace(base, verdict="changed_unexplained", held_out=held,
                       sentence=f"{words.something}, and no listed cause predicts the held-out runs.")
    causes = tuple(_cause(scored, k, [other for other in chosen if other != k]) for k in chosen)
    rest = _without(scored, chosen)
    if min(map(rest.p_value, range(len(groups)))) < ALPHA:
        return replace(base, verdict="partial", causes=causes, held_out=held,
                       sentence=f"{words.changed}: {_words(causes)}, and something else that these causes leave.")
    rivals = [k for k in order if groups[k].key != groups[chosen[0]].key and is_rival(scored, k, chosen[0])
              ] if len(chosen) == 1 else []
    first = {groups[k].key: k for k in reversed(rivals)}
    if first:
        several = (*causes, *(_cause(scored, k, ()) for k in first.values()))
        return replace(base, verdict="one_of", causes=several, held_out=held,
                       sentence=f"{words.one_of}: {' or '.join(map(_word, several))}. These runs cannot tell which.")
    return replace(base, verdict="named", causes=causes, held_out=held, sentence=f"{words.changed}: {_words(causes)}.")


def with_errors(change: Change, rise: Callable[[], LevelChange | None], words: Words) -> Change:
    """`change`, a verdict `no_change`, with its `rise`, unless free runs err more by it than those left out; with a
    warning where that cannot be asked."""
    try:
        larger = rise()
    except FIT_ERRORS as error:
        return replace(change, warnings=tuple(dict.fromkeys((*change.warnings, str(error)))))
    if larger is None:
        return change
    if change.free_runs is None or larger.p_value < change.free_runs.p_value:
        change = replace(change, free_runs=larger)
    if larger.p_value >= ALPHA or change.verdict != "no_change":
        return change
    low, high = larger.ci95
    return replace(change, verdict="changed_unexplained", sentence=(
        f"{words.something}, and no listed cause explains it: free runs err {larger.ratio:.2g} times [{low:.2g}, "
        f"{high:.2g}] as much in {larger.column} as those of left-out runs of the other session."))


def likeliest_changes(scored: Scored, order: Sequence[int]) -> list[int]:
    """The single change of the largest worth, and a second one where the first leaves something significant that one
    takes up. Of two, each is then the one of the largest worth with the other fitted."""
    chosen = [max(order, key=scored.worth.__getitem__)]
    rest = _without(scored, chosen)
    more = min(range(len(scored.groups)), key=rest.p_value)
    if rest.p_value(more) >= ALPHA or scored.groups[more].key == scored.groups[chosen[0]].key:
        return chosen
    first = _likeliest_with(scored, more)
    return [first, _likeliest_with(scored, first) if first != chosen[0] else more]


def _likeliest_with(scored: Scored, other: int) -> int:
    """The change of the largest worth with the `other` fitted, none of the other's own kind and joint."""
    rest = _without(scored, [other])
    return max((k for k in range(len(scored.groups)) if scored.groups[k].key != scored.groups[other].key),
               key=rest.worth.__getitem__)


def is_rival(scored: Scored, k: int, best: int) -> bool:
    """Whether the runs do not tell change k from the `best`: by worth, or by gain alone unless k holds the best."""
    if scored.worth[k] > scored.worth[best] - RIVAL:
        return True
    a, b = scored.groups[k].basis, scored.groups[best].basis
    holds = np.linalg.matrix_rank(np.hstack([a, b])) == np.linalg.matrix_rank(a)
    return not holds and scored.gains[k] > scored.gains[best] - RIVAL


def _without(scored: Scored, chosen: Sequence[int]) -> Scored:
    """The scores with the `chosen` changes fitted and projected out."""
    one = scored.contrast
    rest = one.without(basis_of(scored.groups, chosen))
    groups = tuple(replace(g, basis=np.zeros_like(g.basis)) if
                   (rest.along(g.basis).scale < HIDDEN**0.5 * one.along(g.basis).scale).all() else g
                   for g in scored.groups)
    return replace(scored, groups=groups, contrast=rest)


def basis_of(groups: Sequence[Group], chosen: Sequence[int]) -> FloatArray:
    """(m, k) of the sizes of all `chosen` changes."""
    return np.unique(np.concatenate([groups[k].basis for k in chosen], axis=1), axis=1)


def _held_out(groups: Sequence[Group], folds: Sequence[Fold], chosen: Sequence[int]) -> HeldOut:
    """Each run as predicted with the change that the other runs give."""
    basis = basis_of(groups, chosen)
    return HeldOut(tuple(fold.run for fold in folds),
                   tuple(fold.own.along(basis).predicted_gain(fold.others.along(basis)) for fold in folds))


def replicates(gains: Sequence[float]) -> bool:
    """Whether the runs together, and more of those that can tell, are predicted better with the change."""
    better, worse = sum(g > RIVAL for g in gains), sum(g < -RIVAL for g in gains)
    return sum(gains) > 0.0 and better >= worse and (better > worse or not better)


def _cause(scored: Scored, k: int, others: Sequence[int]) -> ChangedCause:
    """Sizes of one change, the `others` fitted too, with intervals that include the unexplained structure of the
    runs."""
    group = scored.groups[k]
    added = basis_of(scored.groups, others) if others else np.zeros((len(group.basis), 0))
    own = scored.contrast.measured(group.basis, added)
    values, _ = group.fit(own)
    covariance = group.covariance(own, scored.contrast)
    t = float(stdtrit(scored.freedom, 0.975))
    middle = own.size()  # a body's likeliest sizes may lie at the edge of what a body can have
    half = t * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    half[np.diag(own.information) <= 0.0] = np.inf
    sizes = [SizeEstimate(n, u, float(v), (float(min(m - h, v)), float(max(m + h, v))))
             for n, u, v, m, h in zip(group.names, group.units, values, middle, half)]
    sentence = group.sentence
    if group.effect == "payload":
        sizes += _place(group, values, covariance, t)
        if values[-1] < 0.0:
            sentence = sentence.replace("added to", "taken from")
    return ChangedCause(group.effect, group.kind, group.joint, sentence, tuple(sizes), scored.p_value(k))


def _place(group: Group, values: FloatArray, covariance: FloatArray, t: float) -> Iterator[SizeEstimate]:
    """Of a body: its distance from the joint where its mass is determined, else the furthest that it can be."""
    h = group.names.index("first_moment")
    name, (above, below) = ("distance", (h, 0)) if group.body else ("farthest", (h + 1, h))
    pair = np.array([above, below])
    found = fieller(values[pair], covariance[np.ix_(pair, pair)], t)
    if found is not None and values[below] != 0.0:
        yield SizeEstimate(name, "m", float(values[above] / values[below]), found)


def _noise_cause(change: LevelChange) -> ChangedCause:
    size = SizeEstimate(change.column, "times", change.ratio, change.ci95)
    return ChangedCause("noise", "noise", None, f"the noise of {change.column} changed", (size,), change.p_value)


def _detectable(scored: Scored) -> tuple[Detectable, ...]:
    """Of each effect, joint and parameter, at its best shape, by its p-value."""
    found: dict[tuple[str, int | None, str], Detectable] = {}
    wanted = float(fdtri(1, scored.freedom, 1.0 - ALPHA / (scored.pairs * len(scored.groups)))) ** 0.5
    wanted += float(stdtrit(scored.freedom, POWER))
    parameters = {group.names for group in scored.groups if group.effect == "parameter"}
    for k, group in enumerate(scored.groups):
        if group.effect != "parameter" and group.names[:1] in parameters:
            continue
        first = group.basis[:, :1]
        own = scored.contrast.measured(first, first[:, :0])
        change, half = float(own.size()[0]), float(stdtrit(scored.freedom, 0.975)) * _std(own)
        detectable = Detectable(group.effect, group.joint, group.names[0], group.units[0],
                                wanted * _std(scored.contrast.along(first)), change, (change - half, change + half),
                                scored.p_value(k))
        key = (group.effect, group.joint, group.names[0] if group.effect == "parameter" else "")
        if key not in found or detectable.p_value < found[key].p_value:
            found[key] = detectable
    return tuple(sorted(found.values(), key=lambda d: (d.p_value, -abs(d.change) / d.size)))


def _std(score: Score) -> float:
    """Standard deviation of one size; infinite where the runs do not determine it."""
    known = float(score.information[0, 0])
    return known**-0.5 if known > 0.0 else float("inf")


def _words(causes: Sequence[ChangedCause]) -> str:
    return ", ".join(map(_word, causes))


def _word(cause: ChangedCause) -> str:
    first = cause.size[0]
    value = f"{first.value:.3g}{'' if first.unit == '1' else f' {first.unit}'}"
    if cause.effect == "parameter":
        return f"{first.name} by {value}"
    if cause.effect == "noise":
        return f"noise of {first.name}, {value}"
    where = "" if cause.joint is None else f" ({'link' if cause.effect == 'payload' else 'joint'} {cause.joint})"
    return f"{cause.effect}{where}, {first.name} {value}"
