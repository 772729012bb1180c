"""Free-run simulation of a model with effects, and what its sensors would read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from daq import FloatArray
from estimator.effects import (
    BodyEffect,
    Effect,
    LawEffect,
    Laws,
    RecordedMotion,
    SensorEffect,
    SimulatedIntegral,
    StateEffect,
    View,
)
from estimator.likelihood.effect_columns import added
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.normal_equations import Latents
from estimator.likelihood.state import State
from estimator.model import simulate, smooth_sign
from estimator.signals import Channel, encoder_of, imu_readings, torque_of

PASSES = 60
CONVERGED_RAD = 2e-5
CONVERGED_NM = 1e-6
LOST_RAD = 50.0
"""A simulation that is so far from the fitted motion is lost. (Measured: at rest under dry friction a piece of a tenth
of a second went 1,439 rad.)"""
LOOSE_RAD = 5e-4
"""What may still move after PASSES: about an encoder's noise. (Measured: a motion that moved by less than 20 mrad a
pass was 60 mrad off.)"""
HOPELESS = 5
"""Passes after which an iteration of the whole that still moves that much gives way to windows."""
WINDOW_S = 0.5
WINDOW_PASSES = 25
"""Of `_marched`: longer windows need more passes, shorter ones are more of them. (Measured on a ripple of 100 periods a
rad over 20 s: 721 evaluations in windows of 0.25 s, 558 of 0.5 s.)"""


@dataclass(frozen=True)
class FreeRun:
    """Motion from each segment's first state and the torque alone."""

    q: FloatArray
    """(N, n)"""
    v: FloatArray
    readings: Mapping[Channel, FloatArray]
    """(N,), noise free."""
    lost: int = 0
    """Pieces that diverged and stay where they began."""


def free_run(problem: LatentProblem, state: State, drive: FloatArray | None = None,
             horizon_s: float = np.inf, or_still: bool = False,
             near: tuple[FloatArray, FloatArray] | None = None) -> FreeRun | None:
    """Simulate every segment, or each piece of it of `horizon_s`, from its first state; None where it diverges.

    With `or_still` a piece that diverges stays where it began: what one does says little of the others.

    `drive` (N, n) is the torque, by default the true one in `state`. Of joints that follow commands it is what their
    loops gave in the record and what acted on top of that, which acts in the simulation, too.

    What effects with a memory add to the equation of motion is found by repeated simulation, each with their torque of
    the one before. The search begins at the motion `near` (q, v), by default that in `state`.
    """
    m = problem.mechanism
    u = problem.motor_torque(state.x, state.beta) if drive is None else drive
    parts = pieces(problem, horizon_s)
    plant = _Plant(problem, state, u, or_still, parts)
    found = _relaxed(plant, parts, near)
    if found is None and plant.memory:
        found = _marched(plant, parts)
    if found is None:
        return None
    q, v, taken = found
    q, v = q[:, : m.n], v[:, : m.n]
    readings = _readings(plant, q, v, taken)
    if not all(np.isfinite(values).all() for values in readings.values()):  # an effect on a motion that is far off
        return None
    return FreeRun(q, v, readings, plant.lost)


def read_motion(problem: LatentProblem, state: State) -> dict[Channel, FloatArray]:
    """(N,) what each sensor would read, without noise, on the motion in `state`."""
    plant = _Plant(problem, state, problem.motor_torque(state.x, state.beta))
    return _readings(plant, state.x.q, state.x.v, plant.at_samples(state.x.q, state.x.v))


def _readings(plant: _Plant, q: FloatArray, v: FloatArray, taken: FloatArray) -> dict[Channel, FloatArray]:
    problem, n = plant.problem, plant.problem.n
    u = plant.acting(q, v)
    for effect, size in plant.pairs:  # as if it was in the loop
        if isinstance(effect, SimulatedIntegral):
            lacking = effect.perturb(plant.view(q, v, taken), size).torque_at_samples
            u = u if lacking is None else u - lacking.T
    readings = {torque_of(j): u[:, j].copy() for j in range(n)}
    readings |= {encoder_of(j): q[:, j].copy() for j in range(n)}
    if not plant.pairs:
        qdd, _ = problem.collocation.fast.forward_dynamics(q, v, u, plant.beta)
        return readings | imu_readings(problem.mechanism, q.T, v.T, qdd)
    view = plant.view(q, v, taken)
    s = view.samples
    readings |= imu_readings(problem.mechanism, s.q, s.v, s.a)
    for channel, value in added(plant.pairs, view)[2].items():
        readings[channel] = readings[channel] + value
    return readings


def pieces(problem: LatentProblem, horizon_s: float) -> list[slice]:
    """Segments cut into pieces of about `horizon_s`, of two samples at least."""
    out = []
    for begin, end in zip([0, *problem.ends[:-1]], problem.ends):
        most = max(1, (end - begin) // 2)
        wanted = (end - begin) * problem.collocation.dt / horizon_s
        count = min(most, max(1, round(wanted)))
        edges = np.linspace(begin, end, count + 1).astype(int)
        out += [slice(int(a), int(b)) for a, b in pairwise(edges)]
    return out


class _Plant:
    """What a free run integrates: the mechanism under a torque, with effects that feel the motion."""

    def __init__(self, problem: LatentProblem, state: State, u: FloatArray, or_still: bool = False,
                 parts: Sequence[slice] | None = None) -> None:
        self.problem, self.start = problem, state.x
        self.closed = problem.closed and (parts is not None or problem.by_law)
        """Whether position loops make the torque."""
        self.u = u - problem.torque if self.closed else u
        self.commands = problem.commands
        """Of position loops, at the samples and at the Gauss points."""
        if self.commands is not None and self.closed:
            self.commands = replace(self.commands[0], closed=True), replace(self.commands[1], closed=True)
        self.beta, sizes = problem.simulated(state.beta)
        self.pairs: list[tuple[Effect, FloatArray]] = list(zip(problem.effects, sizes))
        if parts is not None and self.closed:
            self.pairs += integrals(problem, parts)
        self.memory = [p for p in self.pairs if _remembers(p[0])]
        """Effects whose torque depends on the motion before: found by iteration, the others by Newton's method."""
        self.or_still = or_still and not self.memory  # an iteration in which a piece is lost leads nowhere
        self.lost = 0
        self.alone: set[int] = set()
        """First samples of the segments whose parts do not converge together."""
        self.mechanism, self.all_beta = problem.mechanism, self.beta
        """Those of the simulation: with what effects add as bodies; motions (N, n) have their columns, too."""
        for effect, size in self.pairs:
            if isinstance(effect, BodyEffect):
                self.mechanism, self.all_beta = effect.body(self.mechanism, self.all_beta, size)
                q, v = effect.body_motion(self.view(state.x.q, state.x.v), size)
                self.start = Latents(np.column_stack([self.start.q, q]), np.column_stack([self.start.v, v]),
                                     np.column_stack([self.start.u, np.zeros_like(q)]))
                self.u = np.column_stack([self.u, np.zeros_like(q)])
        instant = [(e, size) for e, size in self.pairs if isinstance(e, LawEffect) and e.parts and not _remembers(e)]
        self.laws = None
        if instant or self.closed:
            view = self.seen(Latents(state.x.q, state.x.v, self.u[:, : problem.n]))
            self.laws = Laws(instant, replace(view, mechanism=self.mechanism, beta=self.all_beta), closed=self.closed)

    def acting(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """(N, n) torque of the motors along the motion q, v (N, n)."""
        n = self.problem.n
        own, commands = self.u[:, :n], self.commands
        if not self.closed or commands is None:
            return own
        a = np.concatenate([np.gradient(part, self.problem.dt, axis=0)
                            for part in np.split(v[:, :n], self.problem.ends[:-1])])
        return np.asarray(own + commands[0].input(q[:, :n].T, v[:, :n].T, a.T).T)

    def view(self, q: FloatArray, v: FloatArray, samples: FloatArray | None = None) -> View:
        """At the motion q, v (N, n), where effects take `samples` (n, N)."""
        n = self.problem.n
        return self.seen(Latents(q[:, :n], v[:, :n], self.acting(q, v)), samples)

    def seen(self, x: Latents, samples: FloatArray | None = None) -> View:
        """At the latents `x`, the position loops as they are in this simulation."""
        view = self.problem.view(x, self.beta, samples)
        if self.commands is None:
            return view
        return replace(view, samples=replace(view.samples, commanded=self.commands[0]),
                       gauss=replace(view.gauss, commanded=self.commands[1]))

    def run(self, where: slice, q: FloatArray, v: FloatArray, start: tuple[FloatArray, FloatArray],
            taken: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Motion in the samples `where` from its `start`, near q, v; effects with a memory take `taken` (n, 2, K)."""
        c, here = self.problem.collocation, self.intervals(where)
        found = simulate(self.mechanism, self.all_beta, *start, self.u[where], c.dt, c.hold,
                         (q[where], v[where]), self.all_taken(taken[:, :, here]), self.laws_on(where, v))
        return found[0], found[1]

    def run_parts(self, parts: Sequence[slice], q: FloatArray, v: FloatArray, taken: FloatArray
                  ) -> tuple[FloatArray, FloatArray]:
        """Motion like `run`, of consecutive `parts` of one segment, each from its own start.

        All are solved together; where that does not converge, one by one.
        """
        c, whole = self.problem.collocation, slice(parts[0].start, parts[-1].stop)
        here = self.intervals(whole)
        begin = np.array([p.start for p in parts])
        near_q, near_v = q.copy(), v.copy()
        near_q[begin], near_v[begin] = self.start.q[begin], self.start.v[begin]
        if len(parts) > 1 and whole.start not in self.alone:
            found = simulate(self.mechanism, self.all_beta, near_q[whole.start], near_v[whole.start], self.u[whole],
                             c.dt, c.hold, (near_q[whole], near_v[whole]), self.all_taken(taken[:, :, here]),
                             self.laws_on(whole, near_v), begin[1:] - whole.start)
            if self.is_kept(found[0], whole):
                return found[0], found[1]
            self.alone.add(whole.start)
        each = [self.run(p, near_q, near_v, (near_q[p.start], near_v[p.start]), taken) for p in parts]
        if self.or_still:
            kept = [self.is_kept(e[0], p) for p, e in zip(parts, each)]
            self.lost += kept.count(False)
            each = [e if k else (near_q[p.start] + np.zeros_like(e[0]), np.zeros_like(e[1]))
                    for k, p, e in zip(kept, parts, each)]
        return np.concatenate([e[0] for e in each]), np.concatenate([e[1] for e in each])

    def laws_on(self, where: slice, v: FloatArray) -> Laws | None:
        """Instant laws in the samples `where`, their states from the rates v (N, n) near the simulated ones."""
        if self.laws is None:
            return None
        laws, problem = self.laws, self.problem
        starts = np.concatenate([[0], problem.ends[:-1]])
        states = [e.states(v[:, e.joint or 0], smooth_sign(v[:, e.joint or 0], laws.scale(e)), starts, size, problem.dt)
                  for e, size in laws.with_state]
        start = np.stack(states, axis=1)[where] if states else None
        return replace(laws, first=self.intervals(where).start, start=start)

    def all_taken(self, taken: FloatArray) -> FloatArray:
        """`taken` (n, 2, K) with a row for each body."""
        return np.pad(taken, [(0, self.mechanism.n - len(taken)), (0, 0), (0, 0)])

    def is_kept(self, q: FloatArray, where: slice) -> bool:
        """Whether a simulated motion stays near the fitted one, as far as a simulation can be off and say anything."""
        return bool(np.isfinite(q).all() and np.abs(q - self.start.q[where]).max() < LOST_RAD)

    def intervals(self, where: slice) -> slice:
        """Intervals between the samples `where` of one segment."""
        first = int(np.searchsorted(self.problem.left, where.start))
        return slice(first, first + where.stop - where.start - 1)

    def remembered(self, q: FloatArray, v: FloatArray, samples: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Torque of effects with memory at Gauss points (n, 2, K), and of all effects at samples (n, N)."""
        with np.errstate(all="ignore"):
            view = self.view(q, v, samples)
            gauss = added(self.memory, view)[0]
            return gauss, added(self.pairs, view)[1]

    def at_samples(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """(n, N) what all effects take at the samples of a motion: their torque changes accelerations that they feel"""
        samples, share, before = np.zeros((self.problem.n, self.problem.total)), 1.0, np.inf
        for _ in range(PASSES if self.pairs else 0):
            change = self.remembered(q, v, samples)[1] - samples
            samples = samples + share * change
            size = float(np.max(np.abs(change)))
            if not size > CONVERGED_NM:
                break
            share = _calmed(share, size, before)
            before = size
        return samples


_Run = tuple[FloatArray, FloatArray, FloatArray]
"""q, v (N, n), and what effects take at the samples (n, N)"""


def _relaxed(plant: _Plant, parts: Sequence[slice], near: tuple[FloatArray, FloatArray] | None) -> _Run | None:
    """All parts, effects with a memory by fixed-point iteration; None where it diverges."""
    problem = plant.problem
    q, v = plant.start.q.copy(), plant.start.v.copy()
    if near is not None:
        q[:, : problem.n], v[:, : problem.n] = near
    edge = problem.n * 2 * problem.left.size
    taken = np.zeros(edge + problem.n * problem.total)
    segments = [[p for p in parts if begin <= p.start < end]
                 for begin, end in zip([0, *problem.ends[:-1]], problem.ends)]
    share, before = 1.0, np.inf
    for k in range(PASSES):
        if plant.memory:
            wanted = np.concatenate([x.ravel() for x in plant.remembered(q, v, taken[edge:].reshape(problem.n, -1))])
            if not np.isfinite(wanted).all():
                return None
            taken = taken + share * (wanted - taken)
        next_q, next_v = np.empty_like(q), np.empty_like(v)
        for segment in segments:
            where = slice(segment[0].start, segment[-1].stop)
            next_q[where], next_v[where] = plant.run_parts(segment, q, v, taken[:edge].reshape(problem.n, 2, -1))
        if not plant.is_kept(next_q, slice(0, problem.total)):
            return None
        moved = float(np.max(np.abs(next_q - q)))
        q, v = next_q, next_v
        if not plant.memory or moved < CONVERGED_RAD:
            return q, v, plant.at_samples(q, v)
        if k >= HOPELESS and moved > LOOSE_RAD:
            return None
        share = _calmed(share, moved, before)
        before = moved
    return (q, v, plant.at_samples(q, v)) if moved <= LOOSE_RAD else None


def _marched(plant: _Plant, parts: Sequence[slice]) -> _Run | None:
    """As `_relaxed`, one short window after the other: effects are causal.

    A window in which the steps do not converge is halved.
    """
    problem = plant.problem
    q, v = plant.start.q.copy(), plant.start.v.copy()
    samples = np.zeros((problem.n, problem.total))
    longest = max(2, round(WINDOW_S / problem.collocation.dt))
    for part in parts:
        start, step = part.start, longest
        while start < part.stop - 1:
            window = slice(start, min(start + step, part.stop - 1) + 1)
            found = _window(plant, window, (q, v, samples))
            if found is not None:
                q, v, samples = found
                start, step = window.stop - 1, min(2 * step, longest)
            elif step > 1:
                step //= 2
            else:
                return None
    return q, v, plant.at_samples(q, v)


def _window(plant: _Plant, where: slice, before: _Run) -> _Run | None:
    """`before` with the motion in `where` simulated from its first sample; None where that does not converge."""
    q, v, samples = (x.copy() for x in before)
    taken, share, last = np.zeros((plant.problem.n, 2, plant.problem.left.size)), 1.0, np.inf
    for _ in range(WINDOW_PASSES):
        gauss, new = plant.remembered(q, v, samples)
        taken += share * (gauss - taken)
        samples[:, where] += share * (new - samples)[:, where]
        if not (np.isfinite(taken[:, :, plant.intervals(where)]).all() and np.isfinite(samples[:, where]).all()):
            return None
        next_q, next_v = plant.run(where, q, v, (q[where.start], v[where.start]), taken)
        if not np.isfinite(next_q).all():
            return None
        moved = float(np.max(np.abs(next_q - q[where])))
        q[where], v[where] = next_q, next_v
        if moved < CONVERGED_RAD:
            break
        share = _calmed(share, moved, last)
        last = moved
    return (q, v, samples) if moved <= LOOSE_RAD else None


def integrals(problem: LatentProblem, parts: Sequence[slice]) -> list[tuple[Effect, FloatArray]]:
    """Those of the position loops as a simulation of these `parts` has them; none where no loop integrates."""
    if problem.commands is None or not np.nan_to_num(np.asarray(problem.commands[0].loop.integral)).any():
        return []
    first = np.repeat([p.start for p in parts], [p.stop - p.start for p in parts]).astype(np.intp)
    recorded = np.nan_to_num(problem.angles.T)
    return [(SimulatedIntegral(RecordedMotion(recorded, first)), np.zeros(0))]


def _remembers(effect: Effect) -> bool:
    """Whether its torque depends on the motion before, by more than a state of its own."""
    if isinstance(effect, SensorEffect | BodyEffect):
        return False
    return not isinstance(effect, LawEffect) or (isinstance(effect, StateEffect) and not effect.has_state)


def _calmed(share: float, moved: float, before: float) -> float:
    """Share of the next step: less where this one was hardly smaller than the one before."""
    return max(0.2, 0.7 * share) if moved > 0.9 * before else share
