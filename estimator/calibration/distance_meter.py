"""A laser distance meter on the stance leg as a sensor of the absolute angle, eqs. (52)-(54) of the paper.

The meter sits on the leg, `mount` d_2 above the foot, and points at flat ground with its beam at the angle
`gamma` gamma_3 to the leg. The foot, the meter and the spot on the ground make a triangle with sides d_1 (read),
d_2 (known) and d_3 (foot to spot), and gamma_3 at the meter. The spot lies ahead of the foot; the angle at the foot
between the leg and the ground ahead is pi/2 - q1 for a leg that leans by q1 towards the spot, and the sine rule
gives sin(pi/2 - q1) = d_1 sin(gamma_3) / d_3. (52) takes the acute angle, (53) the obtuse one.

The sign of (53): the obtuse angle at the foot means a leg that leans away from the spot, q1 < 0, so
q1 = -(pi/2 - arcsin(...)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daq import Dataset, FloatArray
from estimator.errors import FitError


@dataclass(frozen=True)
class DistanceMeter:
    """Geometry and noise; raises ValueError for a beam that does not point down and ahead."""

    mount_m: float
    """d_2: foot to sensor along the leg"""
    gamma_rad: float
    """gamma_3: beam to leg, towards the foot; in (0, pi/2)"""
    sigma_m: float = 0.0
    """standard deviation at the foot of the scale"""
    sigma_per_m: float = 0.0
    """its growth with distance: sigma(d) = sigma_m + sigma_per_m d"""

    def __post_init__(self) -> None:
        if not (self.mount_m > 0.0 and 0.0 < self.gamma_rad < 0.5 * np.pi):
            raise ValueError(f"mount {self.mount_m} m must be positive and gamma {self.gamma_rad} rad in (0, pi/2)")
        if self.sigma_m < 0.0 or self.sigma_per_m < 0.0:
            raise ValueError("noise levels must not be negative")

    def angle(self, distance: FloatArray) -> FloatArray:
        """q1 [rad] from readings d_1 [m], any shape: (52) up to d_2 / cos(gamma), (53) beyond."""
        sine, cosine = np.sin(self.gamma_rad), np.cos(self.gamma_rad)
        d3 = np.sqrt(distance**2 + self.mount_m**2 - 2.0 * distance * self.mount_m * cosine)
        lean = 0.5 * np.pi - np.arcsin(np.clip(distance * sine / d3, -1.0, 1.0))
        return np.asarray(np.where(distance <= self.mount_m / cosine, lean, -lean), dtype=np.float64)

    def distance(self, angle: FloatArray) -> FloatArray:
        """d_1 [m] that a leg at q1 [rad] shows: the inverse of `angle`; inf where the beam misses the ground.

        In the triangle the angle at the foot is pi/2 - q1, so that at the spot is pi/2 + q1 - gamma.
        """
        at_spot = np.sin(0.5 * np.pi + angle - self.gamma_rad)
        hits = (at_spot > 0.0) & (np.cos(angle) > 0.0)
        return np.where(hits, self.mount_m * np.cos(angle) / np.where(hits, at_spot, 1.0), np.inf)

    def sigma(self, distance: FloatArray) -> FloatArray:
        """Standard deviation of a reading [m]."""
        return self.sigma_m + self.sigma_per_m * distance

    def angle_sigma(self, distance: FloatArray) -> FloatArray:
        """Standard deviation of the angle from one reading [rad], to first order: sigma(d) |dq1/dd|.

        dq1/dd_1 = -sin(gamma) d_2 / d_3^2, by the derivative of the triangle's angle at the foot.
        """
        d3_squared = distance**2 + self.mount_m**2 - 2.0 * distance * self.mount_m * np.cos(self.gamma_rad)
        return self.sigma(distance) * self.mount_m * np.sin(self.gamma_rad) / d3_squared

    def read(self, angle: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Noisy readings [m] of a leg at q1 [rad]."""
        distance = self.distance(angle)
        return distance + self.sigma(distance) * rng.normal(size=np.shape(distance))


def angle_record(data: Dataset, meter: DistanceMeter, upright_rad: float = 0.0) -> Dataset:
    """`data` with its column `distance_m` turned to `q1_rad` and `q1_sigma_rad`, the deviation of each angle [rad].

    A meter of unknown noise counts as one whose distances are all read alike well: `q1_sigma_rad` is then per metre.
    NaN stays a gap. Raises `FitError` where there are no readings, or beams that missed the ground.
    """
    if "distance_m" not in data.columns:
        raise FitError(f"{data.name} has no column distance_m")
    distance = data["distance_m"]
    if np.isinf(distance).any() or (distance <= 0.0).any():
        missed = int((np.isinf(distance) | (distance <= 0.0)).sum())
        raise FitError(f"{data.name}: the beam missed the ground at {missed} samples")
    known = meter if meter.sigma_m or meter.sigma_per_m else replace(meter, sigma_m=1.0)
    columns = {name: values for name, values in data.columns.items() if name != "distance_m"}
    return replace(data, columns={**columns, "q1_rad": upright_rad + meter.angle(distance),
                                  "q1_sigma_rad": known.angle_sigma(distance)})
