"""Wrong set-ups, searched for when a fit is impossible or its residual is large, and their remedies in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from daq import Dataset
from estimator import FIT_ERRORS, FitError, FitOptions
from estimator.calibration import (
    MOST_LEFT,
    MOST_SPAN,
    ImuReading,
    as_it_is,
    find_remedies,
    read_imu,
    wrong_lever,
    wrong_scale,
)
from estimator.model import Mechanism
from estimator.signals import angle_column, is_plain
from experiments.session.setup import Setup

SUSPICIOUS = 0.1
"""Residual of slow least squares, as a share of the torque, above which other readings of the columns are tried."""
NAMED = 2
"""Most readings that are named, where they say the same."""
ONE_WAY = 2.0
"""Times its span that the path of an angle is at most when the joint turned on, or there and back."""


class Suspicion(NamedTuple):
    """Suspected faults of a set-up."""

    remedies: tuple[str, ...] = ()
    """What looks wrong and what to write into the rig file, the likeliest first; empty if nothing helps."""
    against: tuple[str, ...] = ()
    """Why the records cannot be used as they are read, if there is a remedy; empty if they can."""
    scales: tuple[str, ...] = ()
    """Sensors whose scale looks wrong, each with its remedy: a diagnosis measures such an error."""


def suspect(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float,
            suspected: bool) -> Suspicion:
    """Other readings of the columns, tried where a fit is `suspected`, or slow least squares leaves more than
    `SUSPICIOUS`; the IMU is always asked whether it contradicts itself. A walker's columns hold either hip by turns, so
    no other reading of one can be tried there."""
    if mechanism.exchanged:
        return Suspicion()
    try:
        with np.errstate(all="ignore"):
            return _suspect(datasets, mechanism, options, gear_ratio, suspected)
    except (*FIT_ERRORS, ValueError):  # too short, or not a number in it: the fit says so itself
        return Suspicion()


def require_sound(setup: Setup) -> None:
    """Raises `FitError` with a remedy if the records contradict themselves as they are read."""
    seen = suspect(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio, False)
    if seen.against:
        raise FitError(f"the columns cannot be right: {'; '.join(seen.against)}; {'; or '.join(seen.remedies)}")


def _suspect(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float,
             suspected: bool) -> Suspicion:
    if options.sensors == "imu" and is_plain(mechanism, options):  # else its joint's motion is in what it reads, too
        as_read, others = read_imu(datasets, mechanism.lever_arm, mechanism.gravity_mps2,
                                   hangs=0 in mechanism.passive)
        if others:
            return Suspicion(_with_imu(datasets, mechanism, options, gear_ratio, as_read, others),
                             ("gyro and accelerometer contradict each other",))
        scale = wrong_scale(datasets, mechanism.lever_arm, mechanism.gravity_mps2, hangs=0 in mechanism.passive)
        if scale:
            return Suspicion((scale,), scales=(scale,))
        lever = wrong_lever(as_read, mechanism.lever_arm)
        if lever:
            seen = _of_columns(datasets, mechanism.with_lever_arm(as_read.lever_arm), options, gear_ratio, suspected)
            return Suspicion(tuple(f"{lever}; {text}" for text in seen.remedies) or (lever,), seen.against)
    return _of_columns(datasets, mechanism, options, gear_ratio, suspected)


def _of_columns(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float,
                suspected: bool) -> Suspicion:
    """Of angles and torques, the IMU taken for right."""
    if not suspected:
        now = as_it_is(datasets, mechanism, options)
        if not now.faults and now.left < SUSPICIOUS:
            return Suspicion()
    now, found = find_remedies(datasets, mechanism, options, gear_ratio)
    explained = not now.faults and now.left < MOST_LEFT
    far = () if found or explained else _far(datasets, mechanism, options)
    if not found and not far:
        return Suspicion()
    most = (f"slow least squares leaves {100 * now.left:.0f} % of the torque",) * (now.left > MOST_LEFT)
    return Suspicion(far or tuple(reading.told(now) for reading in found[:NAMED]), now.faults or most)


def _far(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> tuple[str, ...]:
    """Of joints that swing further than a joint can, where no unit that was tried explains the torque. A joint that
    turned on goes as far as it likes; without gravity no motion shows the unit of an angle."""
    if mechanism.length_unit != "rad" or mechanism.gravity_mps2 == 0.0:
        return ()
    found = []
    for j in options.encoders_of(mechanism.n):
        column = angle_column(mechanism, j)
        span, path = max((float(np.ptp(q)), float(np.abs(np.diff(q)).sum()))
                         for q in (d[column][np.isfinite(d[column])] for d in datasets))
        if span > MOST_SPAN and path > ONE_WAY * span:
            found.append(f"{column} swings over {span:.3g} rad, {span / (2.0 * np.pi):.3g} turns, and explains the "
                         "torque in none of the units rad, deg, turn, mrad, counts: check that it is the angle of this "
                         "joint, and the time of its samples")
    return tuple(found)


def _with_imu(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float,
              as_read: ImuReading, readings: Sequence[ImuReading]) -> tuple[str, ...]:
    """The IMU's reading with which the knee's equation needs the fewest changes of its own."""
    found: list[tuple[int, float, str]] = []
    for imu in readings:
        runs = [imu.applied(data) for data in datasets]
        now, more = find_remedies(runs, mechanism, options, gear_ratio)
        best = now if not now.faults and not more else more[0] if more else now
        told = imu.told(as_read) if not best.remedy.changes else f"{imu.told(as_read)}; {best.told(now)}"
        found.append((imu.changes + best.remedy.changes + 10 * bool(best.faults), best.left, told))
    return tuple(told for _, _, told in sorted(found)[:1])
