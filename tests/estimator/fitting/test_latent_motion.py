"""The motion of a leg whose joints stick and reverse: found from anywhere, where whole steps go to and fro."""

from dataclasses import replace

import numpy as np
import pytest

from estimator import FitOptions
from estimator.fitting import converge_motion
from estimator.likelihood import LatentProblem, Latents, Noise, Stage, State, find_stiction
from estimator.model import leg2
from estimator.numerics import eliminate
from estimator.signals import split_signals
from tests.support.mujoco_leg import Leg
from tests.support.stick_slip_leg import move, sample

NOISE = Noise(np.array([0.001, 0.01]), np.array([np.inf, 2e-4]), np.array([0.004]), np.full((1, 2), 0.04))


@pytest.fixture(scope="module")
def sticking() -> tuple[LatentProblem, State]:
    """A record of a leg with heavy friction, at the motion that its sensors show, with its true parameters."""
    leg = replace(Leg(), coulomb=(0.02, 0.1))
    rng = np.random.default_rng(77)
    motion = move(leg, rng, seconds=10.0)
    data = sample(motion, rng, 100.0)
    mechanism = leg2(lever_arm=leg.lever)
    signals = split_signals([data], mechanism, FitOptions())
    problem = LatentProblem(signals, mechanism, "average", Stage((0,), (0.0,), (0.0,), np.tile([-2.0, 2.0], (2, 1))))
    q = np.stack([data["q1_rad"], data["q2_rad"]], axis=-1)
    x = Latents(q, np.gradient(q, 0.01, axis=0), problem.torque.copy())
    known = np.zeros((problem.total, 2, 2))  # friction is known also where the joint rests
    return problem.with_stiction(known), State(x, leg.beta(), NOISE, np.zeros((9, 9)))


def objective(problem: LatentProblem, state: State) -> float:
    return problem.linearise(state.x, state.beta, state.noise).objective


def whole_steps(problem: LatentProblem, state: State, count: int) -> list[float]:
    """Objectives on the way of Gauss-Newton steps that are never shortened."""
    x, found = state.x, []
    for _ in range(count):
        point = problem.linearise(x, state.beta, state.noise)
        found.append(point.objective)
        x = x.moved(-eliminate(point.chain).solution(np.eye(point.chain.width)[0]))
    return found


def test_the_motion_converges_where_whole_steps_do_not(sticking: tuple[LatentProblem, State]) -> None:
    problem, start = sticking
    converged = converge_motion(problem, start, 60)
    least = objective(problem, converged)
    swinging = whole_steps(problem, start, 30)
    assert max(swinging[-10:]) - min(swinging[-10:]) > 5.0  # else there is nothing to settle here
    assert least < min(swinging) + 0.1


def test_the_motion_is_the_same_from_elsewhere_where_rest_is_allowed_for(sticking: tuple[LatentProblem, State]
                                                                         ) -> None:
    """Without what friction leaves open at rest, every reversal between two samples has a minimum of its own."""
    problem, start = sticking
    problem = problem.with_stiction(find_stiction(problem, start.x.v, start.beta, one_per_crossing=False))
    converged = converge_motion(problem, start, 100)
    shift = 1e-3 * np.random.default_rng(3).normal(size=(problem.total, problem.block))
    other = replace(start, x=converged.x.moved(shift))
    assert objective(problem, other) > 2.0 * objective(problem, converged)
    other = converge_motion(problem, other, 100)
    assert objective(problem, other) == pytest.approx(objective(problem, converged), abs=3.0)


def test_the_best_motion_is_kept_where_steps_run_out(sticking: tuple[LatentProblem, State]) -> None:
    problem, start = sticking
    before = objective(problem, start)
    found = [objective(problem, converge_motion(problem, start, limit)) for limit in (1, 2, 4, 8)]
    assert objective(problem, start) == before  # what a search begins at stays as it is
    assert before >= found[0] >= found[1] >= found[2] >= found[3]
