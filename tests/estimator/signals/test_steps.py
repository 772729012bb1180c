"""A walker's record cut into steps: by its contacts, or by the landings that its angles show."""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import MonkeyPatch, mark, raises

from daq import Dataset
from estimator import FitError, FitOptions
from estimator.model import biped3
from estimator.signals import cut_steps, find_touchdowns, split_signals
from tests.support.walker_plant import Gait, Plant, Sensors, Walk, Walker, record, roles, walk

OPTIONS = FitOptions(sensors="encoder")
EXACT = Sensors(0.0, 0.0, 0.0)


@cache
def walked(seed: int = 5, steps: int = 8) -> Walk:
    return walk(Plant(Walker()), Gait(), steps, default_rng(seed))


def noisy(seed: int, stance: bool, found: Walk | None = None) -> Dataset:
    return record("walk", found or walked(), default_rng(seed), stance=stance)


def test_each_step_is_a_segment_by_role() -> None:
    exact = record("walk", walked(), default_rng(0), EXACT)
    segments = split_signals([cut_steps(exact)[0]], biped3(hips=True), OPTIONS)
    true = roles(walked())
    assert len(segments) == len(true) == 8
    assert [s.exchanged for s in segments] == [k % 2 == 1 for k in range(8)]
    for s, (angle, _, torque) in zip(segments, true):
        skipped = len(angle) - len(s.time_s)  # at most the first sample after a touchdown
        assert skipped in (0, 1)
        assert_array_equal(s.angles, angle[skipped:])
        assert_array_equal(s.torque, torque[skipped:])


@mark.parametrize("rate_hz", [100.0, 200.0, 500.0])
def test_touchdowns_are_found_to_two_milliseconds(rate_hz: float) -> None:
    for seed in range(3):
        found = walk(Plant(Walker()), Gait(), 6, default_rng(seed), rate_hz, max(1, round(400 / rate_hz)))
        shown = find_touchdowns(noisy(seed, False, found))
        late = shown.time_s - found.touchdown_s[:5]  # the record ends as the sixth foot lands
        assert np.abs(late).max() < 0.002 and (np.abs(late) < shown.open_s + 1e-4).all()
        assert [*shown.leg] == [2, 1, 2, 1, 2]


def test_a_contact_that_is_late_costs_samples_and_no_more() -> None:
    found = walked()
    late = replace(found, stance=np.searchsorted(found.touchdown_s + 0.004, found.time_s) % 2 + np.float64(1.0))
    cut, _ = cut_steps(noisy(1, True, late), 0.005)
    for s in split_signals([cut], biped3(hips=True), OPTIONS):
        before = np.searchsorted(found.touchdown_s, s.time_s)
        assert (before == before[0]).all() and s.exchanged == bool(before[0] % 2)


def test_neither_leg_is_a_gap_and_a_smeared_contact_too() -> None:
    data = noisy(2, True)
    stance = data["stance"].copy()
    lands = np.flatnonzero(np.diff(stance))[0]
    stance[lands - 3 : lands + 3] = 0.0
    stance[50] = 1.4
    cut, found = cut_steps(replace(data, columns={**data.columns, "stance": stance}))
    assert np.isnan(cut["q2_rad"][lands - 3 : lands + 3]).all() and np.isnan(cut["q1_rad"][50])
    assert np.isfinite(cut["q2_rad"][[lands - 4, lands + 4, 49, 51]]).all() and found.time_s.size == 7


def test_what_cannot_be_cut_is_said() -> None:
    data = noisy(3, True)
    still = {name: values[0] + 1e-4 * default_rng(k).normal(size=len(data))
             for k, (name, values) in enumerate(data.columns.items()) if name != "stance"}
    for columns, said in (({**data.columns, "stance": data["stance"] + 1.0},
                           "walk: column stance holds other numbers than 0, 1 and 2"),
                          ({**data.columns, "stance": np.ones(len(data))}, "never changes from one leg to the other"),
                          (still, "no touchdown stands out")):
        with raises(FitError, match=said):
            cut_steps(replace(data, columns=columns))
    with raises(FitError, match="too short"):
        cut_steps(noisy(3, False).part(slice(0, 10)))


def test_a_landing_that_is_missing_is_said(monkeypatch: MonkeyPatch) -> None:
    """With a threshold that the weaker landings do not reach, one leg seems to land twice in a row."""
    monkeypatch.setattr("estimator.signals.steps.LEAST_SHARE", 0.9)
    with raises(FitError, match=r"leg [12] seems to land at .* s and again at .* s, the other one not between"):
        cut_steps(noisy(4, False))
