"""Policies of the Gauss-Newton loop, on steps that are written down."""

import numpy as np
import pytest

from estimator.fitting.damping import REACH_RAD, SHORTEST, FallDamping, SwingDamping, shortened
from estimator.fitting.newton_step import NewtonStep
from estimator.fitting.stopping import LOOSE_AFTER, SmallFall, SmallSteps
from estimator.likelihood import Latents

LATE = 5
"""An iteration after the free ones."""


def step(*beta: float, fall: float = 1.0) -> NewtonStep:
    count = len(beta)
    return NewtonStep(np.zeros((4, 3)), np.array(beta), np.eye(count), np.eye(count), fall)


def motion(angle: float = 0.0) -> Latents:
    return Latents(*(np.full((4, 1), angle) for _ in range(3)))


def test_parameters_that_go_to_and_fro_halve_the_step_and_steady_ones_lengthen_it() -> None:
    damping = SwingDamping()
    shares = [damping.next(i, 1.0, step((-1.0) ** i, 0.1), False) for i in range(8)]
    assert shares == [1.0, 1.0, 1.0, 0.5, 0.25, 0.125, SHORTEST, SHORTEST]
    assert damping.next(8, 1.0, step(-1.0, 0.1), False) == pytest.approx(1.2 * SHORTEST)


def test_a_risen_objective_halves_the_step_unless_the_weights_are_others() -> None:
    for anew, expected in ((False, 0.5), (True, 1.0)):
        damping = SwingDamping(before=np.ones(1))
        damping.next(LATE, 1.0, step(1.0), False)
        damping.next(LATE + 1, 2.0, step(1.0), anew)  # with other weights 2 is no rise of what was 1 ...
        assert damping.lowest == (2.0 if anew else 1.0)
        damping.share = 1.0
        assert damping.next(LATE + 2, 2.0, step(1.0), False) == expected  # ... nor in the next step


def test_motion_that_no_step_lowers_ends_its_search() -> None:
    damping = FallDamping()
    shares = [damping.next(i, float(i), step(), False) for i in range(LATE + 3)]
    assert shares == [1.0, 1.0, 1.0, 0.5, 0.25, 0.125, SHORTEST, 0.0]
    damping = FallDamping()
    assert all(damping.next(i, float(i), step(), True) == 1.0 for i in range(LATE + 3))


def test_no_angle_moves_further_than_a_linearisation_reaches() -> None:
    angles = np.array([[0.1], [-2.0]])
    assert shortened(angles, 1.0) * 2.0 == pytest.approx(REACH_RAD)
    assert shortened(angles, 0.2) == 0.2


def test_a_fit_ends_with_two_small_steps_at_constant_noise() -> None:
    assert not SmallSteps().after(1, 0.01, 1.0, 0.0)
    stop = SmallSteps()
    ends = [stop.after(i, moved, 1.0, change) for i, (moved, change) in enumerate(
        [(0.01, 0.0), (0.01, 0.2), (0.01, None), (0.2, 0.0), (0.01, 0.0), (0.01, 0.0)])]
    assert ends == [False] * 5 + [True]
    assert SmallSteps(rough=True).after(1, 0.4, 1.0, 0.05)


def test_after_many_steps_a_larger_one_and_a_risen_objective_will_do() -> None:
    for first, expected in ((1, False), (LOOSE_AFTER, True)):
        stop = SmallSteps()
        assert [stop.after(first + i, 0.1, 1.0 + i, 0.0) for i in range(2)] == [False, expected]


def test_the_best_motion_is_kept_under_the_same_weights_only() -> None:
    stop = SmallFall(motion(), 20)
    for k, (objective, anew) in enumerate([(5.0, False), (3.0, False), (4.0, False)]):
        assert not stop.before(k, motion(objective), objective, anew)
    assert stop.best.q[0, 0] == 3.0
    assert not stop.before(3, motion(9.0), 9.0, True)
    assert stop.best.q[0, 0] == 9.0
    assert not stop.before(4, motion(8.99), 8.99, False)
    assert stop.before(5, motion(8.98), 8.98, False)  # the second fall that changes nothing
    assert SmallFall(motion(), 2).before(2, motion(), 1.0, False)  # the steps have run out


def test_a_promise_of_nothing_ends_a_search_of_the_motion() -> None:
    stop = SmallFall(motion(), 20)
    assert stop.at(step(fall=0.01), False)
    assert not stop.at(step(fall=0.01), True)
    assert not stop.at(step(fall=1.0), False)
