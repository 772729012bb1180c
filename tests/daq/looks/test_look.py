"""Looks at columns: each fault is named at its place, healthy columns are left alone."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from daq.dataset import Dataset
from daq.errors import InputError
from daq.looks import Look, look
from daq.looks.jumps import unwrapped
from daq.runs.counter import unwrapped_counter
from daq.runs.csv_run import RawTable
from daq.timing.resample import align_table

RATE_HZ = 200.0
T = np.arange(3000) / RATE_HZ


def motion(seed: int = 1, size: float = 1.2) -> np.ndarray:
    """(3000,) an angle [rad] of several tones with an encoder's noise."""
    rng = np.random.default_rng(seed)
    tones, phases = rng.uniform(0.4, 2.2, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    return size * np.mean(np.sin(2.0 * np.pi * np.outer(T, tones) + phases), axis=1) + 4e-4 * rng.normal(size=T.size)


def torque(seed: int = 2, noise: float = 0.01) -> np.ndarray:
    return 3.0 * motion(seed) + noise * np.random.default_rng(seed + 50).normal(size=T.size)


def seen(name: str, values: np.ndarray) -> Look:
    return look(T, {name: values})


def one_fault(name: str, values: np.ndarray) -> tuple[Any, Look]:
    found = seen(name, values)
    (fault,) = found.faults
    return fault, found


def test_healthy_columns_stay_as_they_are() -> None:
    columns = {"q1_rad": motion(), "q2_rad": np.round(motion(3) / 1.5e-3) * 1.5e-3, "tau2_nm": torque(),
               "tau1_nm": np.zeros(T.size), "gyro_radps": np.gradient(motion(4)) * RATE_HZ,
               "temperature_degc": np.round(25.0 + T)}
    found = look(T, columns)
    assert not found.faults and not found.left_out
    for name, values in columns.items():
        assert_array_equal(found.columns[name], values)


def with_neighbours(at: np.ndarray) -> np.ndarray:
    return np.asarray(at | np.append(at[1:], False) | np.append(False, at[:-1]))


@pytest.mark.parametrize("quantum", [0.0, 1e-3, 0.02])
@pytest.mark.parametrize("sides", [(-1.0, 1.0), (1.0,), (-1.0,)])
def test_a_clipped_torque_is_left_out(quantum: float, sides: tuple[float, ...]) -> None:
    whole = torque()
    level = float(np.quantile(np.abs(whole), 0.9))
    if quantum:
        level, whole = round(level / quantum) * quantum, np.round(whole / quantum) * quantum
    clipped = np.clip(whole, -level if -1.0 in sides else None, level if 1.0 in sides else None)
    fault, found = one_fault("tau2_nm", clipped)
    assert (fault.what, fault.done, fault.column) == ("clipped", "left_out", "tau2_nm")
    assert fault.size == pytest.approx(level)
    at = np.isin(clipped, [side * level for side in sides])
    for left_out in (np.isnan(found.columns["tau2_nm"]), found.left_out["tau2_nm"]):
        assert_array_equal(left_out, with_neighbours(at))
    assert sum(stop - start + 1 for start, stop in fault.rows) == at.sum()


def at_rest() -> np.ndarray:
    angle = np.round(motion() / 1.5e-3) * 1.5e-3
    angle[1000:1500] = angle[1000]
    angle[1500:] += angle[1000] - angle[1500]
    return angle


@pytest.mark.parametrize("name, values", [
    ("tau1_nm", np.where(np.sin(3.0 * T) > 0.0, 1.0, -1.0)), ("tau1_nm", np.round(2.0 * np.sin(T)) / 2.0),
    ("tau1_nm", np.round(np.sin(T) / 0.05) * 0.05), ("tau1_nm", np.maximum(np.sin(3.0 * T), 0.0)),
    ("tau2_cmd_nm", np.clip(torque(), -1.0, 1.0)), ("accel_x_mps2", np.round(0.3 * np.sin(2.0 * T) / 1e-3) * 1e-3),
    ("q1_rad", at_rest())], ids=["square wave", "staircase", "fine staircase", "motor that is off", "command",
                                 "slow sensor without noise", "joint at rest"])
def test_what_only_looks_like_a_fault_is_none(name: str, values: np.ndarray) -> None:
    assert not seen(name, values).faults


@pytest.mark.parametrize("low, modulus", [(-np.pi, 2 * np.pi), (0.0, 2 * np.pi), (-np.pi / 2, np.pi),
                                             (0.2, 2.0 * np.pi / 3.0)])
def test_a_wrapped_angle_is_unwrapped(low: float, modulus: float) -> None:
    angle = motion(size=4.0) + low
    wrapped = low + (angle - low) % modulus
    fault, found = one_fault("q2_rad", wrapped)
    assert fault.what == "wrapped" and fault.size == pytest.approx(modulus, rel=2e-3)
    turned = found.columns["q2_rad"] - angle
    assert np.ptp(turned) < 2e-3 * modulus * len(fault.rows)
    assert len(fault.rows) == np.sum(np.abs(np.diff(wrapped)) > 0.5 * modulus)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("size", [-2.6, 1.3, 3.4])
def test_a_reading_that_is_off_next_to_a_wrap_is_left_out(seed: int, size: float) -> None:
    """The wrap was then not undone: hundreds of samples were a turn off, and nothing said so."""
    rng = np.random.default_rng(seed)
    angle = motion(seed, size=4.0)
    low = float(rng.uniform(*np.quantile(angle, (0.1, 0.9))))
    wrapped = low + (angle - low) % (2.0 * np.pi)
    row = int(rng.choice(np.flatnonzero(np.abs(np.diff(wrapped)) > 3.0))) + int(rng.integers(-1, 3))
    wrapped[row] = low + (wrapped[row] - low + size) % (2.0 * np.pi)
    found = seen("q2_rad", wrapped)
    assert {fault.what for fault in found.faults} == {"wrapped", "isolated"}
    assert np.flatnonzero(np.isnan(found.columns["q2_rad"])).tolist() == [row]
    turned = found.columns["q2_rad"] - angle
    assert np.nanmax(turned) - np.nanmin(turned) < 1e-6


@pytest.mark.parametrize("length", [1, 2, 3])
@pytest.mark.parametrize("size", [0.4, -3.0, 100.0])
def test_readings_that_are_off_alone_are_left_out(length: int, size: float) -> None:
    angle = motion()
    angle[903:903 + length] += size
    fault, found = one_fault("q1_rad", angle)
    assert (fault.what, fault.rows) == ("isolated", ((904, 903 + length),))
    assert fault.size == pytest.approx(abs(size), rel=0.05)
    assert_array_equal(np.flatnonzero(np.isnan(found.columns["q1_rad"])), 903 + np.arange(length))
    assert "row" in str(fault) and "904" in str(fault)


@pytest.mark.parametrize("size", [0.3, -0.9])
def test_a_step_of_the_zero_is_told_and_left(size: float) -> None:
    angle = motion()
    stepped = angle + np.where(np.arange(T.size) >= 1600, size, 0.0)
    fault, found = one_fault("q1_rad", stepped)
    assert (fault.what, fault.rows, fault.done) == ("stepped", ((1601, 1601),), "kept")
    assert (fault.size, fault.time_s) == (pytest.approx(size, abs=4e-3), pytest.approx(T[1600]))
    assert_array_equal(found.columns["q1_rad"], stepped)


def test_a_pause_may_end_elsewhere() -> None:
    angle, behind = motion(), np.arange(T.size) >= 1600
    assert not look(T + 2.0 * behind, {"q1_rad": angle + 0.4 * behind}).faults


def test_a_stamp_next_to_a_pause_may_be_late() -> None:
    """As on a public record: the step in the readings comes one sample behind the pause in the stamps."""
    fast = 20.0 * T
    time = T + np.where(np.arange(T.size) >= 1600, 3.0 / RATE_HZ, 0.0)
    angle = np.sin(fast) + np.where(np.arange(T.size) >= 1602, 3.0 * 20.0 / RATE_HZ, 0.0)
    assert not look(time, {"q1_rad": angle}).faults


def test_a_sensor_that_hangs_is_left_out() -> None:
    gyro = np.gradient(motion()) * RATE_HZ + 0.1 * np.random.default_rng(3).normal(size=T.size)
    for name, values, start, stop in (("q1_rad", motion(size=3.0), 1020, 1080), ("gyro_radps", gyro, 500, 520)):
        values[start:stop] = values[start]
        fault, found = one_fault(name, values)
        assert (fault.what, fault.rows) == ("frozen", ((start + 2, stop),))
        assert found.left_out[name].sum() == stop - start - 1


@pytest.mark.parametrize("times", [2, 3, 5])
def test_repeats_of_a_slower_sensor_are_left_out(times: int) -> None:
    slow = motion(size=3.0)[::times].repeat(times)[:T.size]
    fault, found = one_fault("q1_rad", slow)
    assert (fault.what, fault.size) == ("repeated", times)
    assert np.isfinite(found.columns["q1_rad"]).sum() == len(range(0, T.size, times))
    run = align_table(RawTable("r", T, {"q1_rad": slow, "tau1_nm": torque()}), RATE_HZ)
    assert run.gap(["q1_rad"]).sum() < 10


@pytest.mark.parametrize("order", [np.arange(T.size) % 2, np.random.default_rng(5).integers(0, 2, T.size)])
def test_two_senders_in_turn_are_refused(order: np.ndarray) -> None:
    with pytest.raises(InputError, match="two series take turns") as told:
        look(T, {"q1_rad": np.where(order == 0, motion(), 2.0 + motion(7))}, "log.csv")
    assert "log.csv, column q1_rad" in str(told.value)


def test_an_encoder_that_jumps_all_the_time_is_refused() -> None:
    angle = motion() + np.cumsum(np.where(np.random.default_rng(8).random(T.size) < 0.01, 1.0, 0.0))
    with pytest.raises(InputError, match="times as no joint can"):
        look(T, {"q1_rad": angle})


def test_memory_that_nobody_wrote_to_is_zero() -> None:
    fault, found = one_fault("tau1_nm", -5.38e-310 * np.arange(T.size))
    assert fault.what == "denormal" and not found.columns["tau1_nm"].any()


def test_two_faults_in_one_column_are_both_found() -> None:
    angle = motion(size=4.0) % (2.0 * np.pi) - np.pi
    clear = int(np.argmin(np.abs(angle)))
    angle[clear] += 1.5
    assert [fault.what for fault in seen("q1_rad", angle).faults] == ["wrapped", "isolated"]


def aligned(rate_hz: float) -> Dataset:
    return align_table(RawTable("r", T, {"q1_rad": motion(), "tau1_nm": np.clip(torque(), -1.0, 1.0)}), rate_hz)


def test_a_flat_top_is_a_gap_on_every_grid() -> None:
    clipped = with_neighbours(np.abs(torque()) >= 1.0)
    run = aligned(RATE_HZ)
    assert_array_equal(run.gap(["tau1_nm"]), clipped)
    assert not run.gap(["q1_rad"]).any()
    assert [(flag.kind, fault.what) for flag, fault in zip(run.told, run.readings)] == [("readings", "clipped")]
    coarse = aligned(50.0)  # each a mean of four samples
    around = [clipped[np.abs(T - t) < 0.0101].any() for t in coarse.time_s]
    assert_array_equal(coarse.gap(["tau1_nm"]), around)
    fine = aligned(400.0)
    assert np.nanmax(np.abs(fine["tau1_nm"])) < 1.05


@pytest.mark.parametrize("modulus, period", [(2.0**32 * 1e-6, 0.004), (65.536, 0.01), (86400.0, 1.0)])
def test_a_counter_that_wraps_goes_on(modulus: float, period: float) -> None:
    time = modulus - 30.5 * period + period * np.arange(100)
    found = unwrapped_counter(np.asarray(time % modulus, np.float64))
    assert found.modulus == pytest.approx(modulus) and found.rows.tolist() == [31]
    assert_allclose(np.diff(found.time), period, rtol=1e-5)


def test_a_counter_in_its_own_unit_wraps_by_its_bits() -> None:
    ticks = (2.0**32 - 1e4 + 1000.0 * np.arange(50)) % 2.0**32
    assert unwrapped_counter(np.asarray(ticks, np.float64), 1e-6).modulus == 2.0**32


@pytest.mark.parametrize("time", [np.arange(50.0), np.append(np.arange(30.0), np.arange(10.0, 30.0)),
                                  np.random.default_rng(1).random(50)])
def test_times_that_increase_or_are_unsorted_are_no_counter(time: np.ndarray) -> None:
    assert unwrapped_counter(np.asarray(time, np.float64)) is None


def held(angle: np.ndarray, noise: float) -> np.ndarray:
    """It stands still for 1.5 s, and goes on from there."""
    out = angle.copy()
    out[1200:1500] = angle[1200] + noise * np.random.default_rng(1).normal(size=300)
    out[1500:] += out[1499] - out[1500]
    return out


def test_a_joint_that_stands_still_under_its_torque_is_left_out() -> None:
    angle, moment = motion(size=2.0), torque(5)
    blocked = held(angle, 4e-4)
    found = look(T, {"q1_rad": blocked, "tau1_nm": moment})
    (fault,) = found.faults
    assert fault.what == "standstill" and "tau1_nm swings as where the joint moves" in str(fault)
    ((first, last),) = fault.rows
    assert abs(first - 1200) < 60 and abs(last - 1500) < 60
    assert np.isnan(found.columns["q1_rad"][1260:1440]).all() and found.left_out["q1_rad"].sum() == last - first + 1
    assert not look(T, {"q1_rad": angle, "tau1_nm": moment}).faults


@pytest.mark.parametrize("share", [0.0, 0.4, 0.8])
def test_dry_friction_that_holds_a_joint_is_no_fault(share: float) -> None:
    """The torque stays below what moves the joint."""
    moment = torque(6)
    moment[1200:1500] *= share * np.quantile(np.abs(moment), 0.8) / np.abs(moment[1200:1500]).max()
    found = look(T, {"q1_rad": held(motion(size=2.0), 0.0), "tau1_nm": moment})
    assert "standstill" not in [fault.what for fault in found.faults]


def test_a_column_of_which_every_step_but_one_is_large_is_no_wrap() -> None:
    assert unwrapped(np.array([0.0, 5.0, -5.0, 5.0, -5.0, -5.0, 5.0, -5.0])) is None
