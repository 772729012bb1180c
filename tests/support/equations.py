"""The normal equations of a likelihood, by name."""

import numpy as np

from estimator.likelihood import Linearised


def normal(point: Linearised) -> dict[str, np.ndarray]:
    """The normal equations' parts by name."""
    return {name: getattr(point.chain, name) for name in ("diagonal", "lower", "right")} | {
        name: getattr(point, name) for name in ("corner", "gradient_beta", "accel")}
