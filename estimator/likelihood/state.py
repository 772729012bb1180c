"""`State`: where a fit stands."""

from __future__ import annotations

from dataclasses import dataclass

from daq import FloatArray
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents


@dataclass
class State:
    """Where a fit stands."""

    x: Latents
    beta: FloatArray
    noise: Noise
    covariance: FloatArray
    converged: bool = False
    iterations: int = 0
    misfit: FloatArray | None = None
    """(n,) of each joint's torque at a sample, in variances of its noise, as the last step foresaw it."""
    falls: FloatArray | None = None
    """(n,) logarithm of the factor by which the last step changed the level of each passive joint."""
