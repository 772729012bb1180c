"""Channels of a chain of more than nine joints, and one subtraction of what effects add to the torque's reading."""

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx, mark

from estimator import Effect
from estimator.effects import classes
from estimator.likelihood import LatentProblem, Latents, Noise, Stage, effective_samples
from estimator.model import chain
from estimator.signals import Channel, SignalSet, torque_of

LINKS, COUNT = 11, 40
NAMED = {kind.name: kind for kind in classes()}


def problem_of(effect: Effect, rng: Generator) -> tuple[LatentProblem, Latents, np.ndarray, Noise]:
    m = chain(LINKS)
    signals = SignalSet("run", 100.0, np.arange(COUNT) / 100.0, 0.1 * rng.normal(size=(COUNT, LINKS)),
                        0.1 * rng.normal(size=(COUNT, LINKS)), {})
    stage = Stage((0,), (0.0,), (0.0,), np.tile([-1.0, 1.0], (LINKS, 1)))
    problem = LatentProblem([signals], m, "linear", stage, [effect])
    diagonal = np.array([p.term == "inertia" and p.at[0] == p.at[1] for p in m.parameters])
    beta = np.concatenate([np.where(diagonal, 1.0, 0.01), np.full(effect.count, 0.02)])
    x = Latents(*(0.1 * rng.normal(size=(COUNT, LINKS)) for _ in range(3)))
    return problem, x, beta, Noise(np.full(LINKS, 0.05), np.full(LINKS, 1e-3))


@mark.parametrize("name, joint", [("torque_offset", None), ("encoder_offset", 10), ("joint_elasticity", 9)])
def test_a_chain_of_eleven_joints_keeps_its_channels_apart(name: str, joint: int | None) -> None:
    """What a step foresees of every residual is what the moved point has; joint 11 is not joint 1."""
    rng = default_rng(4)
    problem, x, beta, noise = problem_of(NAMED[name](joint), rng)
    point = problem.linearise(x, beta, noise)
    step = 1e-6 * rng.normal(size=(COUNT, problem.block))
    index = np.arange(problem.mechanism.p, beta.size)
    move = 1e-6 * rng.normal(size=index.size)
    predicted = problem.residuals_after(point, step, move, index)
    shifted = beta.copy()
    shifted[index] += move
    there = problem.linearise(x.moved(step), shifted, noise).residuals
    for kind in ("torque", "encoder"):
        change = there[kind] - point.residuals[kind]
        assert np.abs(change).max(axis=0).min() > 1e-7
        assert predicted[kind] - point.residuals[kind] == approx(change, rel=1e-3, abs=1e-9)
    taken = effective_samples(problem, point, np.broadcast_to(np.eye(problem.block), (COUNT, 33, 33)), noise)
    assert taken["torque"][0] == approx(np.full(LINKS, COUNT / 0.05**2))


def test_what_effects_add_to_torques_is_taken_off_once_for_every_joint() -> None:
    problem, x, beta, _ = problem_of(NAMED["torque_offset"](None), default_rng(5))
    found = problem.torque_readings(x, beta)
    assert found == approx(np.tile([0.0] + [0.02] * (LINKS - 1), (COUNT, 1)))
    assert str(torque_of(10)) == "torque11" and Channel("torque", 10) in problem.extra(x, beta).readings
