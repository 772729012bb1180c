"""Every device's clock put onto the host's: controller ticks by ping, IMU samples by counting.

Times are float nanoseconds after an `epoch_ns` of the host's monotonic clock, so that a double holds
them to well below a nanosecond.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from daq.dataset import FloatArray, IndexArray

WRAP_US = 2**32
BEST_SHARE = 0.1
"""Share of the probes, those with the shortest round trips, that the fit uses."""
_BINS = 6
_PER_BIN = 2
_KNOT_EVERY_NS = 30e9
_SPLINE_FROM_NS = 60e9
Curve = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class TickClock:
    """Controller ticks of one boot to host time."""

    anchor_tick: int
    """Tick and host time [ns after epoch] of one probe: what a tick's wraps are counted from."""
    anchor_ns: float
    offset: Polynomial
    """Host time minus (tick - anchor_tick), both ns, as a function of the latter."""
    bound_s: float
    """Half the round trip of the probes used plus twice the fit's residual [s]."""
    rate_ppm: float
    """How much faster than the host's the controller's clock runs [1e-6], at mid run."""
    probes: int
    """Probes used; of a drive that is polled, its samples."""

    def host_ns(self, tick_us: NDArray[np.integer], near_ns: FloatArray) -> FloatArray:
        """Host time [ns after epoch] of wrapped ticks; `near_ns`: about when each was received."""
        since = _unwrapped(tick_us, near_ns, self.anchor_tick, self.anchor_ns) * 1e3
        return since + self.offset(since)


def fit_ticks(probes: NDArray[np.void], epoch_ns: int) -> TickClock:
    """Clock from the probes of one boot (fields of the `/leg/clock` stream), at least one.

    Quadratic over the whole run through the best tenth of the round trips, taken from six segments of it
    alike so that the ends are held too; short runs get a straight line or, below 2 s, a constant. The device
    reads its clock twice within a probe; what is left of the round trip bounds the error by its half.
    """
    tx = (probes["host_tx_ns"] - epoch_ns).astype(float)
    rx = (probes["host_rx_ns"] - epoch_ns).astype(float)
    turnaround = (probes["tx_tick_us"].astype(np.int64) - probes["rx_tick_us"].astype(np.int64)) % WRAP_US
    trip = rx - tx - turnaround * 1e3
    middle = 0.5 * (tx + rx)
    anchor_tick = int(probes["rx_tick_us"][0])
    since = (_unwrapped(probes["rx_tick_us"], middle, anchor_tick, middle[0]) + 0.5 * turnaround) * 1e3
    best = _best_trips(trip, since)
    x, trip = since[best], trip[best]
    y = middle[best] - x
    span = float(np.ptp(x))
    degree = 2 if span > 30e9 and x.size >= 12 else 1 if span > 2e9 and x.size >= 4 else 0
    # A probe's error is at most half its round trip, hence the weights; 1 us is the tick's own step.
    weight = 1.0 / np.maximum(trip, 1e3)
    if np.sum(weight**2) ** 2 < (degree + 1) * np.sum(weight**4):  # fewer of them speak than the curve has numbers
        degree = 0
    offset = Polynomial.fit(x, y, degree, w=weight) if span > 0 else Polynomial([float(y.mean())])
    residual = np.sqrt(np.average((y - offset(x)) ** 2, weights=weight**2))
    bound = 0.5 * np.quantile(np.maximum(trip, 1e3), 0.9) + 2.0 * residual
    slope = float(offset.deriv()(0.5 * (x.min() + x.max()))) if degree else 0.0
    return TickClock(anchor_tick, float(middle[0]), offset, float(bound) * 1e-9, -slope * 1e6, int(x.size))


def fit_answers(probes: NDArray[np.void], epoch_ns: int) -> TickClock:
    """Clock of a drive that keeps no time: each sample's tick is already the host's, the middle of request and reply.

    `probes`: the fields of the `/leg/clock` stream, at least one, a row a sample. The bound is half of the wait that
    nine samples of ten did not exceed.
    """
    middle = 0.5 * ((probes["host_tx_ns"] - epoch_ns).astype(float) + (probes["host_rx_ns"] - epoch_ns))
    waits = (probes["host_rx_ns"] - probes["host_tx_ns"]).astype(float)
    bound_s = max(0.5 * float(np.quantile(waits, 0.9)), 1e3) * 1e-9
    return TickClock(int(probes["rx_tick_us"][0]), float(middle[0]), Polynomial([float(middle[0])]), bound_s, 0.0,
                     int(waits.size))


def _unwrapped(tick_us: NDArray[np.integer], near_ns: FloatArray, anchor_tick: int, anchor_ns: float) -> FloatArray:
    """Microseconds since the anchor's tick, whichever wrap is nearest to the host's time."""
    since = tick_us.astype(np.int64) - anchor_tick
    wraps = np.rint(((near_ns - anchor_ns) * 1e-3 - since) / WRAP_US)
    return since + wraps * WRAP_US


def _best_trips(trip: FloatArray, since: FloatArray) -> IndexArray:
    """Indices of the shortest tenth (at least two) of the round trips in each of six segments of time."""
    edges = np.linspace(since.min(), since.max(), _BINS + 1)[1:-1]
    bins = np.searchsorted(edges, since, side="right")
    chosen = []
    for b in range(_BINS):
        members = np.flatnonzero(bins == b)
        count = max(_PER_BIN, round(BEST_SHARE * members.size))
        chosen.append(members[np.argsort(trip[members])[:count]])
    return np.sort(np.concatenate(chosen))


@dataclass(frozen=True)
class ImuClock:
    """Host times of IMU samples."""

    time_ns: FloatArray
    """(n,) [ns after epoch] for the samples given; NaN where a segment was too short, or too disturbed, to time."""
    rate_hz: float
    """Measured with the host's clock."""
    bound_s: float
    """Largest error of a sample's time [s], as far as the drains can tell."""


def fit_samples(samples: NDArray[np.void], epoch_ns: int) -> ImuClock:
    """Times of IMU samples (fields of the `/imu` stream) from the host times of the drains.

    - A drain that finds sample i the newest at t means: time of i <= t < time of i + 1. t is the middle of the read of
      the fill level; half of that read is part of the bound.
    - Rate: a line through the t, for long runs a spline with a knot every 30 s (the oscillator warms up).
    - Offset: the envelope of all inequalities. A late drain does no harm.

    Segments between losses of unknown length are timed separately.
    """
    time_ns = np.full(samples.shape, np.nan)
    segment = np.cumsum(samples["gap_before"])
    _, starts = np.unique(segment, return_index=True)
    parts = [slice(int(a), int(b)) for a, b in zip(starts, [*starts[1:], samples.size])]
    drains = [_drains(samples[part], epoch_ns) for part in parts]
    longest = max(range(len(parts)), key=lambda k: drains[k][0].size)
    index, looked, _ = drains[longest]
    if index.size < 4 or not index[-1] > index[0]:  # a broken file can say that no sample came
        return ImuClock(time_ns, float("nan"), float("inf"))
    period = (looked[-1] - looked[0]) / (index[-1] - index[0])
    bounds = []
    for part, (index, looked, took) in zip(parts, drains):
        if index.size < 2:
            continue
        found = _envelope(index, looked, period)
        if found is None:
            continue
        curve, low, high, spread = found
        time_ns[part] = curve(samples["index"][part].astype(float)) + 0.5 * (low + high)
        bounds.append(0.5 * abs(high - low) + spread + 0.5 * float(np.median(took)))
    i = samples["index"][parts[longest]].astype(float)
    t = time_ns[parts[longest]]
    if np.isnan(t[-1]):
        return ImuClock(np.full(samples.shape, np.nan), float("nan"), float("inf"))
    rate = float((i[-1] - i[0]) / (t[-1] - t[0]) * 1e9)
    return ImuClock(time_ns, rate, max(bounds) * 1e-9)


def _drains(samples: NDArray[np.void], epoch_ns: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Newest index of each drain, middle [ns after epoch] and length [ns] of the look at the fill level."""
    last = np.flatnonzero(np.concatenate((np.diff(samples["drain_before_ns"]) != 0, [True])))
    chosen = samples[last]
    took = (chosen["drain_after_ns"] - chosen["drain_before_ns"]).astype(float)
    return chosen["index"].astype(float), (chosen["drain_before_ns"] - epoch_ns) + 0.5 * took, took


def _envelope(index: FloatArray, looked: FloatArray, period: float) -> tuple[Curve, float, float, float] | None:
    """Curve of sample time over index, the ends between which its offset lies, and the curve's own error [ns].

    None where the drains of a short segment contradict each other.
    """
    middle = looked - 0.5 * period
    keep = np.ones(index.shape, bool)
    for _ in range(3):  # drains held up between reading the time and the FIFO's level stand out: drop them
        curve, parameters = _curve(index[keep], middle[keep], period)
        residual = middle - curve(index)
        keep = np.abs(residual - np.median(residual[keep])) < 0.75 * period
        if keep.sum() < 2:
            return None
    late = looked[keep] - curve(index[keep])
    # `late` fills [0, period) with the drains' phases. 0.5 % at either end is left to jitter.
    low, high = np.quantile(late, 0.995) - period, np.quantile(late, 0.005)
    # Two sigma where a least-squares curve is worst, at its ends: four times the mean variance of phases
    # that are uniform over a period.
    spread = 2.0 * period * np.sqrt(4.0 * parameters / 12.0 / keep.sum())
    return curve, float(low), float(high), float(spread)


def _curve(index: FloatArray, time_ns: FloatArray, period: float) -> tuple[Curve, int]:
    """The curve and how many numbers were fitted for it."""
    from scipy.interpolate import make_lsq_spline

    span = time_ns[-1] - time_ns[0]
    if span < 1e9 or index.size < 20:
        return Polynomial([float(np.mean(time_ns - period * index)), period]), 1
    if span < _SPLINE_FROM_NS:
        return Polynomial.fit(index, time_ns, 1), 2
    pieces = min(int(span / _KNOT_EVERY_NS) + 1, index.size // 4)  # times that are wrong may span years
    inner = np.linspace(index[0], index[-1], pieces)[1:-1]
    knots = np.concatenate((np.repeat(index[0], 4), inner, np.repeat(index[-1], 4)))
    try:
        return make_lsq_spline(index, time_ns, knots), knots.size - 4
    except ValueError:  # knots without a drain between them
        return Polynomial.fit(index, time_ns, 1), 2
