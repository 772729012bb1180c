"""`next_measurement`: the one value that, measured, weighed or calibrated, tells most about the parameters of a fit.

With the information H of a fit and the prior's P, knowing a candidate to `ACCURACY` makes P into P'. Named is the
candidate whose covariance (H + P')^-1 shrinks the standard deviations of all others most, by their geometric mean. A
source of the budget, calibrated to `CALIBRATED` of its tolerance, leaves the square of that of its part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq import BoolArray, FloatArray
from estimator.effects import SensorEffect, classes
from estimator.fitting.identifiability import plausible_sizes, uncertain_directions
from estimator.fitting.prior import body_estimates, prior_at
from estimator.model import has_bodies
from estimator.numerics import pseudo_inverse
from estimator.result import FitResult
from estimator.score import TORQUE_GAIN

CALIBRATED = 0.1
"""Share of a tolerance that a calibration leaves."""
ACCURACY = 0.01
"""Standard deviation of the measurement that is proposed, as a share of the value."""
INSTRUMENTS = {"kg": 1e-4, "m": 1e-4, "kg m": 1e-6, "kg m^2": 1e-8}
"""Unit -> finest `ACCURACY` that is proposed: that of a body of 10 g and 10 mm. No instrument gives less of a leg's."""
MOST_LEFT = 0.9
"""A value that leaves the intervals of the others at more than this share of their width is not named."""


@dataclass(frozen=True)
class Measurement:
    """A value to measure, and what it would do."""

    name: str
    """Of a parameter, a body value, or a source of the budget."""
    value: float
    """As it is now."""
    std: float
    """Of the measurement assumed."""
    widths: dict[str, float]
    """Other parameter -> width of its interval then, as a share of now."""
    undetermined: tuple[int, int]
    """Combinations that the runs leave open, now and then."""
    source: bool = False
    """Whether it is a source of the budget: `value` is then zero, and `std` what its tolerance would be."""

    @property
    def share(self) -> float:
        """Geometric mean of the widths."""
        return float(np.exp(np.mean(np.log(list(self.widths.values())))))


def next_measurement(result: FitResult) -> Measurement | None:
    """The most useful value to measure next; None where no single one is worth it, or the fit is none."""
    m = result.mechanism
    free = np.array([name not in result.fixed and name not in result.at_bound for name in m.names])
    determined = {*m.names} - {*result.fixed, *result.at_bound} - result.open_parameters
    if not result.converged or result.method != "mle" or free.sum() < 2 or not determined:
        return None
    scale = plausible_sizes(m, result.beta, result.std)
    now = _open(result, scale)
    found = _calibrations(result, now, scale, free)
    known = {one.name: (one.value, one.std) for one in result.prior}
    before = prior_at(m, known, result.beta).information
    values = {p.name: float(b) for p, b, one in zip(m.parameters, result.beta, free) if p.rigid and one}
    if has_bodies(m):
        values |= {name: value for name, value in body_estimates(m, known, result.beta).items() if name not in known}
    for name, value in values.items():
        unit = m.parameters[m.column(name)].unit if name in m.names else body_unit(name)
        std = ACCURACY * (scale[m.column(name)] if name in m.names else abs(value))
        if not std > 0.0 or std < INSTRUMENTS.get(unit, 0.0):
            continue
        more = prior_at(m, {**known, name: (value, std)}, result.beta).information - before
        after = np.zeros_like(now)
        at = np.ix_(free, free)
        after[at] = pseudo_inverse(pseudo_inverse(now[at]) + more[at])
        ratio = np.sqrt(np.diag(after)[free] / np.maximum(np.diag(now)[free], 1e-300))
        widths = {other: float(min(one, 1.0)) for other, one in zip(np.array(m.names)[free], ratio) if other != name}
        left = [uncertain_directions(c, scale, free).shape[1] for c in (now, after)]
        found.append(Measurement(name, value, float(std), widths, (left[0], min(left))))
    best = min(found, key=lambda one: (one.undetermined[1], one.share), default=None)
    if best is None or (best.share > MOST_LEFT and best.undetermined[1] == best.undetermined[0]):
        return None
    return best


def body_unit(name: str) -> str:
    """Unit of the body value `name`."""
    return {"m": "kg", "l": "m", "lc": "m", "I": "kg m^2"}[name.rstrip("0123456789")]


def _calibrations(result: FitResult, now: FloatArray, scale: FloatArray, free: BoolArray
                  ) -> list[Measurement]:
    """One for each source of the budget that can be calibrated: the scale of the torque, and what sensors read."""
    left, found = uncertain_directions(now, scale, free).shape[1], []
    told = {TORQUE_GAIN, *(kind.name for kind in classes() if issubclass(kind, SensorEffect))}
    for part in result.budget.parts if result.budget else ():
        if part.tolerance and part.source.partition("@")[0] in told:
            after = np.diag(now) - (1.0 - CALIBRATED**2) * part.std**2
            ratio = np.sqrt(np.maximum(after, 0.0)[free] / np.maximum(np.diag(now)[free], 1e-300))
            widths = dict(zip(np.array(result.mechanism.names)[free], map(float, np.clip(ratio, 1e-3, 1.0))))
            found.append(Measurement(part.source, 0.0, CALIBRATED * part.tolerance[0], widths, (left, left), True))
    return found


def _open(result: FitResult, scale: FloatArray) -> FloatArray:
    """(p, p) covariance in which what the runs leave open has a standard deviation of its plausible size at least."""
    out = result.covariance.copy()
    for combination in result.undetermined:
        direction = np.zeros(len(out))
        for name, amount in combination.amounts:
            direction[result.mechanism.column(name)] = amount
        direction *= scale[result.mechanism.column(combination.amounts[0][0])]
        out += np.outer(direction, direction)
    return out
