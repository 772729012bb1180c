"""`enlarged`: tolerances that the runs contradict, made larger, a group at a time.

With parameters projected out, the nuisances' score is normal with covariance I' + I' T I': the restricted likelihood
(Patterson and Thompson, Biometrika 58, 1971) of a factor for each group's tolerances. The factor that raises it most is
taken while a likelihood ratio test is significant over all groups. A factor is never below one, so half of the ratios
are zero by chance (Chernoff, Ann. Math. Stat. 25, 1954).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtri

from daq import FloatArray
from estimator.score.marginal import Projected
from estimator.score.nuisances import Nuisance
from estimator.score.score_tests import ALPHA

FACTORS = 2.0 ** np.arange(0.0, 4.5, 0.5)
"""Factors of a tolerance that are tried."""
MOST_STEPS = 24
AGAIN = 0.1
"""Share of the significant gain for which a group that has passed the test changes its factor again."""
SMALLEST = 1e-10
"""Eigenvalues of the information, in units of the tolerances, below which the runs say nothing."""


def enlarged(projected: Projected, nuisances: Sequence[Nuisance]) -> tuple[list[Nuisance], Mapping[str, float]]:
    """`nuisances` with the tolerances that the runs ask for, and the factor of each group that has one."""
    size = np.array([one.tolerance for one in nuisances])
    values, vectors = np.linalg.eigh(projected.information * np.outer(size, size))
    kept = values > SMALLEST
    rows = vectors[:, kept] * np.sqrt(values[kept])
    y = (vectors[:, kept] / np.sqrt(values[kept])).T @ (size * projected.score)
    roots = {group: rows[[one.group == group for one in nuisances]].T for group in {one.group for one in nuisances}}
    roots = {group: root for group, root in sorted(roots.items()) if np.sum(root**2) > SMALLEST}
    if not roots:
        return list(nuisances), {}
    factors = dict.fromkeys(roots, 1.0)
    enough = float(chdtri(1, min(1.0, 2.0 * ALPHA / len(roots))))
    whole = np.eye(y.size) + sum(root @ root.T for root in roots.values())
    for _ in range(MOST_STEPS):
        inverse = np.linalg.inv(whole)
        gains = {group: _gain(inverse, root, factors[group], y) for group, root in roots.items()}
        worth = {group: gain - enough * (1.0 if factors[group] == 1.0 else AGAIN) for group, (gain, _) in gains.items()}
        group = max(worth, key=lambda one: worth[one])
        if not worth[group] > 0.0:
            break
        factor = gains[group][1]
        whole += (factor**2 - factors[group] ** 2) * roots[group] @ roots[group].T
        factors[group] = factor
    grown = {group: factor for group, factor in factors.items() if factor > 1.0}
    return [one._replace(tolerance=one.tolerance * factors.get(one.group, 1.0)) for one in nuisances], grown


def _gain(inverse: FloatArray, root: FloatArray, factor: float, y: FloatArray) -> tuple[float, float]:
    """Largest fall of -2 log likelihood by another factor of a group, and that factor.

    `inverse` (k, k) is of the covariance of y (k,) with the factor as it is, in which it multiplies `root` (k, g).
    """
    solved = inverse @ root
    levels, axes = np.linalg.eigh(root.T @ solved)
    levels, along = np.maximum(levels, 0.0), axes.T @ (solved.T @ y)
    more = FACTORS[:, None] ** 2 - factor**2
    grown = np.maximum(1.0 + more * levels, 1e-12)
    fall = np.sum(more * along**2 / grown - np.log(grown), axis=1)
    k = int(np.argmax(fall))
    return float(fall[k]), float(FACTORS[k])
