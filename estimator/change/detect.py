"""`detect_change`: which change of a parameter, a payload or an effect tells test runs from reference runs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, fdtri, stdtrit

from daq import Dataset
from estimator.change.contrast import HIDDEN, Columns, Contrast, contrast
from estimator.change.result import Change, ChangedCause, Detectable, HeldOut, Size
from estimator.change.scores import ReferenceFit, RunScore, fit_reference, score_run
from estimator.change.structure import Structure, find_structure
from estimator.errors import FitError
from estimator.model import Mechanism
from estimator.options import FitOptions

ALPHA = 0.01
"""p-value, over all candidates tried, below which something changed."""
POWER = 0.8
FEWEST_RUNS = 2
MOST_CAUSES = 2
RIVAL = 6.0
"""Candidates within this fall of -2 log likelihood of the best are not told apart from it."""
PAYLOAD = {1: (("beta1", "beta4"), ("inertia", "first_moment")),
           2: (("beta1", "beta2", "beta3", "beta4", "beta5"), ("", "inertia", "", "", "first_moment"))}
"""Link of the two-link leg -> parameters that a body on it changes, and which of the body's own each change is."""


@dataclass(frozen=True)
class Group:
    """Columns that change together."""

    effect: str
    joint: int | None
    sentence: str
    columns: Columns
    names: tuple[str, ...]
    """Of the sizes; empty for one that is not reported."""
    units: tuple[str, ...]
    positive: tuple[int, ...] = ()
    """Sizes that are not below zero where the cause is present."""

    @property
    def key(self) -> tuple[str, int | None]:
        return self.effect, self.joint


@dataclass(frozen=True)
class Scored:
    """All candidates on one contrast."""

    groups: tuple[Group, ...]
    contrast: Contrast
    freedom: float

    def gain(self, k: int) -> float:
        """Fall of -2 log likelihood; zero where a size has the wrong sign."""
        group = self.groups[k]
        sizes = self.contrast.size(group.columns)
        return 0.0 if any(sizes[i] < 0.0 for i in group.positive) else \
            max(self.contrast.gain(group.columns), 0.0)

    def p_value(self, k: int) -> float:
        width = len(self.groups[k].columns)
        return min(1.0, len(self.groups) * float(fdtrc(width, self.freedom, self.gain(k) / width)))


def detect_change(test: Sequence[Dataset], reference: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, *,
                  gear_ratio: float = 1.0) -> Change:
    """Changes between `reference` and `test` runs of one rig; data that cannot tell give `fit_failed`."""
    begin = time.perf_counter()
    names = tuple(d.name for d in reference), tuple(d.name for d in test)
    try:
        if min(len(reference), len(test)) < FEWEST_RUNS:
            raise FitError(f"{len(reference)} reference runs and {len(test)} test runs cannot show their scatter; give "
                           f"at least {FEWEST_RUNS} of each, better four")
        with np.errstate(all="ignore"):  # a search may diverge on its way; where it ends is checked
            fit = fit_reference(reference, mechanism, options, gear_ratio)
            found = conclude(fit, [score_run(fit, d) for d in reference], [score_run(fit, d) for d in test], names[1])
    except (FitError, np.linalg.LinAlgError) as error:
        found = Change("fit_failed", f"No comparison: {error}.")
    few = () if len(reference) >= 4 else (f"{len(reference)} reference runs: their scatter is poorly known; four or "
                                          "more are better",)
    return replace(found, reference=names[0], test=names[1], warnings=few, wall_s=time.perf_counter() - begin)


def groups_of(fit: ReferenceFit) -> tuple[Group, ...]:
    """Every single change that is tried: parameters, payloads, effects at each shape."""
    m = fit.mechanism
    place = {p.name: k for k, p in enumerate(m.parameters)}
    free = {p.name for p, is_free in zip(m.parameters, fit.free) if is_free}
    found = [Group("parameter", None, f"{p.name} ({p.meaning}) changed", np.array([k]), (p.name,), (p.unit,))
             for k, p in enumerate(m.parameters) if fit.free[k]]
    for link, (names, sizes) in PAYLOAD.items():
        if m.n == 2 and set(names) <= free:
            found.append(Group("payload", link, f"a body was added to link {link}", np.array([place[n] for n in names]),
                               sizes, tuple(m.parameters[place[n]].unit for n in names),
                               tuple(i for i, s in enumerate(sizes) if s == "inertia")))
    start = m.p
    for candidate in fit.candidates[: fit.named]:
        e = candidate.effect
        columns = np.arange(start, start + candidate.width)
        found.append(Group(e.name, None if e.joint is None else e.joint + 1, e.sentence, columns,
                           tuple(s.name for s in e.sizes), tuple(m.unit(s.unit) for s in e.sizes)))
        start += candidate.width
    return tuple(found)


def conclude(fit: ReferenceFit, reference: Sequence[RunScore], test: Sequence[RunScore], names: Sequence[str]
             ) -> Change:
    """Verdict, sizes, and the held-out gain by run, from the scores of both sessions."""
    groups, structure = groups_of(fit), find_structure(reference, fit.mechanism.p)
    scored = Scored(groups, contrast(test, reference, structure), structure.freedom)
    order = sorted(range(len(groups)), key=scored.p_value)
    best = order[0]
    p_any, tried = scored.p_value(best), {g.effect for g in groups}
    refused = tuple((k, why) for k, why in fit.refused.items() if k not in tried)
    base = Change("no_change", "", detectable=_detectable(scored), p_any=p_any, not_testable=refused,
                  structure=(structure.common**0.5, structure.own**0.5))
    if p_any >= ALPHA:
        return replace(base, sentence="No change: the test runs differ from the reference runs by no more than these "
                                      "differ among themselves.")
    chosen = _search(scored, order)
    held = _held_out(scored, structure, reference, test, chosen, names)
    if not sum(held.gain) > 0.0 or 2 * sum(g > 0.0 for g in held.gain) <= len(held.gain):
        return replace(base, verdict="changed_unexplained", held_out=held,
                       sentence="Something changed, and no listed cause predicts test runs that did not choose it.")
    causes = tuple(_cause(scored, k) for k in chosen)
    rest = _without(scored, chosen)
    if min(map(rest.p_value, range(len(groups)))) < ALPHA:
        return replace(base, verdict="partial", causes=causes, held_out=held,
                       sentence=f"Changed: {_words(causes)}, and something else that these causes leave.")
    rivals = [k for k in order if groups[k].key not in {groups[c].key for c in chosen}
              and scored.gain(k) > scored.gain(best) - RIVAL] if len(chosen) == 1 else []
    first = {groups[k].key: k for k in reversed(rivals)}
    if first:
        several = (*causes, *(_cause(scored, k) for k in first.values()))
        return replace(base, verdict="one_of", causes=several, held_out=held,
                       sentence=f"One of these changed: {_words(several)}. These runs cannot tell which.")
    return replace(base, verdict="named", causes=causes, held_out=held, sentence=f"Changed: {_words(causes)}.")


def _search(scored: Scored, order: Sequence[int]) -> list[int]:
    """The likeliest single change, and a second one where the first leaves something significant that one takes up."""
    chosen = [max(order, key=scored.gain)]
    while len(chosen) < MOST_CAUSES:
        rest = _without(scored, chosen)
        more = min(range(len(scored.groups)), key=rest.p_value)
        if rest.p_value(more) >= ALPHA or scored.groups[more].key in {scored.groups[k].key for k in chosen}:
            break
        chosen.append(more)
    return chosen


def _without(scored: Scored, chosen: Sequence[int]) -> Scored:
    """The scores with the `chosen` changes fitted and projected out."""
    columns = np.unique(np.concatenate([scored.groups[k].columns for k in chosen]))
    one = scored.contrast
    carry = one.information[:, columns] @ one.covariance(columns)
    left = one.information - carry @ one.information[columns]
    gone = np.diag(left) < HIDDEN * np.diag(one.information)
    score = one.score - carry @ one.score[columns]
    score[gone], left[gone], left[:, gone] = 0.0, 0.0, 0.0
    return replace(scored, contrast=Contrast(score, left))


def _held_out(scored: Scored, structure: Structure, reference: Sequence[RunScore], test: Sequence[RunScore],
              chosen: Sequence[int], names: Sequence[str]) -> HeldOut:
    """Each test run as predicted by the reference with the change that the other test runs give."""
    columns = np.unique(np.concatenate([scored.groups[k].columns for k in chosen]))
    gains = []
    for k, run in enumerate(test):
        size = contrast([r for j, r in enumerate(test) if j != k], reference, structure).size(columns)
        own = contrast([run], reference, structure)
        gains.append(float(2.0 * size @ own.score[columns]
                           - size @ own.information[np.ix_(columns, columns)] @ size))
    return HeldOut(tuple(names), tuple(gains))


def _cause(scored: Scored, k: int) -> ChangedCause:
    """Sizes of one change, with intervals that include the structure of the reference."""
    group, one = scored.groups[k], scored.contrast
    values = one.size(group.columns)
    std = np.sqrt(np.maximum(np.diag(one.covariance(group.columns)), 0.0))
    half = float(stdtrit(scored.freedom, 0.975)) * std
    sizes = tuple(Size(n, u, float(v), (float(v - h), float(v + h)))
                  for n, u, v, h in zip(group.names, group.units, values, half) if n)
    return ChangedCause(group.effect, group.joint, group.sentence, sizes, scored.p_value(k))


def _detectable(scored: Scored) -> tuple[Detectable, ...]:
    """Of each effect, joint and parameter, at its best shape, by its p-value."""
    found: dict[tuple[str, int | None, str], Detectable] = {}
    for k, group in enumerate(scored.groups):
        wanted = float(fdtri(1, scored.freedom, 1.0 - ALPHA / len(scored.groups))) ** 0.5
        wanted += float(stdtrit(scored.freedom, POWER))
        i = next(j for j, n in enumerate(group.names) if n)
        known = float(scored.contrast.information[group.columns[i], group.columns[i]])
        size = wanted / known**0.5 if known > 0.0 else float("inf")
        one = Detectable(group.effect, group.joint, group.names[i], group.units[i], size, scored.p_value(k))
        key = (group.effect, group.joint, group.names[i] if group.effect == "parameter" else "")
        if key not in found or one.p_value < found[key].p_value:
            found[key] = one
    return tuple(sorted(found.values(), key=lambda d: d.p_value))


def _words(causes: Sequence[ChangedCause]) -> str:
    return ", ".join(f"{c.size[0].name} by {c.size[0].value:.3g} {c.size[0].unit}" if c.effect == "parameter" else
                     c.effect + ("" if c.joint is None else f" (joint {c.joint})") for c in causes)
