"""`student_quantile`: half of a 95 % interval in standard errors."""

import numpy as np


def student_quantile(freedom: float) -> float:
    """Student's at 0.975, of 1 degree of freedom or more: t = sqrt(nu) tan(theta) has a density like
    cos(theta)^(nu - 1). SciPy's takes a third of a second to import."""
    theta = np.linspace(0.0, 0.5 * np.pi, 4001)
    density = np.cos(theta) ** (freedom - 1.0)
    below = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return float(np.sqrt(freedom) * np.tan(np.interp(0.95 * below[-1], below, theta)))
