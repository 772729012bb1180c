"""A long record's fit from an excerpt: the same answer in fewer steps, and no excerpt where none would do."""

from typing import Any

import numpy as np
from pytest import MonkeyPatch, mark

from daq import Dataset
from estimator import FitError, FitOptions, fit
from estimator.fitting import descend, motion_search, warm_start
from estimator.fitting.warm_start import LEAST, PARTS, excerpt
from estimator.likelihood import LatentProblem, Latents, State
from estimator.model import leg2
from estimator.signals import LEAST_SEGMENT, SignalSet, split_signals
from tests.support.mujoco_leg import Leg, random_leg, record

OPTIONS = FitOptions(sensors="imu")
LEG = Leg()
MECHANISM = leg2(lever_arm=LEG.lever)


def prepared(runs: list[Dataset]) -> tuple[LatentProblem, list[SignalSet], Latents]:
    """Problem, signals and a motion of `runs`: the knee's own, and none of the pivot."""
    signals = split_signals(runs, MECHANISM, OPTIONS)
    problem = LatentProblem(signals, MECHANISM, "linear")
    angle = problem.angles[:, 1:] * [[0.0, 1.0]]
    return problem, signals, Latents(angle, np.gradient(angle, 0.01, axis=0), problem.torque)


def still(samples: int, moved: slice, name: str = "run") -> Dataset:
    """A leg at rest but for some samples."""
    time = np.arange(samples) / 100.0
    q2 = np.zeros(samples)
    q2[moved] = np.sin(2.0 * np.pi * time[moved])
    zero = np.zeros(samples)
    return Dataset(name, 100.0, time, {"q2_rad": q2, "tau2_nm": q2, "gyro_radps": zero, "accel_x_mps2": zero,
                                       "accel_y_mps2": zero})


def test_the_moving_part_is_taken() -> None:
    ((number, where),) = excerpt(*prepared([still(4000, slice(2500, 3100))]))
    assert number == 0 and where.stop - where.start == 4000 // 8
    assert where.start >= 2450 and where.stop <= 3150


def test_short_records_and_short_segments_have_none() -> None:
    assert excerpt(*prepared([still(LEAST * PARTS - 1, slice(0, 900))])) == []
    pieces = [still(LEAST_SEGMENT - 10, slice(0, 50), f"run{i}") for i in range(40)]
    assert excerpt(*prepared(pieces)) == []
    both = [still(3000, slice(0, 900)), *pieces[:5]]
    assert [number for number, _ in excerpt(*prepared(both))] == [0]


def without_excerpt(monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(motion_search, "from_excerpt", lambda *_: None)


def test_the_answer_is_the_same_in_fewer_steps(monkeypatch: MonkeyPatch) -> None:
    rng = np.random.default_rng(911)
    leg = random_leg(rng)
    runs = [record(leg, rng, seconds=15, name=f"run{i}") for i in range(2)]
    mechanism = leg2(lever_arm=leg.lever)
    found = fit(runs, mechanism, OPTIONS)
    without_excerpt(monkeypatch)
    whole = fit(runs, mechanism, OPTIONS)
    assert found.converged and whole.converged
    assert found.iterations < whole.iterations
    assert np.max(np.abs(found.beta - whole.beta) / whole.std) < 0.15
    np.testing.assert_allclose(found.std, whole.std, rtol=0.01)


def test_an_excerpt_that_does_not_converge_is_left_alone(monkeypatch: MonkeyPatch) -> None:
    run = record(LEG, np.random.default_rng(5), seconds=15)
    monkeypatch.setattr(warm_start, "STEPS", 1)
    found = fit([run], MECHANISM, OPTIONS)
    without_excerpt(monkeypatch)
    np.testing.assert_array_equal(found.beta, fit([run], MECHANISM, OPTIONS).beta)


@mark.parametrize("limit", [0, 3], ids=["fails", "does not end"])
def test_a_search_that_leads_nowhere_begins_again_from_slow_motion(limit: int, monkeypatch: MonkeyPatch) -> None:
    """A geared leg with a tilted IMU ended in singular equations, blamed on its motion; from there it converges."""
    run, searches = record(LEG, np.random.default_rng(5), seconds=8), list[State]()
    usual = fit([run], MECHANISM, OPTIONS)

    def descended(problem: LatentProblem, state: State, *others: Any) -> State:
        searches.append(state)
        if len(searches) == 1 and not limit:
            raise FitError("the equations of the fit became singular")
        return descend(problem, state, *others, *[limit] * (len(searches) == 1))

    without_excerpt(monkeypatch)
    monkeypatch.setattr(motion_search, "descend", descended)
    found = fit([run], MECHANISM, OPTIONS)
    assert len(searches) == 2 and found.converged
    assert np.ptp(searches[1].x.q, axis=0)[0] < np.ptp(searches[0].x.q, axis=0)[0]
    assert np.max(np.abs(found.beta - usual.beta) / usual.std) < 1.0
