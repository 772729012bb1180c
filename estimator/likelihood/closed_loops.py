"""`closed_loops`: position loops that make the torque of their joints by the latent motion, not by what was read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from estimator.effects import ClosedLoop, View
from estimator.likelihood.measured_runs import MeasuredRuns


def closed_loops(problem: MeasuredRuns) -> list[ClosedLoop]:
    """One for each joint whose recorded torque is its loop's law of the readings."""
    if not problem.by_law:
        return []
    at_gauss = problem.collocation.torque(problem.torque, problem.left)
    recorded = at_gauss if problem.between is None else at_gauss + problem.between
    return [ClosedLoop(j, recorded[j], problem.torque[:, j]) for j in problem.mechanism.followers]


def driven(view: View, loops: Sequence[ClosedLoop]) -> View:
    """`view` of the recorded torques with those that the loops make of its motion."""
    if not loops:
        return view
    found = []
    for k, at in enumerate((view.gauss, view.samples)):
        assert at.commanded is not None
        u, made = at.u.copy(), at.commanded.input(at.q, at.v, at.a)
        for loop in loops:
            u[loop.joint] += made[loop.joint] - loop.recorded[k]
        found.append(replace(at, u=u))
    return replace(view, gauss=found[0], samples=found[1])
