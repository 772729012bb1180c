"""Logs of one driven joint, as another program writes them."""

from pathlib import Path

import numpy as np

from tests.support.imported_files import table


def record(path: Path, names: tuple[str, str] = ("pos", "effort"), unit: float = 1.0, sign: int = 1,
           gravity: float = 1.0) -> Path:
    """A pendulum of 0.05 kg m^2 that follows a sum of sines of up to 1.6 rad, 200 Hz, 15 s, with noise of torque."""
    t = np.arange(0.0, 15.0, 0.005)
    a, w = np.array([1.0, 0.4, 0.2]), np.array([2.1, 5.3, 9.7])
    sine, cosine = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    q, qd, qdd = sine @ a, cosine @ (a * w), -sine @ (a * w * w)
    tau = 0.05 * qdd + 0.02 * qd + 0.03 * np.tanh(qd / 0.05) + gravity * np.sin(q)
    tau += np.random.default_rng(1).normal(0.0, 0.01, t.size)
    return table(path, {"time": t, names[0]: q / unit, names[1]: sign * tau}, 9)
