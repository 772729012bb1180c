"""Clock synchronisation against simulated links and oscillators whose true times are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from daq.runs.streams import CLOCK
from daq.timing import fit_samples, fit_ticks
from tests.support.drained import drained

EPOCH = 5_000_000_000_000


def probes(rng: np.random.Generator, seconds: float, ppm: float, delay_s: float, jitter_s: float,
           first_tick: int = 0, drift_ppm: float = 0.0) -> NDArray[np.void]:
    """Pings at 4 Hz: exponential jitter on each way, 1 % stalls to 20 ms on the way back."""
    sent = np.arange(0.0, seconds, 0.25)
    down, up = delay_s + rng.exponential(jitter_s, (2, sent.size))
    up += np.where(rng.random(sent.size) < 0.01, rng.uniform(0, 0.02, sent.size), 0.0)
    out, left = np.zeros(sent.size, CLOCK.dtype), sent + down + 60e-6
    for name, t in (("host_tx_ns", sent), ("host_rx_ns", left + up)):
        out[name] = EPOCH + np.rint(t * 1e9)
    for name, t in (("rx_tick_us", sent + down), ("tx_tick_us", left)):
        out[name] = (first_tick + tick(t, ppm, drift_ppm, seconds)) % 2**32
    return out


def tick(t: NDArray[np.float64], ppm: float, drift_ppm: float, seconds: float) -> NDArray[np.int64]:
    """Controller's clock [us] at host time t [s]; its rate moves by `drift_ppm` over the run."""
    return np.floor((t * (1 + ppm * 1e-6) + 0.5e-6 * drift_ppm * t**2 / seconds) * 1e6).astype(np.int64)


@pytest.mark.parametrize("delay_s, jitter_s, allowed_s", [
    (0.5e-3, 0.3e-3, 150e-6), (0.1e-3, 0.06e-3, 40e-6), (60e-6, 30e-6, 25e-6)], ids=["USB serial", "USB-ACM", "CAN"])
@pytest.mark.parametrize("seed", range(3))
def test_ticks_of_five_minutes(delay_s: float, jitter_s: float, allowed_s: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    clock = fit_ticks(probes(rng, 300.0, 40.0, delay_s, jitter_s, drift_ppm=2.0), EPOCH)
    t = np.linspace(0.0, 300.0, 5001)
    error = np.abs(clock.host_ns(tick(t, 40.0, 2.0, 300.0) % 2**32, t * 1e9 + 2e6) * 1e-9 - t).max()
    assert error < allowed_s and error < clock.bound_s < 3 * (delay_s + jitter_s)
    assert clock.rate_ppm == pytest.approx(41.0, abs=0.5)


def test_ticks_wrap_and_arrivals_may_be_late() -> None:
    first = 2**32 - 20_000_000  # wraps 20 s into the run
    clock = fit_ticks(probes(np.random.default_rng(1), 60.0, -25.0, 1e-4, 5e-5, first), EPOCH)
    t = np.linspace(0.0, 60.0, 601)
    late = np.where(np.arange(601) % 7 == 0, 3e9, 0.0)
    ticks = (first + tick(t, -25.0, 0.0, 60.0)) % 2**32
    assert ticks.min() < 10**8 < 2**31 < ticks.max()
    assert_allclose(clock.host_ns(ticks, t * 1e9 + late) * 1e-9, t, atol=50e-6)


@pytest.mark.parametrize("seconds", [0.25, 0.6, 1.5, 5.0, 20.0])
def test_short_runs_stay_within_their_bound(seconds: float) -> None:
    for seed in range(20):
        clock = fit_ticks(probes(np.random.default_rng(seed), seconds, 40.0, 2e-4, 1e-4), EPOCH)
        t = np.linspace(0.0, seconds, 50)
        error = clock.host_ns(tick(t, 40.0, 0.0, seconds) % 2**32, t * 1e9) * 1e-9 - t
        assert np.abs(error).max() < clock.bound_s + 20e-6


def drains(rng: np.random.Generator, seconds: float, rate_hz: float, warm_up: float = 0.0
           ) -> tuple[NDArray[np.void], NDArray[np.float64]]:
    """Samples of a chip whose rate sinks by the share `warm_up` within the first minutes, and their true times."""
    grid = np.arange(int(seconds * rate_hz)) / rate_hz
    true = grid + warm_up * 60.0 * (grid / 60.0 - 1 + np.exp(-grid / 60.0)) + 1e-3
    out = drained(rng, true, 0.0103, seconds, EPOCH)
    return out, true[:out.size]


@pytest.mark.parametrize("seconds, rate, warm_up, allowed_s", [
    (10.0, 241.0, 0.0, 150e-6), (60.0, 233.5, 0.0, 100e-6), (300.0, 241.0, 1e-3, 150e-6), (20.0, 961.0, 0.0, 100e-6)])
def test_samples_are_timed_by_the_drains(seconds: float, rate: float, warm_up: float, allowed_s: float) -> None:
    samples, true = drains(np.random.default_rng(4), seconds, rate, warm_up)
    clock = fit_samples(samples, EPOCH)
    error = np.abs(clock.time_ns * 1e-9 - true).max()
    assert error < allowed_s and error < clock.bound_s < 1e-3
    assert clock.rate_hz == pytest.approx((true.size - 1) / (true[-1] - true[0]), rel=2e-5)


def test_a_loss_of_unknown_length_starts_a_count_of_its_own() -> None:
    samples, true = drains(np.random.default_rng(5), 20.0, 241.0)
    cut = slice(2000, 2173)
    lost = np.delete(samples, cut)
    lost["index"] = np.arange(lost.size)  # the driver cannot know how many went
    lost["gap_before"][cut.start] = 1
    assert_allclose(fit_samples(lost, EPOCH).time_ns * 1e-9, np.delete(true, cut), atol=200e-6)


def test_a_short_segment_of_contradictory_drains_is_left_out() -> None:
    samples, true = drains(np.random.default_rng(7), 20.0, 241.0)
    ends = np.flatnonzero(np.diff(samples["drain_before_ns"])) + 1  # where a drain begins
    first, middle, last = ends[100], ends[101], ends[102]
    samples["gap_before"][[first, last]] = 1
    for part, late_ns in ((slice(first, middle), -12_000_000), (slice(middle, last), 12_000_000)):
        for field in ("drain_before_ns", "drain_after_ns"):
            samples[field][part] += late_ns  # held up after the time was read
    clock = fit_samples(samples, EPOCH)
    true[first:last] = np.nan
    assert_allclose(clock.time_ns * 1e-9, true, atol=clock.bound_s)
    assert clock.bound_s < 1e-3


def test_where_one_probe_speaks_alone_no_rate_is_made_of_it() -> None:
    """A broken file: one round trip of 0.1 ms among such of years. A line through it was no more than rounding."""
    said = probes(np.random.default_rng(0), 20.0, 40.0, 1e-4, 1e-5)
    said["host_rx_ns"][1:] += 2**60
    clock = fit_ticks(said, EPOCH)
    assert clock.rate_ppm == 0.0 and not clock.bound_s < 0.0


def test_an_imu_whose_count_stands_still_has_no_clock() -> None:
    said = drains(np.random.default_rng(0), 5.0, 476.0)[0]
    said["index"] = 7
    clock = fit_samples(said, EPOCH)
    assert np.isnan(clock.time_ns).all() and np.isnan(clock.rate_hz) and clock.bound_s == np.inf
