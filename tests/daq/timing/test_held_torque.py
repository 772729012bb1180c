"""The torque between samples at instants: the response that made it is found, and white noise stays white."""

import numpy as np
import pytest

from daq.timing import TimedColumns, align_channels
from daq.timing.held_torque import commanded_torque, find_response, split_torque

DELAY_S, LAG_S = 0.0006, 0.0011
SENT_S = np.asarray(0.2 + np.arange(1000) * 0.01, float)
SENT_NM = 0.5 * np.sin(2 * np.pi * 1.5 * SENT_S) + 0.2 * np.sin(2 * np.pi * 2.9 * SENT_S)


def samples(rate_hz: float, noise_nm: float, gain: float = 1.0, seed: int = 0) -> TimedColumns:
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(10.0 * rate_hz)) / rate_hz + rng.uniform(0.0, 1e-4, round(10.0 * rate_hz))
    torque, _ = commanded_torque(time_s, SENT_S, SENT_NM, DELAY_S, LAG_S)
    return TimedColumns(time_s, {"tau2_nm": gain * torque + noise_nm * rng.standard_normal(time_s.size)})


def test_the_commanded_torque_is_the_staircase_behind_delay_and_lag() -> None:
    fine = np.arange(0.0, 2.0, 1e-5)
    torque, area = commanded_torque(fine, SENT_S, SENT_NM, DELAY_S, LAG_S)
    stair = np.where(fine < SENT_S[0] + DELAY_S, 0.0,
                     SENT_NM[np.clip(np.searchsorted(SENT_S + DELAY_S, fine, side="right") - 1, 0, None)])
    stepped = np.zeros_like(fine)
    for k in range(1, fine.size):
        stepped[k] = stair[k - 1] + (stepped[k - 1] - stair[k - 1]) * np.exp(-1e-5 / LAG_S)
    np.testing.assert_allclose(torque, stepped, atol=1e-3)
    np.testing.assert_allclose(np.diff(area), 0.5 * (torque[1:] + torque[:-1]) * 1e-5, atol=2e-7)
    at_once, _ = commanded_torque(fine, SENT_S, SENT_NM, 0.0, 0.0)
    assert at_once[np.searchsorted(fine, SENT_S[3] + 1e-6)] == SENT_NM[3]


@pytest.mark.parametrize("rate_hz", [250.0, 500.0])
def test_delay_lag_and_gain_are_found(rate_hz: float) -> None:
    made = samples(rate_hz, 0.005, gain=1.03)
    found = find_response(made.time_s, made.columns["tau2_nm"], SENT_S, SENT_NM)
    assert found.delay_s + found.lag_s == pytest.approx(DELAY_S + LAG_S, abs=3e-4)
    assert found.gain == pytest.approx(1.03, abs=0.02)


@pytest.mark.parametrize("rate_hz", [250.0, 500.0])
def test_the_mean_of_each_step_of_the_grid_is_right_and_its_noise_white(rate_hz: float) -> None:
    made = samples(rate_hz, 0.02, seed=1)
    split = split_torque(made, SENT_S, SENT_NM)
    run = align_channels("x", [split.commanded], 250.0)
    measured = run["tau2_nm"] + split.residual_on(run.time_s, 0.004)
    area = [commanded_torque(run.time_s + shift, SENT_S, SENT_NM, DELAY_S, LAG_S)[1] for shift in (-0.002, 0.002)]
    error = measured - (area[1] - area[0]) / 0.004
    assert error.std() == pytest.approx(0.02 / np.sqrt(rate_hz / 250.0), rel=0.1)
    imu = TimedColumns(np.arange(0.0, 10.0, 0.002), {"gyro_radps": np.zeros(5000)})
    straight = align_channels("x", [imu, made], 250.0)
    away = straight["tau2_nm"] - np.interp(straight.time_s, run.time_s, measured - error)
    assert abs(_correlation(error)) < 0.06 < 0.1 < _correlation(away)  # a straight line shares samples between steps


def _correlation(error: np.ndarray) -> float:
    """Of neighbours."""
    inner = error[5:-5] - error[5:-5].mean()
    return float(np.mean(inner[1:] * inner[:-1]) / np.mean(inner**2))


def test_a_grid_that_is_finer_than_the_samples_has_a_residual_everywhere() -> None:
    split = split_torque(samples(250.0, 0.005), SENT_S, SENT_NM)
    grid = np.linspace(0.5, 4.499, 4000)
    assert split.residual_on(grid, 0.001) == pytest.approx(np.interp(grid, split.time_s, split.residual_nm))


def test_a_gap_of_the_samples_stays_a_gap() -> None:
    made = samples(500.0, 0.005)
    kept = (made.time_s < 4.0) | (made.time_s > 4.1)
    split = split_torque(TimedColumns(made.time_s[kept], {"tau2_nm": made.columns["tau2_nm"][kept]}), SENT_S, SENT_NM)
    centres, torque = split.commanded.time_s, split.commanded.columns["tau2_nm"]
    assert np.isnan(torque[(centres > 4.001) & (centres < 4.099)]).all()
    assert np.isfinite(torque[(centres < 3.99) | (centres > 4.11)]).all()


def test_commands_that_the_drive_did_not_follow_explain_nothing() -> None:
    made = samples(500.0, 0.02)
    noise = 0.02 * np.random.default_rng(3).standard_normal(made.time_s.size)
    alone, few = (TimedColumns(made.time_s[:n], {"tau2_nm": noise[:n]}) for n in (noise.size, 20))
    for given in ((alone, SENT_S, SENT_NM), (made, SENT_S, np.zeros_like(SENT_NM)), (few, SENT_S, SENT_NM),
                  (made, SENT_S[:0], SENT_NM[:0])):
        assert split_torque(*given) is None
