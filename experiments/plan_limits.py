"""How large a torque may be: the prior model's motion against the rig's limits."""

from __future__ import annotations

import numpy as np

from daq.dataset import FloatArray
from daq.rig import Limits
from experiments.plan_information import Moved, PlanInformation

SHRINK = 0.85
SHRINKS = 24
HALVINGS = 5


def bounds(limits: Limits, margin: float, n: int) -> tuple[float, float, FloatArray]:
    """The share of the limits that is used: torque [N m], speed [rad/s], angles (n,) [rad]."""
    angles = np.array([limits.q1_rad, limits.q2_rad][:n])
    return margin * limits.torque_nm, margin * limits.speed_radps, margin * angles


def keeps(moved: Moved, limits: Limits, margin: float) -> bool:
    """Whether torque, speeds and angles stay within this share of the limits."""
    torque, speed, angles = bounds(limits, margin, moved.q.shape[1])
    slack = 1.0 + 1e-9
    return bool(np.abs(moved.torque).max() <= slack * torque and np.abs(moved.v).max() <= slack * speed
                and (np.abs(moved.q) <= slack * angles).all())


def peaks(moved: Moved) -> dict[str, float]:
    """Largest torque, speed and angles, under the names of the limits."""
    return {"torque_nm": float(np.abs(moved.torque).max()), "speed_radps": float(np.abs(moved.v).max()),
            **{f"q{j + 1}_rad": float(np.abs(moved.q[:, j]).max()) for j in range(moved.q.shape[1])}}


def as_large_as_allowed(prior: PlanInformation, shape: FloatArray, limits: Limits, margin: float,
                        largest_nm: float | None = None) -> Moved | None:
    """The motion under the largest multiple of shape (N,), of peak one, that keeps the limits; None: no size does.

    `largest_nm`: no larger than this. Sizes fall by SHRINK until one keeps them, then the step is halved.
    """
    size = margin * limits.torque_nm if largest_nm is None else min(margin * limits.torque_nm, largest_nm)
    above, found = None, None
    for _ in range(SHRINKS):
        found = _tried(prior, size * shape, limits, margin)
        if found is not None:
            break
        above, size = size, size * SHRINK
    if found is None or above is None:
        return found
    for _ in range(HALVINGS):
        middle = 0.5 * (size + above)
        tried = _tried(prior, middle * shape, limits, margin)
        if tried is None:
            above = middle
        else:
            size, found = middle, tried
    return found


def _tried(prior: PlanInformation, torque: FloatArray, limits: Limits, margin: float) -> Moved | None:
    moved = prior.move(torque)
    return moved if moved is not None and keeps(moved, limits, margin) else None
