"""Logs of one driven joint, as another program writes them."""

from pathlib import Path

import numpy as np


def record(path: Path, names: tuple[str, str], unit: float, sign: int, gravity: float) -> Path:
    """A pendulum of 0.05 kg m^2 that follows a sum of sines of up to 1.6 rad, 200 Hz, 15 s, with noise of torque."""
    t = np.arange(0.0, 15.0, 0.005)
    waves = ((1.0, 2.1), (0.4, 5.3), (0.2, 9.7))
    q = sum(a * np.sin(w * t) for a, w in waves)
    qd = sum(a * w * np.cos(w * t) for a, w in waves)
    qdd = sum(-a * w * w * np.sin(w * t) for a, w in waves)
    tau = 0.05 * qdd + 0.02 * qd + 0.03 * np.tanh(qd / 0.05) + gravity * np.sin(q)
    tau += np.random.default_rng(1).normal(0.0, 0.01, t.size)
    np.savetxt(path, np.stack([t, q / unit, sign * tau], axis=1), delimiter=",", comments="",
               header=f"time,{names[0]},{names[1]}", fmt="%.9g")
    return path
