"""Faults of the controller's clock in a record: steps, wraps, freezes and rate changes of telemetry, probes or both.

The telemetry's sequence number says how far its tick should advance. A probe's tick lies between two times of the
host. So either is held against something that does not depend on it. A step of both is corrected: the samples on each
side are timed by the probes on that side. Samples whose ticks contradict the probes are set aside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.dataset import BoolArray, FloatArray, IndexArray

WRAP_US = 2**32
STEP_SHARE, STEP_US = 0.5, 200.0
"""A tick is off if it differs from what the sequence says by this share of the period and so much more [us]."""
DRIFT = 500e-6
"""Change of rate that temperature makes between two probes, as a share."""
SLACK_NS = 0.3e6
"""Of a probe beyond half of its round trip: two reads of the clock, and rounding."""
LEAST_ROWS, LEAST_PROBES = 25, 2
"""A piece between two faults that has fewer cannot be timed."""
WINDOW_NS = 0.5e9
EARLY_NS, LATE_NS = 2e6, 20e6
"""A window's samples contradict the probes if they come so much earlier or later after their ticks than others."""
MOST_RATE = 0.03
"""Largest share by which any clock's rate differs from the host's; beyond it the probes themselves have failed."""
UNTIMED_S, UNTIMED_RATIO = 2e-3, 3.0
"""A piece whose probes leave its times unknown by so much, and so many times the best piece's bound, more cannot be
timed."""
PACE_S, PACE_SHARE = 0.25, 1e-3
"""The ticks a sequence number, over this time [s], may differ by this share from those of the run."""
SPREAD_SHARE = 0.25
"""Of the spread of arrivals: their least is known to so much of it."""
RUN_OF_STEPS = 3
"""So many probes in a row that all step one way are a change of the rate."""
COUNTERS_HZ = {f"a 32-bit counter at {mhz} MHz": mhz * 1e6 for mhz in (
    64, 72, 80, 84, 100, 120, 125, 133, 150, 168, 170, 180, 216, 240, 480)}
"""Cycle counters of processors; a tick made of one falls back by 2^32 of its cycles."""


class Piece(NamedTuple):
    """Rows of the telemetry, and the probes by which they are timed."""

    rows: IndexArray
    probes: IndexArray


def signed_us(ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n - 1,) differences of (n,) wrapped 32-bit ticks, of the sign that makes them smallest [us]."""
    half = WRAP_US // 2
    return (ticks[1:] - ticks[:-1] + half) % WRAP_US - half


def tick_steps(telemetry: NDArray[np.void]) -> tuple[IndexArray, FloatArray]:
    """Rows whose tick did not advance from the row before as the sequence did, and by how much too far [us]."""
    if telemetry.size < 2:
        return np.empty(0, np.intp), np.empty(0)
    ticks = signed_us(telemetry["tick_us"].astype(np.int64))
    seq: NDArray[np.int64] = telemetry["seq"].astype(np.int64)
    ahead = (seq[1:] - seq[:-1]) % 65536
    next_ones = ticks[(ahead == 1) & (ticks > 0)]
    if not next_ones.size:
        return np.empty(0, np.intp), np.empty(0)
    period = float(np.median(next_ones))
    off = ticks - ahead * period
    ordered = (ahead > 0) & (ahead < 32768)  # others are repeated, or overtaken
    rows = np.flatnonzero(ordered & (np.abs(off) > STEP_SHARE * period + STEP_US))
    return rows + 1, off[rows]


def paced_wrongly(telemetry: NDArray[np.void]) -> BoolArray:
    """(n,) rows around which the tick advances by more or less a sequence number than in most of the run.

    The controller counts both by one clock, so their ratio is constant even where that clock's rate changes.
    """
    wrong = np.zeros(telemetry.size, bool)
    stepped, _ = tick_steps(telemetry)
    ticks = signed_us(telemetry["tick_us"].astype(np.int64)).astype(float)
    seq: NDArray[np.int64] = telemetry["seq"].astype(np.int64)
    ahead = (seq[1:] - seq[:-1]) % 65536
    next_ones = ticks[(ahead == 1) & (ticks > 0)]
    period = float(np.median(next_ones)) if next_ones.size else 0.0
    window = max(LEAST_ROWS, round(PACE_S * 1e6 / period)) if period else telemetry.size
    if telemetry.size <= window:
        return wrong
    usual = (ahead > 0) & (ahead < 32768)
    usual[stepped - 1] = False  # a step is a fault of its own
    count = np.concatenate(([0], np.cumsum(np.where(usual, ahead, 0)))).astype(float)
    late_us = np.concatenate(([0.0], np.cumsum(np.where(usual, ticks - ahead * period, 0.0))))
    elapsed_us = np.maximum(count[window:] - count[:-window], 1.0) * period
    pace = (late_us[window:] - late_us[:-window]) / elapsed_us
    sound = float(np.median(pace))
    for first in np.flatnonzero(np.abs(pace - sound) > PACE_SHARE + STEP_US / elapsed_us).tolist():
        wrong[first + 1: first + window + 1] = True
    return wrong


def probe_steps(probes: NDArray[np.void], epoch_ns: int) -> tuple[IndexArray, FloatArray]:
    """Probes whose tick contradicts the probe before, at any drift that temperature makes, and by how much [us]."""
    if probes.size < 4:
        return np.empty(0, np.intp), np.empty(0)
    middle, trip, offset = _offsets(probes, epoch_ns)
    elapsed, moved = np.diff(middle), np.diff(offset)
    moved -= WRAP_US * 1e3 * np.rint(moved / (WRAP_US * 1e3))
    known = elapsed > 0
    if not known.any():
        return np.empty(0, np.intp), np.empty(0)
    rate = float(np.median(moved[known] / elapsed[known]))
    error = moved - (rate if abs(rate) < MOST_RATE else 0.0) * elapsed
    allowed = 0.5 * (trip[1:] + trip[:-1]) + DRIFT * np.abs(elapsed) + SLACK_NS
    rows = np.flatnonzero(np.abs(error) > allowed)
    return rows + 1, -error[rows] * 1e-3


def _offsets(probes: NDArray[np.void], epoch_ns: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middle of each round trip [ns after epoch], its length, and the host's time less the tick [ns]."""
    tx, rx = ((probes[name].astype(np.int64) - epoch_ns).astype(float) for name in ("host_tx_ns", "host_rx_ns"))
    turnaround = (probes["tx_tick_us"].astype(np.int64) - probes["rx_tick_us"].astype(np.int64)) % WRAP_US * 1e3
    tick = probes["rx_tick_us"].astype(float) * 1e3 + 0.5 * turnaround
    return 0.5 * (tx + rx), np.maximum(rx - tx - turnaround, 0.0), 0.5 * (tx + rx) - tick


def rate_change(probes: NDArray[np.void], epoch_ns: int) -> int | None:
    """The probe at which the rate of the clock changes; None where one smooth curve goes through all round trips."""
    if probes.size < 12:
        return None
    middle, trip, offset = _offsets(probes, epoch_ns)
    offset = offset - offset[0]
    offset -= WRAP_US * 1e3 * np.rint(offset / (WRAP_US * 1e3))
    x = (middle - middle[0]) / max(float(np.ptp(middle)), 1.0)

    def excess(a: int, b: int, degree: int) -> float:
        """Largest distance of a curve through these probes from their round trips [ns]."""
        weight = 1.0 / np.maximum(trip[a:b], 1e5)
        curve = np.polynomial.Polynomial.fit(x[a:b], offset[a:b], degree, w=weight)
        return float(np.max(np.abs(offset[a:b] - curve(x[a:b])) - 0.5 * trip[a:b]))

    whole = excess(0, probes.size, 2)
    if whole <= 3.0 * SLACK_NS:
        return None
    splits = np.unique(np.linspace(4, probes.size - 4, 40).astype(int))
    found = [max(excess(0, k, 1), excess(k, probes.size, 1)) for k in splits.tolist()]
    best = int(np.argmin(found))
    return int(splits[best]) if found[best] < 0.5 * whole else None


def pieces_of(telemetry: NDArray[np.void], probes: NDArray[np.void], epoch_ns: int) -> tuple[list[Piece], list[str]]:
    """The rows and probes of one boot between its faults, and the faults in words; one piece where there is none."""
    arrived = (telemetry["host_ns"].astype(np.int64) - epoch_ns).astype(float)
    middle = _offsets(probes, epoch_ns)[0]
    rows, by_us = tick_steps(telemetry)
    at, far_us, rated = _first_of_runs(*probe_steps(probes, epoch_ns))
    breaks = arrived[rows].tolist()
    words = []
    for row, off in _worst_of(rows, by_us):
        with_probes = bool(at.size) and float(np.min(np.abs(middle[at] - arrived[row]))) < WINDOW_NS
        words.append(_words("telemetry and probes" if with_probes else "the telemetry", arrived[row], off))
    for probe, off, rate in zip(at.tolist(), far_us.tolist(), rated):
        if rate:
            since = middle[probe - 1] * 1e-9
            ticks = signed_us(probes["rx_tick_us"][probe: probe + 2].astype(np.int64))
            still = bool((ticks * 1e3 < 0.5 * np.diff(middle[probe: probe + 2])).all())
            words.append(f"the probes stand still from {since:.2f} s on" if still else
                         f"the rate of the probes changed at {since:.2f} s")
        elif not any(abs(t - middle[probe]) < WINDOW_NS for t in breaks):
            words.append(_words("the probes", middle[probe], off))
    breaks += [0.5 * (middle[k] + middle[k - 1]) for k in at.tolist()
               if not any(middle[k - 1] <= t <= middle[k] for t in arrived[rows].tolist())]
    edges = np.sort(np.array(breaks))
    for k in ([] if edges.size else [rate_change(probes, epoch_ns)]):
        if k is not None:
            edges = np.array([middle[k]])
            words.append(f"its rate changed at {middle[k] * 1e-9:.2f} s")
    mine, theirs = np.searchsorted(edges, arrived, side="right"), np.searchsorted(edges, middle, side="right")
    return [Piece(np.flatnonzero(mine == k), np.flatnonzero(theirs == k)) for k in np.unique(mine)], words


def apart(arrived: FloatArray, time_ns: FloatArray, groups: list[IndexArray]) -> BoolArray:
    """Rows of the groups whose times by the probes diverge from their arrivals: both cannot be right."""
    wrong = np.zeros(arrived.shape, bool)
    for group in groups:
        rows = group[np.isfinite(time_ns[group])]
        if rows.size < LEAST_ROWS:
            continue
        wait, third = (arrived - time_ns)[rows], rows.size // 3
        least, most = np.quantile(wait[:third], (0.1, 0.9))
        moved = float(np.quantile(wait[-third:], 0.1) - least)
        took = float(np.median(arrived[rows][-third:]) - np.median(arrived[rows][:third]))
        if abs(moved) > PACE_SHARE * took + SLACK_NS + SPREAD_SHARE * float(most - least):
            wrong[rows] = True
    return wrong


def runs_of(rows: BoolArray) -> list[IndexArray]:
    """The uninterrupted runs of true rows."""
    at = np.flatnonzero(rows)
    return np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else []


def _first_of_runs(at: IndexArray, by_us: FloatArray) -> tuple[IndexArray, FloatArray, list[bool]]:
    """Steps of probes, of a run of them the first alone, and whether it is one: the rate has changed there."""
    first, rated = list[int](), list[bool]()
    for group in np.split(np.arange(at.size), np.flatnonzero((np.diff(at) != 1) | (np.diff(np.sign(by_us)) != 0)) + 1):
        run = group.size >= RUN_OF_STEPS
        first += group[:1].tolist() if run else group.tolist()
        rated += [run] * (1 if run else group.size)
    return at[first], by_us[first], rated


def _worst_of(rows: IndexArray, by_us: FloatArray) -> list[tuple[int, float]]:
    """One of each group of neighbours: a clock that stands still is off at every row."""
    groups = np.split(np.arange(rows.size), np.flatnonzero(np.diff(rows) > LEAST_ROWS) + 1)
    return [(int(rows[g[0]]), float(by_us[g][np.argmax(np.abs(by_us[g]))])) for g in groups if g.size]


def _words(what: str, at_ns: float, off_us: float) -> str:
    counter = next((name for name, hz in COUNTERS_HZ.items() if abs(-off_us * 1e-6 - 2**32 / hz) < 2e-3), "")
    if counter:
        return f"{what} wrapped at {at_ns * 1e-9:.2f} s, as {counter} does"
    return f"{what} stepped by {off_us * 1e-3:+.1f} ms at {at_ns * 1e-9:.2f} s"


def contradicting(arrived: FloatArray, time_ns: FloatArray, piece_of: NDArray[np.int64], bound_ns: float
                  ) -> BoolArray:
    """Rows that contradict the probes: (n,) arrivals [ns], times by the probes [ns] and numbers of the pieces.

    After its tick a sample needs some time to arrive. The least of a window may not change: not by more than 2 ms to
    an earlier arrival, 20 ms to a later one or, between pieces, 2 ms to either. The piece with the shortest wait is
    right.
    """
    wait = arrived - time_ns
    known = np.isfinite(wait)
    wrong = np.zeros(wait.shape, bool)
    if not known.any():
        return wrong
    numbers = np.unique(piece_of[known]).tolist()
    window = piece_of * 1_000_000 + ((arrived - arrived[0]) / WINDOW_NS).astype(np.int64)
    least = {w: float(np.quantile(wait[known & (window == w)], 0.1)) for w in np.unique(window[known])}
    pieces = {k: float(np.median([value for w, value in least.items() if w // 1_000_000 == k])) for k in numbers}
    sound = min(pieces.values(), key=abs)
    for w, value in least.items():
        piece = w // 1_000_000
        if value - sound < -EARLY_NS - bound_ns or value - sound > LATE_NS + bound_ns \
                or (len(numbers) > 1 and abs(pieces[piece] - sound) > EARLY_NS + bound_ns):
            wrong |= known & (window == w)
    return wrong
