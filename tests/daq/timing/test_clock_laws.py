"""A short run of the clock study: worst errors under the laws, and every error within the bound that is reported."""

import numpy as np
import pytest

from evidence.clock_laws import LAWS, Law, oscillator, reboot, simulate


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_errors_are_small_and_within_the_bound(law: Law) -> None:
    rng = np.random.default_rng(20)
    runs = [simulate(law, rng) for _ in range(40)]
    assert max(run.worst_s for run in runs) <= law.allowed_s
    assert all(run.worst_s < run.bound_s for run in runs)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_a_reboot_in_mid_run_keeps_within_the_bound(law: Law) -> None:
    rng = np.random.default_rng(21)
    assert all(run.worst_s < run.bound_s for run in (reboot(law, rng) for _ in range(15)))


def test_the_simulation_wraps_and_is_off_by_what_it_says() -> None:
    clock = oscillator(np.random.default_rng(3))
    t = np.array([0.0, 300.0])
    ticks = clock.tick_us(t)
    assert ticks[0] < 2**32
    rate = (ticks[1] - ticks[0]) / 300e6 - 1
    assert 30e-6 < abs(rate) < 210e-6
