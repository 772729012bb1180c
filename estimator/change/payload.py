"""A body more on a link: mass m, first moment h = m c and inertia J about the link's joint, with m >= 0 and m J >= h^2.

It moves every rigid parameter in which the link's own m, m lc and I + m lc^2 stand (`estimator.model.bodies`), in
proportion to lengths of links. Their ratios give these lengths: l_i = p_ij / g_j for any link j that link i carries.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from daq import FloatArray
from estimator.model import Mechanism, body_values, carried, has_bodies, rigid_parameters
from estimator.score import HIDDEN, Score

NAMES = ("mass", "first_moment", "inertia")
UNITS = ("kg", "kg m", "kg m^2")


def link_lengths(mechanism: Mechanism, beta: FloatArray, covariance: FloatArray) -> dict[int, tuple[float, float]]:
    """Length [m] of every link that carries another, and its standard deviation, by 0-based link."""
    if not has_bodies(mechanism):
        return {}
    place = {(p.term, p.at): k for k, p in enumerate(mechanism.parameters)}
    found = {}
    for i in range(mechanism.n):
        tried = []
        for j in carried(mechanism, i):
            p, g = place.get(("inertia", (i, j))), place.get(("gravity", (j,)))
            if p is None or g is None or beta[g] == 0.0:
                continue
            factor = mechanism.gravity_mps2 if mechanism.parameters[g].unit == "N m" else 1.0
            length = factor * beta[p] / beta[g]
            slope = np.array([factor, -length]) / beta[g]
            tried.append((float(np.sqrt(max(slope @ covariance[np.ix_([p, g], [p, g])] @ slope, 0.0))), float(length)))
        if tried and min(tried)[1] > 0.0:
            found[i] = min(tried)[::-1]
    return found


def body_basis(mechanism: Mechanism, link: int, lengths: Mapping[int, float]) -> FloatArray | None:
    """(p, 3) change of the parameters by mass, first moment and inertia of a body on a 0-based link; zeros where a
    size moves none. None where a length is not known."""
    if any(link in carried(mechanism, i) and i not in lengths for i in range(mechanism.n)):
        return None
    own = str(link + 1)
    empty = dict.fromkeys(body_values(mechanism), 0.0) | {f"l{i + 1}": length for i, length in lengths.items()}

    def parameters(mass: float, lc: float, inertia: float) -> FloatArray:
        body = {f"m{own}": mass, f"lc{own}": lc, f"I{own}": inertia}
        return rigid_parameters(mechanism, empty | {name: v for name, v in body.items() if name in empty})[0]

    basis = np.zeros((mechanism.p, 3))
    basis[[k for k, p in enumerate(mechanism.parameters) if p.rigid]] = np.column_stack([
        parameters(1.0, 0.0, 0.0), parameters(1.0, 1.0, -1.0) - parameters(1.0, 0.0, 0.0), parameters(0.0, 0.0, 1.0)])
    return basis


def fit_body(score: Score) -> tuple[FloatArray, float]:
    """(3,) likeliest sizes of a body that was added or taken away, and the fall of -2 log likelihood.

    The Cholesky factor of [[m, h], [h, J]] makes it a body of real mass. Where the runs do not determine all three
    sizes, nothing holds them."""
    from scipy.optimize import minimize

    free = score.size()
    if np.linalg.eigvalsh(score.correlation)[0] < HIDDEN or (free[0] * free[2] >= free[1] ** 2 and free[0] != 0.0):
        return free, score.gain()
    scale = 1.0 / np.sqrt(np.maximum(np.diag(score.information), 1e-300))
    unit = np.array([scale[0], np.sqrt(scale[0] * scale[2]), scale[2]])
    best, most = np.zeros(3), 0.0
    for sign, turn in product((1.0, -1.0), repeat=2):
        def sizes(x: FloatArray, sign: float = sign) -> FloatArray:
            a, b, d = x
            return sign * unit * np.array([a * a, a * b, b * b + d * d])

        def misfit(x: FloatArray) -> float:
            size = sizes(x)
            return float(size @ score.information @ size - 2.0 * size @ score.score)

        root = np.sqrt(np.abs(free / unit) + 1e-3)
        found = minimize(misfit, [root[0], turn * root[1], root[2]], method="BFGS")
        if -found.fun > most:
            best, most = sizes(found.x), -float(found.fun)
    return best, most


def fieller(size: FloatArray, covariance: FloatArray, t: float) -> tuple[float, float] | None:
    """Confidence set of size[0] / size[1], t standard deviations wide (Fieller, J. R. Stat. Soc. B 16, 1954); None
    where it is unbounded, since the denominator may be zero."""
    a = size[1] ** 2 - t**2 * covariance[1, 1]
    b = size[0] * size[1] - t**2 * covariance[0, 1]
    c = size[0] ** 2 - t**2 * covariance[0, 0]
    root = b * b - a * c
    if a <= 0.0 or root < 0.0:
        return None
    return float((b - np.sqrt(root)) / a), float((b + np.sqrt(root)) / a)
