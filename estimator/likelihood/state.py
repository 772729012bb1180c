"""`State`: where a fit stands, and all that a step of it changes."""

from __future__ import annotations

from dataclasses import dataclass

from daq import FloatArray
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents


@dataclass
class State:
    """State of a fit. Its noise holds what single samples add: a noise scale of their run, and stiction."""

    x: Latents
    beta: FloatArray
    noise: Noise
    covariance: FloatArray
    converged: bool = False
    iterations: int = 0
    misfit: FloatArray | None = None
    """(n,) of each joint's torque at a sample, in variances of its noise, as the last step predicted it."""
    smoothing: FloatArray | None = None
    """(n,) velocity [rad/s] over which each joint's sign of friction is smoothed, where a search found it; None: that
    of the problem's mechanism."""
