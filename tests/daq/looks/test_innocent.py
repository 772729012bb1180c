"""A reading is innocent: motions that a joint can make stay as they are, and only what none can make is left out."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from daq.dataset import Dataset
from daq.looks import Look, look
from daq.runs.csv_run import RawTable
from daq.timing.resample import align_table
from tests.support.motions import MOTIONS, healthy, pendulum


@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize("rate_hz, encoder", [(10.0, "fine"), (50.0, "hobby"), (100.0, "2400 counts")])
def test_what_a_joint_can_do_is_no_fault(kind: str, rate_hz: float, encoder: str) -> None:
    time_s, columns = healthy(kind, rate_hz, encoder, 1, 16.0)
    found = look(time_s, columns)
    if kind == "whirl, wrapped":
        fast = rate_hz < 20.0  # too fast for its samples: nothing says which way it turned
        assert [fault.what for fault in found.faults] == ["wrapped"] * (not fast)
        return
    assert not found.faults
    for name, values in columns.items():
        assert_array_equal(found.columns[name], values)


@pytest.mark.parametrize("rate_hz, friction, rest_s", [(20.0, 0.45, 60.0), (30.0, 0.2, 300.0), (8.0, 0.6, 30.0)])
def test_a_swing_that_rests_for_long_is_one_series(rate_hz: float, friction: float, rest_s: float) -> None:
    """No scale of it is a median: at rest that is zero."""
    time = np.arange(0.0, 14.0, 1.0 / rate_hz)
    swing = pendulum(time, lambda t: 0.0, 1.9, 0.0, (friction, 0.5), 40.0)
    angle = np.round(np.append(swing, np.full(round(rest_s * rate_hz), swing[-1])) * 1200.0 / np.pi) * np.pi / 1200.0
    found = look(np.arange(angle.size) / rate_hz, {"q1_rad": angle})
    assert not found.faults and np.array_equal(found.columns["q1_rad"], angle)


@pytest.mark.parametrize("small, speed", [(1.0, 12.0), (0.05, 30.0), (2.5, 4.0)])
def test_a_joint_that_later_turns_on_and_on_did_not_stand_still(small: float, speed: float) -> None:
    time = np.arange(3000) / 200.0
    angle = small * np.sin(2.0 * np.pi * 0.8 * time) + np.where(time > 5.0, speed * (time - 5.0) ** 2 / 2.0, 0.0)
    torque = np.sin(2.0 * np.pi * 0.8 * time) + 0.05 * np.random.default_rng(1).normal(size=time.size)
    assert not look(time, {"q1_rad": angle, "tau1_nm": torque}).faults


def test_a_drive_may_hold_a_joint_while_another_moves() -> None:
    time = np.arange(4000) / 200.0
    other = np.sin(2.0 * np.pi * 0.7 * time)
    held = np.where((time > 6.0) & (time < 12.0), 0.3, 0.3 + 0.4 * np.sin(2.0 * np.pi * 0.5 * (time - 6.0)))
    columns = {"q1_rad": held, "tau1_nm": 2.0 * np.sin(5.0 * time), "q2_rad": other, "tau2_nm": 3.0 * other}
    assert not look(time, columns).faults


def lossy(value: float, rows: list[tuple[int, int]], rate_hz: float, push: float
          ) -> tuple[np.ndarray, np.ndarray, Look]:
    """A driven pendulum whose encoder reads `value` in `rows`: its angle, what is in the wrong rows, and the look."""
    time = np.arange(round(15.0 * rate_hz)) / rate_hz
    torque = 2.5 * np.sin(2.0 * np.pi * 0.45 * time) + 2.0 * np.sin(2.0 * np.pi * 0.83 * time + 1.0) + push
    angle = pendulum(time, lambda t: np.interp(t, time, torque) / 0.3, 0.4, 0.0, (0.4 / 0.3, 0.0), 4.0 / 0.3)
    angle = np.round(angle / 4e-4) * 4e-4
    wrong = np.isin(np.arange(time.size), np.concatenate([np.arange(*row) for row in rows]))
    return angle, wrong, look(time, {"q1_rad": np.where(wrong, value, angle), "tau1_nm": torque})


@pytest.mark.parametrize("value, rows, rate_hz, push", [
    (0.0, [(300, 304), (900, 909), (1700, 1722)], 250.0, 2.0),
    (-1.0, [(120, 125), (430, 438), (1010, 1040)], 100.0, 9.0),
    (3.2768, [(77, 84), (500, 506), (660, 669)], 60.0, 0.0)])
def test_readings_lost_for_moments_are_left_out_and_nothing_behind_them_moves(
        value: float, rows: list[tuple[int, int]], rate_hz: float, push: float) -> None:
    angle, wrong, found = lossy(value, rows, rate_hz, push)
    assert {fault.what for fault in found.faults} <= {"isolated", "frozen"}
    assert_array_equal(found.columns["q1_rad"], np.where(wrong, np.nan, angle))
    places = sorted(place for fault in found.faults for place in fault.rows)
    assert places == [(start + 1, stop) for start, stop in rows]


def table(as_read: bool) -> Dataset:
    time, columns = healthy("driven", 100.0, "fine", 3)
    angle = columns["q1_rad"].copy()
    angle[500], angle[900:907] = angle[500] + 3.0, 9.9
    return align_table(RawTable("r", time, {"q1_rad": angle, "tau1_nm": np.clip(columns["tau1_nm"], -20.0, 20.0)}),
                       100.0, as_read)


def test_as_read_alters_nothing_and_tells_all() -> None:
    repaired, as_read = table(False), table(True)
    assert not as_read.gap().any() and repaired.gap().any()
    assert [fault.what for fault in as_read.readings] == [fault.what for fault in repaired.readings] != []
    assert all(fault.done == "kept" and str(fault).endswith(". Left as read") for fault in as_read.readings)
    assert as_read["q1_rad"][903] == pytest.approx(9.9) and np.abs(as_read["tau1_nm"]).max() == 20.0


def test_as_read_takes_what_is_refused_otherwise() -> None:
    time, columns = healthy("driven", 100.0, "fine", 4)
    mixed = np.where(np.arange(time.size) % 2, columns["q1_rad"], columns["q1_rad"] + 9.0)
    found = look(time, {"q1_rad": mixed}, as_read=True)
    (fault,) = found.faults
    assert "two series take turns" in str(fault) and fault.done == "kept"
    assert_array_equal(found.columns["q1_rad"], mixed)


@pytest.mark.parametrize("rate_hz, seconds", [(20.0, 2.6), (50.0, 1.5), (200.0, 4.0)])
def test_a_rate_that_was_made_from_an_angle_is_zero_at_rest(rate_hz: float, seconds: float) -> None:
    """As in a public record: velocities that a log computed, with a rest before a release."""
    time = np.arange(round(20.0 * rate_hz)) / rate_hz
    rate = 3.0 * np.sin(5.0 * (time - seconds)) * np.exp(-0.1 * time) + 0.05 * np.random.default_rng(1).normal(
        size=time.size)
    assert not look(time, {"gyro_radps": np.where(time > seconds, rate, 0.0)}).faults


@pytest.mark.parametrize("flip", [3.065, 2.9, 1.4])
def test_an_angle_is_unwrapped_by_nothing_but_a_turn(flip: float) -> None:
    """Roll and pitch of an attitude flip by other angles."""
    time = np.arange(2000) / 100.0
    angle = 0.03 * np.sin(time) + np.where((time % 4.0) < 2.0, flip, 0.0)
    found = look(time, {"q1_rad": angle}, as_read=True)
    assert not {fault.what for fault in found.faults} & {"wrapped"}


def test_a_servo_that_starts_late_is_not_blocked() -> None:
    """As in public records: it stands for 0.2 s in steps of a degree, under the current that later moves it."""
    rng, time = np.random.default_rng(4), np.arange(370) / 75.0
    angle = np.round(152.0 - np.maximum(time - 0.2, 0.0) * 30.0 + 0.3 * rng.normal(size=time.size)) * np.pi / 180.0
    assert not look(time, {"q1_rad": angle, "tau1_nm": rng.choice([0.05, 0.07, 0.1, 0.25], time.size)}).faults
