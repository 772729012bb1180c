"""Allan deviation: how noisy a sensor at rest is when averaged over longer and longer times (IEEE Std 952, annex C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.dataset import FloatArray

FLICKER = 0.664
"""sqrt(2 ln2 / pi): the flat part of the curve over the bias instability B."""
LONGEST_SHARE = 1 / 5
"""Longest averaging time of the record; longer ones rest on too few independent averages."""
PER_DECADE = 8
WHITE_UP_TO_S = 0.3
"""Averaging times over which the noise density is read off: white noise rules there."""


@dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation of one or more signals."""

    tau_s: FloatArray
    """(k,) averaging times [s]."""
    sigma: FloatArray
    """(k, m) deviation, in the signal's unit."""

    @property
    def noise_density(self) -> FloatArray:
        """(m,) white noise N of sigma = N / sqrt(tau) at short times [unit / sqrt(Hz)]."""
        short = self.tau_s <= max(WHITE_UP_TO_S, 1.01 * float(self.tau_s[0]))
        logs = np.log(self.sigma[short]) + 0.5 * np.log(self.tau_s[short, None])
        density: FloatArray = np.exp(np.mean(logs, axis=0))
        return density

    @property
    def bias_instability(self) -> FloatArray:
        """(m,) the lowest point of the curve over 0.664 [unit]: an upper bound where the record is short."""
        lowest: FloatArray = np.min(self.sigma, axis=0) / FLICKER
        return lowest


def allan_curve(values: FloatArray, rate_hz: float) -> AllanCurve:
    """Curve of `values` (n, m), sampled at `rate_hz`; n at least 50. ValueError below that.

    sigma^2(tau) = sum (x[k+2m] - 2 x[k+m] + x[k])^2 / (2 tau^2 (n - 2m + 1)), x the integral of the signal.
    """
    n = values.shape[0]
    if n < 50:
        raise ValueError(f"{n} samples are too few for an Allan deviation")
    longest = max(int(n * LONGEST_SHARE), 2)
    count = max(int(PER_DECADE * np.log10(longest)) + 1, 2)
    sizes = np.unique(np.rint(np.geomspace(1, longest, count)).astype(int))
    integral = np.vstack([np.zeros(values.shape[1]), np.cumsum(values - values.mean(axis=0), axis=0)]) / rate_hz
    tau = sizes / rate_hz
    sigma = np.empty((sizes.size, values.shape[1]))
    for k, m in enumerate(sizes):
        second = integral[2 * m:] - 2.0 * integral[m:-m] + integral[:-2 * m]
        sigma[k] = np.sqrt(np.mean(second**2, axis=0) / 2.0) / tau[k]
    return AllanCurve(tau, sigma)
