"""Flags of a run: what one IMU on one leg cannot have measured."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.dataset import FloatArray, IndexArray
from daq.findings import Flag
from daq.rig import Rig
from daq.runs import RawRun

RATE_TOLERANCE = 0.06
"""How far the chip's oscillator may be off its nominal rate (the datasheet's is within a few percent)."""
WINDOW_S = 1.0
UNMARKED_SAMPLES = 0.5
"""By so many samples the drains of a second may contradict each other: half of the least that can be missing."""
NARROWINGS = 40
"""Of the bracket about the period, to 2/3 each: to 1e-8 of it."""
BY_CHANCE = 1e-6
"""What is less likely did not happen by chance."""
MISSING_SHARE = 0.02
"""Share of the IMU's samples that may be missing in gaps."""
REST_S = 1.0
GRAVITY_TOLERANCE = 0.25
"""How far the acceleration of the first second, motor off, may be off gravity: uncalibrated biases and a slow swing."""


def flag_run(raw: RawRun, rig: Rig, facts: dict[str, float]) -> list[Flag]:
    """One for each fault, empty where nothing is wrong; `facts` are the run's own of its IMU (rate and scales)."""
    samples = raw.streams["/imu"]
    if samples.size < 2 or not facts.get("rate_hz"):
        return []
    raw_counts = np.column_stack([samples[f"{kind}_{axis}"] for kind in ("gyro", "accel") for axis in "xyz"])
    flags = _rate(samples, facts["rate_hz"]) + _unmarked(samples, facts["rate_hz"]) + _repeated(raw_counts)
    counts = raw_counts[:, 3:].astype(float)
    time_s = (samples["drain_after_ns"] - samples["drain_after_ns"][0]) * 1e-9
    c = rig.calibration
    accel = (counts * facts["accel_mps2_per_lsb"] - np.array(c.accel_bias_mps2)) @ np.array(c.accel_matrix).T
    size, g = float(np.linalg.norm(accel[time_s < REST_S], axis=1).mean()), rig.mechanism.gravity_mps2
    if abs(size - g) > GRAVITY_TOLERANCE * g:
        flags.append(Flag("gravity", f"the IMU measured {size:.3g} m/s2 in the first second, gravity is {g:g}"))
    return flags


def _rate(samples: NDArray[np.void], nominal_hz: float) -> list[Flag]:
    """By the sample counts of whole seconds: a second reader of the FIFO takes some of them, marked or not."""
    after_ns, drain = np.unique(samples["drain_after_ns"], return_index=True)
    time_s = (after_ns - after_ns[0]) * 1e-9
    behind = np.append(drain[1:], samples.size)  # samples up to each drain
    gaps = np.add.reduceat(samples["gap_before"].astype(int), drain)
    seconds = np.flatnonzero(np.diff(np.floor(time_s / WINDOW_S), prepend=-1.0) > 0)
    rates, lost = [], 0.0
    for a, b in pairwise(seconds):
        counted, span = int(behind[b] - behind[a]), float(time_s[b] - time_s[a])
        if gaps[a + 1:b + 1].any():
            lost += max(nominal_hz * span - counted, 0.0)
        else:
            rates.append((counted / span, RATE_TOLERANCE * nominal_hz + 2.0 / span))
    flags: list[Flag] = []
    wrong = [rate for rate, allowed in rates if abs(rate - nominal_hz) > allowed]
    if wrong:
        worst = max(wrong, key=lambda rate: abs(rate - nominal_hz))
        flags.append(Flag("imu_rate", f"the IMU gave {worst:.4g} samples a second in {len(wrong)} of {len(rates)} "
                           f"seconds, {nominal_hz:g} were set: another program may have read it"))
    if lost > MISSING_SHARE * samples.size:
        flags.append(Flag("imu_missing", f"about {lost:.0f} of {samples.size + lost:.0f} IMU samples are missing in "
                           f"{int(samples['gap_before'].sum())} gaps"))
    return flags


def _unmarked(samples: NDArray[np.void], nominal_hz: float) -> list[Flag]:
    """A drain says that its newest sample was taken before it ended, and the next one not before it began. Where no
    steady clock makes all of that true within a second, samples are missing, or came twice, without a mark."""
    newest = np.flatnonzero(np.append(np.diff(samples["drain_before_ns"]) != 0, True))
    drains = samples[newest]
    index, start_ns = drains["index"].astype(float), drains["drain_before_ns"][0]
    before, after = ((drains[f"drain_{side}_ns"] - start_ns) * 1e-9 for side in ("before", "after"))
    segment, apart = np.cumsum(samples["gap_before"])[newest], 0.0
    for shift in (0.0, 0.5):  # of a second, so that each second reaches over the seams of the others
        second = np.floor(before / WINDOW_S + shift)
        first = np.flatnonzero(np.append(True, (np.diff(second) != 0) | (np.diff(segment) != 0)))
        start = np.repeat(first, np.diff(np.append(first, index.size)))
        apart = max(apart, _apart(index - index[start], before - before[start], after - before[start], first,
                                  1.0 / nominal_hz))
    if not apart > UNMARKED_SAMPLES:
        return []
    return [Flag("imu_unmarked", "IMU samples are missing without a mark, its drains contradict each other by "
                  f"{apart:.1f} of them: another program may have read it")]


def _apart(index: FloatArray, before_s: FloatArray, after_s: FloatArray, first: IndexArray,
           period_s: float) -> float:
    """The most by which drains of one group contradict each other [samples], each group by the period that makes this
    least: a convex function of it. Groups begin at `first`, and count indices and times from there."""
    def contradiction(period: FloatArray) -> FloatArray:
        each = np.repeat(period, sizes)
        return np.asarray(np.maximum.reduceat(before_s - (index + 1.0) * each, first)
                          - np.minimum.reduceat(after_s - index * each, first))

    sizes = np.diff(np.append(first, index.size))
    low = np.full(first.size, period_s / (1.0 + RATE_TOLERANCE))
    high = np.full(first.size, period_s / (1.0 - RATE_TOLERANCE))
    for _ in range(NARROWINGS):
        third = (high - low) / 3.0
        rises = contradiction(low + third) < contradiction(high - third)
        low, high = np.where(rises, low, low + third), np.where(rises, high - third, high)
    return float(np.max(contradiction(low) / low))


def _repeated(counts: NDArray[np.int16]) -> list[Flag]:
    """An emptied FIFO gives its last sample again. By the share of samples (n, 6) in which each number alone is the one
    before, all six would be so by chance `expected` times; Chernoff's bound of a Poisson number says how likely more
    are."""
    same = np.diff(counts, axis=0) == 0
    times, expected = int(same.all(axis=1).sum()), float(len(same) * np.prod(same.mean(axis=0)))
    if not times > expected or times - expected + times * math.log(expected / times) > math.log(BY_CHANCE):
        return []
    return [Flag("imu_repeated", f"{times} IMU samples repeat the one before in all six numbers, {expected:.1g} would "
                  "by chance: another program may have read it, or it hangs")]
