"""An effect at a leg's hip, whose joint changes with the leg that stands."""

import pickle
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimator import Effect, FitOptions
from estimator.effects import EncoderOffset, library, placed
from estimator.effects.end_stop_contact import EndStopContact
from estimator.effects.joint_stiffness import JointStiffness
from estimator.likelihood import Candidate, LatentProblem, Latents, Stage
from estimator.model import biped3
from estimator.signals import SignalSet, cut_steps, encoder_of, split_signals
from tests.support.walker_plant import Gait, Plant, Walker, record, walk

HIPS = biped3(hips=True)


@cache
def steps() -> list[SignalSet]:
    found = walk(Plant(Walker()), Gait(), 4, np.random.default_rng(1), 100.0, 4)
    data, _ = cut_steps(record("walk", found, np.random.default_rng(2)))
    return split_signals([data], HIPS, FitOptions(sensors="encoder"))


def problem(effects: list[Effect], candidates: list[Candidate] | None = None) -> tuple[LatentProblem, Latents]:
    count = len(steps())
    stage = Stage((0,) * count, (0.0,) * count, (0.0,) * count, np.array([[0.0, 1.0], [0.0, 1.0], [-0.5, 1.5]]))
    made = LatentProblem(steps(), HIPS, "zero", stage, effects, candidates or [])
    rate = np.concatenate([np.gradient(s.angles, 0.01, axis=0) for s in steps()])
    return made, Latents(np.concatenate([s.angles for s in steps()]), rate, np.concatenate([s.torque for s in steps()]))


def at(joint: int, kind: type[Effect]) -> Effect:
    return placed(kind, joint, HIPS)


def test_a_spring_of_leg_two_acts_where_that_leg_is() -> None:
    made, x = problem([at(2, JointStiffness)])
    extra = made.extra(x, np.concatenate([Walker().beta, [5.0, 0.0]]))
    exchanged = np.concatenate([np.full(len(s.time_s), s.exchanged) for s in steps()])
    assert exchanged.any() and not exchanged.all()
    taken = extra.torque_at_samples
    assert_allclose(np.abs(taken[2, ~exchanged]), np.abs(5.0 * x.q[~exchanged, 2]), rtol=1e-12)
    assert_allclose(np.abs(taken[1, exchanged]), np.abs(5.0 * x.q[exchanged, 1]), rtol=1e-12)
    assert not taken[0].any() and not taken[1, ~exchanged].any() and not taken[2, exchanged].any()


def test_an_encoder_of_leg_one_misreads_where_that_leg_is() -> None:
    made, x = problem([at(1, EncoderOffset)])
    readings = made.extra(x, np.append(Walker().beta, 0.01)).readings
    exchanged = np.concatenate([np.full(len(s.time_s), s.exchanged) for s in steps()])
    assert_array_equal(readings[encoder_of(1)], np.where(exchanged, 0.0, 0.01))
    assert_array_equal(readings[encoder_of(2)], np.where(exchanged, 0.01, 0.0))


def test_a_stop_is_at_one_angle_whichever_leg_stands() -> None:
    made, x = problem([])
    view = made.view(x, Walker().beta)
    torque = at(1, EndStopContact).perturb(view, np.array([10.0, 0.5])).torque_at_samples
    assert torque is not None
    pushed = np.abs(torque)
    angle = np.where(view.samples.exchanged == 0.0, x.q[:, 1], x.q[:, 2])
    assert (pushed.sum(axis=0)[angle > 0.8] > 0.1).all() and (pushed.sum(axis=0)[angle < 0.7] < 0.01).all()


@pytest.mark.parametrize("effect", library(HIPS, False)[0], ids=lambda e: e.key)
def test_all_of_the_library_is_scored_here_and_in_another_process(effect: Effect) -> None:
    shape = effect.grid()[0]
    made, x = problem([], [Candidate(effect, shape)])
    extra = made.extra(x, Walker().beta)
    assert np.isfinite(extra.torque_columns).all() and np.isfinite(extra.sample_columns).all()
    copy = pickle.loads(pickle.dumps(effect))
    one, other = ((e.key, type(e).__name__, [h.joint for h in getattr(e, "halves", ())]) for e in (copy, effect))
    assert one == other
    again = problem([], [Candidate(copy, shape)])[0].extra(x, Walker().beta)
    assert_array_equal(again.torque_columns, extra.torque_columns)


def test_what_makes_no_sense_on_a_walker_is_refused_with_its_reason() -> None:
    found, refused = library(HIPS, False)
    keys = {e.key for e in found}
    assert {"joint_stiffness@2", "joint_stiffness@3", "encoder_offset@1", "encoder_offset@3", "torque_offset@2"} <= keys
    assert "elsewhere at every step" in refused["base_compliance"]
    assert "torso against the vertical" in refused["quadratic_drag@1"]
    assert "quadratic_drag@1" in {e.key for e in library(biped3(), False)[0]}
