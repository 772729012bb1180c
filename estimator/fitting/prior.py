r"""Gaussian knowledge of body values and parameters from elsewhere, as normal equations of beta.

Known are values t_k with standard deviations s_k: of parameters by name, and of body values (CAD, a scale, a ruler) of
which the rigid parameters are sums of products, b = h(t) (`estimator.model.bodies`). Body values that nobody gives are
free: they have `OPEN` times a plausible size for a standard deviation. At the t that fits a given beta best

    b ~ N(h(t) + J (t_known - t),  J S J' + R),     J = dh/dt, S = diag(s^2)

is the prior of beta, its information and gradient are added to the likelihood's: the fit is then the maximum a
posteriori. J follows beta from step to step, so that a length from a ruler ties two parameters at their fitted values.
R is small; it lets relations between parameters that hold for all bodies be off by `FORM` of a plausible size.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq import FloatArray
from estimator.errors import FitError
from estimator.fitting.identifiability import plausible_sizes
from estimator.model import Mechanism, body_values, rigid_parameters
from estimator.result import PriorValue

OPEN = 100.0
"""Standard deviation of a body value that nobody gives, in plausible sizes."""
FORM = 1e-4
"""Standard deviation of what bodies say of the parameters exactly, in plausible sizes of these."""
STEPS, LONGEST = 20, 0.5
"""Most steps to the body values that fit beta, and the longest of one, as a share of a value that is not given."""
Known = Mapping[str, tuple[float, float]]
"""Name -> value and standard deviation."""


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of beta, at one beta."""

    information: FloatArray
    """(p, p)"""
    gradient: FloatArray
    """(p,) of half the sum of squares"""
    objective: float
    """Sum of squares"""


def check_known(mechanism: Mechanism, known: Known) -> None:
    """Raises `FitError` for a name that is no parameter and no body value."""
    bodies = body_values(mechanism)
    for name in known:
        if name not in mechanism.names and name not in bodies:
            told = f"; its bodies have {', '.join(bodies)}" if bodies else "; it has no body values"
            raise FitError(f"[prior] {name} is no parameter of {mechanism.name}, which has "
                           f"{', '.join(mechanism.names)}{told}")


def prior_at(mechanism: Mechanism, known: Known, beta: FloatArray) -> Prior:
    """The prior at beta (p,)."""
    p = mechanism.p
    information, gradient, objective = np.zeros((p, p)), np.zeros(p), 0.0
    for name, (value, std) in known.items():
        if name in mechanism.names:
            k = mechanism.column(name)
            information[k, k] += std**-2
            gradient[k] += (beta[k] - value) / std**2
            objective += ((beta[k] - value) / std) ** 2
    if any(name not in mechanism.names for name in known):
        fitted = _Bodies(mechanism, known, beta)
        at = np.ix_(fitted.rigid, fitted.rigid)
        information[at] += fitted.precision
        gradient[fitted.rigid] += fitted.precision @ fitted.miss
        objective += float(fitted.miss @ fitted.precision @ fitted.miss)
    return Prior(information, gradient, objective)


def prior_values(mechanism: Mechanism, known: Known, beta: FloatArray, covariance: FloatArray
                 ) -> tuple[PriorValue, ...]:
    """Known values, each with its estimate after the fit: beta (p,) and its covariance (p, p)."""
    found = {}
    if any(name not in mechanism.names for name in known):
        fitted = _Bodies(mechanism, known, beta)
        gain = fitted.spread[:, None] * fitted.slope.T @ fitted.precision
        value = fitted.value + fitted.shift + gain @ fitted.miss
        variance = np.diag(fitted.spread) - gain @ fitted.slope * fitted.spread \
            + gain @ covariance[np.ix_(fitted.rigid, fitted.rigid)] @ gain.T
        found = {name: (float(value[i]), float(np.sqrt(max(variance[i, i], 0.0))))
                 for i, name in enumerate(fitted.names)}
    for k, name in enumerate(mechanism.names):
        found[name] = float(beta[k]), float(np.sqrt(max(covariance[k, k], 0.0)))
    return tuple(PriorValue(name, *known[name], *found[name]) for name in known)


def body_estimates(mechanism: Mechanism, known: Known, beta: FloatArray) -> dict[str, float]:
    """Body values that make beta (p,), near the known ones; those that beta does not tell are a guess."""
    fitted = _Bodies(mechanism, known, beta)
    return dict(zip(fitted.names, map(float, fitted.value), strict=True))


def combined(mechanism: Mechanism, known: Known, beta: FloatArray, covariance: FloatArray) -> FloatArray:
    """(p,) the mean of an estimate beta with this covariance (p, p) and the prior; a row without variance is kept."""
    free = np.flatnonzero(np.diag(covariance) > 0.0)
    prior = prior_at(mechanism, known, beta)
    spread = covariance[np.ix_(free, free)]
    gain = np.linalg.solve(np.eye(free.size) + spread @ prior.information[np.ix_(free, free)], spread)
    out = beta.copy()
    out[free] -= gain @ prior.gradient[free]
    return out


class _Bodies:
    """Body values that fit beta best, and the prior of the rigid parameters there."""

    def __init__(self, mechanism: Mechanism, known: Known, beta: FloatArray) -> None:
        self.rigid = np.array([k for k, p in enumerate(mechanism.parameters) if p.rigid])
        self.names = body_values(mechanism)
        given = np.array([name in known for name in self.names])
        start = _plausible(mechanism, known, beta)
        centre = np.array([known[name][0] if name in known else start[name] for name in self.names])
        size = np.array([abs(start[name]) for name in self.names])
        std = np.array([known[name][1] if name in known else OPEN * start[name] for name in self.names])
        form = (FORM * plausible_sizes(mechanism, beta)[self.rigid]) ** 2
        self.spread, self.value = std**2, centre.copy()
        for _ in range(STEPS):
            self._linearise(mechanism, form, centre, given, beta)
            step = self.shift + self.spread * (self.slope.T @ (self.precision @ self.miss))
            longest = float(np.max(np.abs(step[~given]) / size[~given], initial=0.0))
            self.value = self.value + step * min(1.0, LONGEST / max(longest, 1e-300))
            if np.all(np.abs(step) < 1e-6 * np.maximum(size, np.abs(self.value))):
                break
        self._linearise(mechanism, form, centre, given, beta)

    def _linearise(self, mechanism: Mechanism, form: FloatArray, centre: FloatArray, given: FloatArray,
                   beta: FloatArray) -> None:
        at, self.slope = rigid_parameters(mechanism, dict(zip(self.names, map(float, self.value), strict=True)))
        self.shift = np.where(given, centre - self.value, 0.0)
        self.miss = beta[self.rigid] - at - self.slope @ self.shift
        scale = np.sqrt(form) / FORM
        whole = (self.slope * self.spread) @ self.slope.T + np.diag(form)
        self.precision = np.linalg.inv(whole / np.outer(scale, scale)) / np.outer(scale, scale)
        if not np.isfinite(self.precision).all():
            raise FitError("[prior] and these runs fit no bodies: check the values and their units")


def _plausible(mechanism: Mechanism, known: Known, beta: FloatArray) -> dict[str, float]:
    """Sizes of all body values: the known ones, of the others those of slender links as heavy as beta says."""
    terms = np.array([p.term for p in mechanism.parameters])
    inertia = float(np.abs(beta[terms == "inertia"]).max(initial=0.0)) or 1.0
    moment = float(np.abs(beta[terms == "gravity"]).max(initial=0.0))
    moment /= mechanism.gravity_mps2 if mechanism.gravity < 0.0 else 1.0

    def median(kind: str, other: float) -> float:
        found = [abs(known[name][0]) for name in known if name.rstrip("0123456789") == kind and known[name][0]]
        return float(np.median(found)) if found else other

    length = median("l", 2.0 * median("lc", 0.5 * inertia / moment if moment > 0.0 else 0.5))
    mass = median("m", inertia / length**2)
    usual = {"m": mass, "l": length, "lc": 0.5 * length, "I": mass * length**2 / 12.0}
    return {name: abs(known[name][0]) if name in known and known[name][0] else usual[name.rstrip("0123456789")]
            for name in body_values(mechanism)}
