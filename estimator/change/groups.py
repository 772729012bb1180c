"""`Group`: every single change that is tried, as the columns that it moves together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from daq import FloatArray
from estimator.change.contrast import Contrast
from estimator.change.payload import NAMES, UNITS, body_basis, fit_body, link_lengths
from estimator.change.result import Kind
from estimator.change.scores import ReferenceFit
from estimator.effects import BodyEffect, Effect, EncoderEffect, ImuEffect
from estimator.model import has_bodies
from estimator.score import Score


@dataclass(frozen=True)
class Group:
    """Sizes that change together."""

    effect: str
    kind: Kind
    joint: int | None
    sentence: str
    basis: FloatArray
    """(m, k) change of all columns by each size"""
    names: tuple[str, ...]
    units: tuple[str, ...]
    body: bool = False
    """Whether the sizes are mass, first moment and inertia of one body."""
    lengths: FloatArray | None = None
    """(lengths, m, k) change of `basis` by one standard deviation of each length in it."""

    @property
    def key(self) -> tuple[str, int | None]:
        return self.effect, self.joint

    def fit(self, score: Score) -> tuple[FloatArray, float]:
        """(k,) likeliest sizes, and the fall of -2 log likelihood, by score and information of the sizes."""
        if self.body:
            size, gain = fit_body(score)
        else:
            size = score.size()
            gain = float(size @ score.score)
        return size, max(gain, 0.0)

    def covariance(self, score: Score, whole: Contrast) -> FloatArray:
        """(k, k) of the sizes, uncertain lengths included; `whole` is the contrast that `score` is of."""
        found, size = score.covariance(), whole.along(self.basis).size()
        for moved in () if self.lengths is None else self.lengths:
            shift = whole.along(self.basis + moved).size() - size
            found = found + np.outer(shift, shift)
        return found


def groups_of(fit: ReferenceFit, known: Score) -> tuple[Group, ...]:
    """Every single change that is tried: parameters, payloads, links, effects at each shape; `known` is what all runs
    tell of the columns."""
    m = fit.model.mechanism
    columns = np.eye(known.score.size)
    found = [Group("parameter", "parameters", None, f"{p.name} ({p.meaning}) changed", columns[:, [k]], (p.name,),
                   (p.unit,)) for k, p in enumerate(m.parameters) if fit.free[k]]
    found += _links(fit, columns, payloads := list(_payloads(fit, known)))
    found += payloads
    start, loose = m.p, set(fit.loose)
    for candidate in fit.candidates[: fit.named]:
        e = candidate.effect
        if start in loose:
            start += candidate.width
            continue
        found.append(Group(e.name, kind_of(type(e)), e.joint_number,
                           e.meaning(candidate.shape), columns[:, start : start + candidate.width],
                           tuple(s.name for s in e.sizes), tuple(m.unit(s.unit) for s in e.sizes)))
        start += candidate.width
    return tuple(found)


def kind_of(effect: type[Effect]) -> Kind:
    """Kind of change that an effect is."""
    if effect.sizes[0].unit == "s":
        return "timing"
    if issubclass(effect, ImuEffect | EncoderEffect):
        return "sensors"
    return "environment" if issubclass(effect, BodyEffect) else "mechanics"


def _links(fit: ReferenceFit, columns: FloatArray, payloads: Sequence[Group]) -> Iterator[Group]:
    """All rigid parameters at once, as links of other lengths change them; nothing where a single change does so."""
    rigid = [k for k, p in enumerate(fit.model.mechanism.parameters) if p.rigid and fit.free[k]]
    if len(rigid) > max([1, *(np.linalg.matrix_rank(group.basis) for group in payloads)]):
        of = [fit.model.mechanism.parameters[k] for k in rigid]
        yield Group("links", "parameters", None, "links of other lengths, masses or inertias", columns[:, rigid],
                    tuple(p.name for p in of), tuple(p.unit for p in of))


def _payloads(fit: ReferenceFit, known: Score) -> Iterator[Group]:
    """A body on each link; sizes that move no parameter are left out."""
    m = fit.model.mechanism
    covariance = known.along(np.eye(known.score.size)[:, : m.p]).covariance()
    lengths = link_lengths(m, fit.model.beta, covariance)
    values = {i: length for i, (length, _) in lengths.items()}
    for link in range(m.n):
        basis = body_basis(m, link, values) if has_bodies(m) else None
        if basis is None or not fit.free[basis.any(axis=1)].all():
            continue
        there = np.flatnonzero(basis.any(axis=0))
        moved = [body_basis(m, link, {**values, i: values[i] + std}) for i, (_, std) in lengths.items()]

        below = ((0, known.score.size - m.p), (0, 0))
        changed = np.array([np.pad((one - basis)[:, there], below) for one in moved if one is not None])
        yield Group("payload", "parameters", link + 1, f"a body was added to link {link + 1}",
                    np.pad(basis[:, there], below), tuple(NAMES[i] for i in there), tuple(UNITS[i] for i in there),
                    there.size == 3, changed if changed.any() else None)
