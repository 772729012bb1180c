"""Twenty steps in one fit, and free runs across touchdowns, on a plant that shares nothing with the estimator."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.random import default_rng

from estimator import FitOptions, fit
from estimator.model import biped3
from estimator.prediction import FittedModel, smooth, walk_ahead
from estimator.prediction.walking import Walking, carry, walking
from estimator.signals import cut_steps
from tests.support.walker_plant import Gait, Plant, Sensors, Walk, Walker, record, roles, walk

HIPS = biped3(hips=True)
NOISE = {"torque_nm": 0.3, "passive_nm": 0.05, "encoder1_rad": 2e-3, "encoder_rad": 2e-4}
OPTIONS = FitOptions(sensors="encoder", hold="zero", noise=NOISE)


@cache
def walked() -> Walk:
    return walk(Plant(Walker()), Gait(), 20, default_rng(5))


@pytest.mark.parametrize("stance", [True, False])
def test_twenty_steps_have_one_beta(stance: bool) -> None:
    data, found = cut_steps(record("walk", walked(), default_rng(1), stance=stance))
    result = fit([data], HIPS, OPTIONS)
    error = result.beta - Walker().beta
    assert result.converged and not result.undetermined and found.time_s.size == 19
    assert np.abs(error / result.std).max() < 4.0
    assert np.abs(error / Walker().beta).max() < 0.01


def test_legs_that_do_not_change_places_are_no_walker() -> None:
    """The same record with the hips left where they are: the fit cannot be near."""
    data = record("walk", walked(), default_rng(1))
    wrong = replace(cut_steps(data)[0], columns={**cut_steps(data)[0].columns, **{
        name: np.where(np.isnan(cut_steps(data)[0][name]), np.nan, data[name]) for name in ("q2_rad", "q3_rad")}})
    result = fit([wrong], HIPS, OPTIONS)
    assert np.abs(result.beta / Walker().beta - 1.0).max() > 0.3


def exact() -> tuple[Walking, np.ndarray, np.ndarray]:
    data, _ = cut_steps(record("walk", walked(), default_rng(0), Sensors(0.0, 0.0, 0.0), stance=True))
    true = roles(walked())
    return walking(data, HIPS), np.concatenate([q for q, *_ in true]), np.concatenate([v for _, v, _ in true])


def test_a_free_run_goes_over_touchdowns() -> None:
    """From the true state under the true torques, where the touchdowns are the true ones, it is the plant's motion: an
    error grows 30 to 50 times a step, and the two integrators differ by 1e-8 in the first."""
    record_, q, v = exact()
    record_ = record_._replace(touchdown_s=walked().touchdown_s[: len(record_.touchdown_s)])
    found = carry(record_, HIPS, Walker().beta, "zero", (0, int(record_.first[3])), q[0], v[0])
    for steps, most in ((1, 1e-7), (2, 1e-5), (3, 1e-3)):
        stop = int(record_.first[steps - 1])
        assert np.abs(found[:stop] - q[:stop]).max() < most


def test_without_the_impact_it_is_another_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    record_, q, v = exact()
    monkeypatch.setattr("estimator.prediction.walking.land", lambda m, b, q, v: (q[[0, 2, 1]], v[[0, 2, 1]]))
    stop = int(record_.first[1]) - 1
    found = carry(record_, HIPS, Walker().beta, "zero", (0, stop), q[0], v[0])
    assert not np.abs(found - q[:stop]).max() < 0.1


def test_a_walker_that_falls_has_no_error() -> None:
    data, _ = cut_steps(record("walk", walked(), default_rng(1)))
    weak = Walker().beta * np.array([1, 1, 1, 1, 1, 1.02, 1, 1])
    found = walk_ahead([(data, smooth(FittedModel(HIPS, "zero", weak), data, OPTIONS))])
    last = found.ahead[-1]
    assert last.fell == last.pieces and np.isnan(last.rmse).all()
    first = found.ahead[0]
    assert first.fell < first.pieces == 20 and (first.rmse > 0.0).all()
    run = found.whole[0]
    assert run.fell_s is not None and 0.5 < run.fell_s < 6.0 and 1 <= run.fell_step <= 6
