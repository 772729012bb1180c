"""`StateTorque`: a torque on one joint as a function of the state, in tables: what no listed effect describes.

tau(q, v, u) = c + sum_t f_t(x) or f_t(x) sign(v): each f_t is linear between knots in one variable, bilinear in two.
Beyond its knots a table keeps its edge value.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, TorqueEffect, View

MARGIN = 0.02
"""Share of a variable's range by which a motion may leave it: another run of the same plan does."""
VariableKind = Literal["angle", "rate", "motor torque"]
FIELDS: dict[str, str] = {"angle": "q", "rate": "v", "motor torque": "u"}
"""Of `Points`, by kind."""


class Variable(NamedTuple):
    """One quantity that a simulation has at every instant."""

    kind: VariableKind
    joint: int
    """0-based"""

    def of(self, at: Points) -> FloatArray:
        """(...) its values."""
        return np.asarray(getattr(at, FIELDS[self.kind])[self.joint])


@dataclass(frozen=True)
class Table:
    """Torque [N m] at knots of one or two variables."""

    variables: tuple[Variable, ...]
    knots: tuple[FloatArray, ...]
    """One increasing array a variable."""
    values: FloatArray
    """(K,) or (K, L)"""
    std: FloatArray
    """Of the values, likewise."""
    directed: bool = False
    """Whether the smoothed sign of the joint's rate multiplies it."""

    def torque(self, at: Points, joint: int) -> FloatArray:
        """(...) its torque on the joint at the points."""
        x = [variable.of(at) for variable in self.variables]
        if len(x) == 1:
            found = np.interp(x[0], self.knots[0], self.values)
        else:
            (i, a), (k, b) = (_cell(one, knots) for one, knots in zip(x, self.knots))
            v = self.values
            found = (1.0 - a) * ((1.0 - b) * v[i, k] + b * v[i, k + 1]) + a * ((1.0 - b) * v[i + 1, k]
                                                                             + b * v[i + 1, k + 1])
        return np.asarray(found * at.sign[joint] if self.directed else found)

    def columns(self, at: Points, joint: int) -> FloatArray:
        """(N, K L) derivatives of its torque at N points by its values, row by row."""
        rows = np.ones((at.q.shape[-1], 1)) if not self.directed else at.sign[joint][:, None]
        for variable, knots in zip(self.variables, self.knots):
            number = np.arange(float(knots.size))
            place = np.interp(variable.of(at), knots, number)[:, None]
            rows = np.einsum("ni,nj->nij", rows, np.maximum(1.0 - np.abs(place - number), 0.0)).reshape(len(rows), -1)
        return rows

    def outside(self, at: Points) -> FloatArray:
        """(V,) share of the points outside the knots of each variable by more than `MARGIN`."""
        ends = [(knots[0], knots[-1], MARGIN * (knots[-1] - knots[0])) for knots in self.knots]
        return np.array([np.mean((x < low - slack) | (x > high + slack))
                         for x, (low, high, slack) in zip([v.of(at) for v in self.variables], ends)])


def _cell(x: FloatArray, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Number of the knot below each x, and how far x is from it towards the next, 0 to 1."""
    place = np.interp(x, knots, np.arange(float(knots.size)))
    below = np.minimum(place.astype(np.intp), knots.size - 2)
    return below, place - below


class StateTorque(TorqueEffect):
    """A constant and a sum of tables. Its values are learnt, so it has no sizes to fit."""

    name = "state_torque"
    sizes = ()
    sentence = reference = experiment = ""

    def __init__(self, joint: int, tables: Sequence[Table], constant: float = 0.0) -> None:
        super().__init__(joint)
        self.tables, self.constant = tuple(tables), constant

    def felt(self, count: int) -> Iterable[int]:
        return range(count)

    def moved_by(self, field: str, joint: int, loops: bool) -> StateTorque:
        """Its tables that change with this field of `Points` at a joint; with `loops` its motor torque changes, too."""
        fields = {field, "u"} if loops else {field}
        return StateTorque(self.joint or 0, [
            table for table in self.tables if (field == "sign" and table.directed and joint == self.joint)
            or any(x.joint == joint and FIELDS[x.kind] in fields for x in table.variables)])

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return self.torque(at)

    def torque(self, at: Points) -> FloatArray:
        """(...) torque that it takes from its joint at the points."""
        out = np.full(at.q.shape[1:], self.constant)
        for table in self.tables:
            out = out + table.torque(at, self.joint or 0)
        return out
