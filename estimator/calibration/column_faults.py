"""Columns whose sign, unit, order or gear is wrong, found by trying the corrections.

Each likely mistake is corrected, and `readings` judges the corrected record. The correction with a possible beta and
the smallest residual is reported. Mistakes that no motion shows, such as the torque's scale, are not tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from daq import Dataset, FloatArray
from estimator.calibration.readings import (
    LEAST_SPAN,
    MOST_SPAN,
    Motion,
    Reading,
    Remedy,
    filtered_motion,
    nothing_changed,
    read,
)
from estimator.calibration.units import TRIED, TWICE, correction
from estimator.calibration.windows import CLEAR
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import angle_column, torque_column

ALIKE = 1.25
"""Readings that leave less than so many times the least are not told apart: those with the fewest changes are named."""
MOST_LEFT = 0.5
"""Largest torque residual of a right reading, as a share of the torque."""
GEAR_STEPS = np.exp(np.linspace(np.log(0.25), np.log(4.0), 25))
"""Factors of an angle that are tried; a gear ratio that is wrong by any factor lies near one."""
COUNT_SPANS = np.exp(np.linspace(np.log(0.1), np.log(20.0), 45))
"""Spans [rad] that are tried for an angle that goes further than any, as counts of an encoder do."""
FINE = 17
"""Factors that are tried between the neighbours of the best of these."""
NEAR_ONE = 0.1
"""Factors closer to one are the scatter of such a search."""
EQUAL = 1e-3
"""Residuals that differ by a smaller share are equal."""


def find_remedies(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float = 1.0
                  ) -> tuple[Reading[Remedy], tuple[Reading[Remedy], ...]]:
    """The records as they are, and the corrected readings, the best first; none if no correction helps.

    On the IMU path the pivot's columns are not corrected: the accelerometer checks them. Raises `FitError`.
    """
    motion = filtered_motion(datasets, mechanism, options).thinned()
    nothing, *found = read(motion, mechanism, options, [nothing_changed(mechanism.n), *_likely(
        mechanism, options.sensors == "imu", gear_ratio, np.ptp(motion.q, axis=0))])
    for j in options.encoders_of(mechanism.n):
        span = float(np.ptp(motion.q[:, j]))
        steps = GEAR_STEPS if span < MOST_SPAN else COUNT_SPANS / span
        reading = _best_gear(motion, mechanism, options, j, steps)
        found += [] if reading is None else [reading]
    cures = [r for r in found if not r.faults and r.left < MOST_LEFT and _better(r, nothing)]
    least = min((r.left for r in cures), default=0.0)
    near = [r for r in cures if r.left <= ALIKE * least]
    fewest = min((r.remedy.changes for r in near), default=0)
    return nothing, tuple(sorted((r for r in near if r.remedy.changes == fewest), key=lambda r: round(r.left, 3)))


def _better(cured: Reading[Remedy], nothing: Reading[Remedy]) -> bool:
    """Whether a remedy is called for: it leaves far less, or no more where the record makes no mechanism."""
    if nothing.faults and not cured.remedy.scales:
        return cured.left <= (1.0 + EQUAL) * nothing.left
    return CLEAR * cured.left < nothing.left


def _scaled(mechanism: Mechanism, factors: Mapping[str, float], changes: int = 1) -> Remedy:
    """The reading of columns (angles and torques) times these factors."""
    n = mechanism.n
    what, write = correction(factors)
    angles, torques = (np.diag([factors.get(of(mechanism, j), 1.0) for j in range(n)])
                       for of in (angle_column, _torque_column))
    return Remedy(what, write, angles, np.zeros(n), torques, changes)


def _torque_column(mechanism: Mechanism, j: int) -> str:
    return torque_column(mechanism, j) if mechanism.force_unit != "V" else "duty"


def _likely(mechanism: Mechanism, imu: bool, gear_ratio: float, span: FloatArray) -> Iterator[Remedy]:
    """The mistakes that people make, undone one by one and, where signs are concerned, together; `span` (n,) is how far
    each angle goes as it is read."""
    n, turns = mechanism.n, mechanism.length_unit == "rad"
    nothing, eye = nothing_changed(n), np.eye(n)
    angles = list(range(int(imu), n))
    q, tau = ([of(mechanism, j) for j in range(n)] for of in (angle_column, _torque_column))
    signs = [tau[j] for j in mechanism.actuated] + [q[j] for j in angles]
    for count in range(1, len(signs) + 1):
        for which in combinations(signs, count):
            yield _scaled(mechanism, dict.fromkeys(which, -1.0), count)
    for those in sorted({tuple(angles), *((j,) for j in angles)}) if turns else ():
        for factor in (*TRIED["rad"].values(), TWICE):
            if factor != 1.0 and factor * span[list(those)].max() >= LEAST_SPAN:
                yield _scaled(mechanism, {q[j]: factor for j in those})
    for j in angles if gear_ratio != 1.0 else ():
        for factor, said in ((gear_ratio, "divided by the gear ratio twice"),
                             (1.0 / gear_ratio, "of the motor's side")):
            yield replace(_scaled(mechanism, {q[j]: factor}), what=f"{q[j]} looks {said}")
    for j, k in combinations(range(n), 2):
        swapped = eye.copy()
        swapped[[j, k]] = swapped[[k, j]]
        both = j in mechanism.actuated and k in mechanism.actuated
        for kinds, what, changes in (({"angles": swapped}, f"{q[j]} and {q[k]}", 2),
                                     ({"torques": swapped}, f"{tau[j]} and {tau[k]}", 2),
                                     ({"angles": swapped, "torques": swapped}, f"joints {j + 1} and {k + 1}", 3)):
            if (both or "torques" not in kinds) and (j in angles or "angles" not in kinds):
                yield replace(nothing, **kinds, what=f"{what} look interchanged", changes=changes,
                              write="give each column the other's name under [columns]")
    if turns and not imu:
        if mechanism.gravity_mps2 > 0.0:
            yield replace(nothing, zero=np.pi * eye[0], what=f"gravity looks upside down, or {q[0]} counted from "
                          "upright", write=f'set name = "{q[0]}" and offset = 3.14159265 under [columns.{q[0]}]')
        if n > 1:
            yield replace(nothing, angles=eye - np.eye(n, k=-1), changes=2, what="the angles look absolute, each "
                          "counted from the vertical", write="subtract the angle of the link before from each before "
                          "it is read")


def _best_gear(motion: Motion, mechanism: Mechanism, options: FitOptions, joint: int, factors: FloatArray
               ) -> Reading[Remedy] | None:
    """The factor of one joint's angle that leaves least, by search; None where it is near one, or gravity is absent."""
    if mechanism.length_unit == "m" or mechanism.gravity_mps2 == 0.0:
        return None
    column, gear = angle_column(mechanism, joint), factors is GEAR_STEPS

    def at(factors: FloatArray) -> list[Reading[Remedy]]:
        scaled = [_scaled(mechanism, {column: factor}, 2) for factor in factors.tolist()]
        return read(motion, mechanism, options, [replace(one, write=(
            f"correct the gear ratio that it was divided by, or {one.write}" if gear else
            f"{one.write}, or what a count is exactly")) for one in scaled])

    left = [np.inf if reading.faults else reading.left for reading in at(factors)]
    best = int(np.argmin(left))
    if best in (0, len(left) - 1) or abs(np.log(factors[best])) < NEAR_ONE:
        return None
    fine = min(at(np.geomspace(factors[best - 1], factors[best + 1], FINE)), key=lambda reading: reading.left)
    return None if abs(np.log(fine.remedy.angles[joint, joint])) < NEAR_ONE else fine
