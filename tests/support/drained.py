"""Samples of an IMU as a recorder gets them, drain by drain, from the times at which the chip took them."""

import numpy as np
from numpy.typing import NDArray

from daq.runs.streams import IMU_STREAM


def drained(rng: np.random.Generator, taken_s: NDArray[np.float64], every_s: float, seconds: float,
            epoch_ns: int = 0) -> NDArray[np.void]:
    """Looks come one after the other, some held up by up to 30 ms; each takes 90 us, or now and then 3 ms."""
    n = int(seconds / every_s)
    took = np.where(rng.random(n) < 0.01, 3e-3, 90e-6)
    pause = rng.uniform(0.8, 1.2, n) * every_s + np.where(rng.random(n) < 0.01, rng.uniform(0, 0.03, n), 0.0)
    look = np.cumsum(pause) + np.append(0.0, np.cumsum(took)[:-1])
    newest = np.searchsorted(taken_s, look + rng.uniform(0, 1, n) * took, side="right") - 1
    drain = np.searchsorted(newest, np.arange(newest[-1] + 1))
    out = np.zeros(drain.size, IMU_STREAM.dtype)
    out["index"] = np.arange(drain.size)
    for field, at in (("drain_before_ns", look), ("drain_after_ns", look + took)):
        out[field] = epoch_ns + np.rint(at[drain] * 1e9)
    return out
