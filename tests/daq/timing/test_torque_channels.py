"""The second shunt against the drive: what was put into two synthetic channels comes back, within its interval."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from daq import Dataset
from daq.timing import compare_torque_channels

RATE_HZ, SECONDS = 200.0, 20.0


def channels(seed: int, gain: float, offset: float, delay_s: float, noise: float = 0.02) -> Dataset:
    """Command, current of a lagging drive, and both readings of it, at 200 Hz out of 10 kHz."""
    rng, fine = np.random.default_rng(seed), 10_000.0
    t = np.arange(0.0, SECONDS, 1.0 / fine)
    phases, hz = rng.uniform(0, 2 * np.pi, 8), rng.uniform(0.3, 4.0, 8)
    smooth = 0.2 * np.sin(2 * np.pi * hz[:, None] * t + phases[:, None]).sum(axis=0)
    command = smooth[(np.floor(t * 100.0) / 100.0 * fine).astype(int)]  # held for 10 ms
    lag = np.exp(-1.0 / (fine * 1e-3))
    acting = lfilter([1.0 - lag], [1.0, -lag], command)
    acting = uniform_filter1d(acting, round(fine / RATE_HZ))  # both read means: what is held does not fold over
    grid = np.arange(0.1, SECONDS - 0.1, 1.0 / RATE_HZ)
    drive = np.interp(grid, t, acting) + noise * rng.standard_normal(grid.size)
    second = offset + gain * np.interp(grid - delay_s, t, acting) + 0.25 * noise * rng.standard_normal(grid.size)
    return Dataset("r", RATE_HZ, grid, {"tau2_nm": drive, "tau2_shunt_nm": second,
                                        "tau2_cmd_nm": np.interp(grid, t, command)})


@pytest.mark.parametrize("gain, offset, delay_s", [(1.0, 0.0, 0.0), (1.07, 0.03, 0.002), (0.9, -0.1, -0.006),
                                                         (1.3, 0.0, 0.02)])
def test_gain_offset_and_delay_come_back(gain: float, offset: float, delay_s: float) -> None:
    found = compare_torque_channels(channels(3, gain, offset, delay_s))
    for figure, truth in ((found.gain, gain), (found.offset_nm, offset), (found.delay_s, delay_s)):
        assert abs(figure.value - truth) < 1.7 * figure.half
    assert found.gain.half < 0.01 and found.offset_nm.half < 0.004 and found.delay_s.half < 0.001


def test_intervals_hold_and_noise_biases_nothing() -> None:
    """Least squares would give a gain too small by the share of noise in the drive's channel, 10 % here."""
    found = [compare_torque_channels(channels(seed, 1.05, 0.02, 0.003, noise=0.13)) for seed in range(40)]
    figures = np.array([[(one.value, one.half) for one in (f.gain, f.offset_nm, f.delay_s)] for f in found])
    errors = np.abs(figures[..., 0] - [1.05, 0.02, 0.003])
    assert ((errors < figures[..., 1]).mean(axis=0) > 0.85).all()
    assert figures[:, 0, 0].mean() == pytest.approx(1.05, abs=0.005)


def test_gaps_are_left_out() -> None:
    data = channels(4, 1.07, 0.0, 0.0)
    data.columns["tau2_shunt_nm"][500:560] = np.nan
    data.columns["tau2_nm"][:30] = np.nan
    assert compare_torque_channels(data).gain.value == pytest.approx(1.07, abs=0.01)


def test_nothing_is_said_without_a_command_or_a_channel() -> None:
    data = channels(4, 1.07, 0.0, 0.0)
    still = replace(data, columns={**data.columns, "tau2_cmd_nm": np.zeros(len(data))})
    alone = replace(data, columns={k: v for k, v in data.columns.items() if k != "tau2_shunt_nm"})
    for one in (still, alone, data.part(slice(0, 300))):
        assert compare_torque_channels(one) is None
