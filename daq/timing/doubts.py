"""What in a run cannot be true of one IMU on one leg: reasons to doubt a fit of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.rig import Rig
from daq.runs import RawRun

RATE_TOLERANCE = 0.06
"""How far the chip's oscillator may be off its nominal rate (the datasheet's is within a few percent)."""
WINDOW_S = 1.0
MISSING_SHARE = 0.02
"""Share of the IMU's samples that may be missing in gaps."""
REST_S = 1.0
GRAVITY_TOLERANCE = 0.25
"""How far the acceleration of the first second, motor off, may be off gravity: uncalibrated biases and a slow swing."""


def doubts(raw: RawRun, rig: Rig, facts: dict[str, float]) -> list[str]:
    """Sentences, empty where nothing is wrong; `facts` are the run's own of its IMU (rate and scales)."""
    samples = raw.streams["/imu"]
    if samples.size < 2 or not facts.get("rate_hz"):
        return []
    found = _rate(samples, facts["rate_hz"])
    counts = np.column_stack([samples[f"accel_{axis}"] for axis in "xyz"]).astype(float)
    time_s = (samples["drain_after_ns"] - samples["drain_after_ns"][0]) * 1e-9
    c = rig.calibration
    accel = (counts * facts["accel_mps2_per_lsb"] - np.array(c.accel_bias_mps2)) @ np.array(c.accel_matrix).T
    size, g = float(np.linalg.norm(accel[time_s < REST_S], axis=1).mean()), rig.mechanism.gravity_mps2
    if abs(size - g) > GRAVITY_TOLERANCE * g:
        found.append(f"the IMU measured {size:.3g} m/s2 in the first second, gravity is {g:g}")
    return found


def _rate(samples: NDArray[np.void], nominal_hz: float) -> list[str]:
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
    found = []
    wrong = [rate for rate, allowed in rates if abs(rate - nominal_hz) > allowed]
    if wrong:
        worst = max(wrong, key=lambda rate: abs(rate - nominal_hz))
        found.append(f"the IMU gave {worst:.4g} samples a second in {len(wrong)} of {len(rates)} seconds, "
                     f"{nominal_hz:g} were set: another program may have read it")
    if lost > MISSING_SHARE * samples.size:
        found.append(f"about {lost:.0f} of {samples.size + lost:.0f} IMU samples are missing in "
                     f"{int(samples['gap_before'].sum())} gaps")
    return found
