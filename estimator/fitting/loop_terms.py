"""`with_loop_terms`: what a rig does not state of its position loops, estimated together with the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.effects import CommandDelay, Effect
from estimator.errors import FitError
from estimator.fitting.gauss_newton import iterate
from estimator.fitting.initial_guess import noise_floors
from estimator.likelihood import LatentProblem, Stage, State
from estimator.options import FitOptions
from estimator.result import TWO_SIDED
from estimator.signals import SignalSet

LATEST_S = 0.2
"""Largest delay of a command that is believed."""
Extra = tuple[tuple[Effect, FloatArray], ...]
"""Terms that are estimated with a fit, and are none of its parameters."""


class Loops(NamedTuple):
    """A fit with the terms of its loops."""

    state: State
    """Without their sizes"""
    extra: Extra
    told: tuple[str, ...]


def extended(problem: LatentProblem, signals: Sequence[SignalSet], effects: Sequence[Effect]) -> LatentProblem:
    """The likelihood of segments as `problem` has it, with effects; the range of angles is that of the encoders."""
    seen = problem.angles[:, problem.has_encoder]
    reach = np.zeros((problem.n, 2))
    reach[problem.has_encoder] = np.stack([seen.min(axis=0), seen.max(axis=0)], axis=-1)
    blank = Stage.blank(len(signals), problem.n)
    found = LatentProblem(signals, problem.mechanism, problem.collocation.hold, replace(blank, angle_range=reach),
                          effects)
    return found.with_disturbance() if problem.disturbed else found


def with_loop_terms(problem: LatentProblem, state: State, signals: Sequence[SignalSet], free: NDArray[np.bool_],
                    options: FitOptions) -> Loops:
    """The fit with the delay of every command whose loop makes the torque, where the rig states none.

    It stays as it was where a fit with them does not converge.
    """
    late = [CommandDelay(j) for j in problem.mechanism.followers] if options.unknown_delay else []
    if not state.converged or not late:
        return Loops(state, (), ())
    wide, count = extended(problem, signals, late), len(late)
    begin = State(state.x, np.append(state.beta, np.zeros(count)), state.noise.levels(),
                  np.zeros((state.beta.size + count,) * 2))
    try:
        again = iterate(wide, begin, np.append(free, np.ones(count, dtype=bool)), options,
                        noise_floors(wide, wide.mechanism, state.beta))
    except (FitError, np.linalg.LinAlgError):
        return Loops(state, (), ())
    delays, std = again.beta[-count:], np.sqrt(np.diag(again.covariance)[-count:])
    if not again.converged or np.abs(delays).max() > LATEST_S:
        return Loops(state, (), ())
    p = state.beta.size
    short = State(again.x, again.beta[:p], again.noise, again.covariance[:p, :p], True,
                  state.iterations + again.iterations, misfit=again.misfit)
    known = [_delay_of(signals, effect.joint or 0) for effect in late]
    told = tuple(f"commands of joint {(effect.joint or 0) + 1} act {1e3 * (delay + first):.3g} ms late, "
                 f"+-{1e3 * TWO_SIDED * one:.2g} ms, by this motion; corrected"
                 for effect, delay, one, first in zip(late, delays, std, known))
    return Loops(short, tuple((effect, np.array([delay])) for effect, delay in zip(late, delays)), told)


def _delay_of(signals: Sequence[SignalSet], joint: int) -> float:
    """Delay [s] that the loops of a joint have already."""
    loop = signals[0].commands and signals[0].commands.loops[joint]
    return float(loop.delay_s) if loop else 0.0
