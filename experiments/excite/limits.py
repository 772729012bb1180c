"""Largest torque of a plan: the prior model's motion against the rig's limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray, Limits
from experiments.excite.fisher_information import Moved, PlanInformation

SHRINK = 0.85
SHRINKS = 24
HALVINGS = 5
STEP_DOWN = 0.95
LEAST = 1e-3
"""Smallest size tried, as a share of the torque limit."""
NEIGHBOURS = 8


def bounds(limits: Limits, margin: float, n: int) -> tuple[float, FloatArray, FloatArray]:
    """The share of the limits that is used: torque [N m], speeds (n,) [rad/s], angles (n,) [rad]."""
    angles = np.array([limits.q1_rad, limits.q2_rad][:n])
    pivot = min(limits.speed_radps, limits.q1_speed_radps) if n > 1 else limits.speed_radps  # a single joint is driven
    speeds = np.array([pivot, limits.speed_radps][:n])
    return margin * limits.torque_nm, margin * speeds, margin * angles


def keeps(moved: Moved, limits: Limits, margin: float) -> bool:
    """Whether torque, speeds and angles stay within this share of the limits."""
    torque, speed, angles = bounds(limits, margin, moved.q.shape[1])
    slack = 1.0 + 1e-9
    return bool(np.abs(moved.torque).max() <= slack * torque and (np.abs(moved.v) <= slack * speed).all()
                and (np.abs(moved.q) <= slack * angles).all())


def peaks(moved: Moved) -> dict[str, float]:
    """Largest torque, speed and angles, under the names of the limits."""
    return {"torque_nm": float(np.abs(moved.torque).max()), "speed_radps": float(np.abs(moved.v).max()),
            **{f"q{j + 1}_rad": float(np.abs(moved.q[:, j]).max()) for j in range(moved.q.shape[1])}}


def neighbours(prior: PlanInformation, model_error: float) -> list[PlanInformation]:
    """NEIGHBOURS priors whose parameters are all off by the share `model_error`, up or down as drawn;
    all are possible bodies."""
    rng, informations = np.random.default_rng(0), []
    angles = np.linspace(-np.pi, np.pi, 25)[:, None] * np.eye(prior.n)[-1]
    for _ in range(20 * NEIGHBOURS if model_error > 0 else 0):
        beta = prior.beta * (1.0 + model_error * rng.choice((-1.0, 1.0), prior.beta.size))
        if np.linalg.eigvalsh(prior.mechanism.inertia_matrix(angles, beta)).min() > 0:
            informations.append(prior.with_beta(beta))
        if len(informations) == NEIGHBOURS:
            break
    return informations


def as_large_as_allowed(prior: PlanInformation, shape: FloatArray, limits: Limits, margin: float,
                        largest_nm: float | None = None, others: Sequence[PlanInformation] = ()) -> Moved | None:
    """The motion under the largest multiple of shape (N,), of peak one, that keeps the limits; None: no size does.

    `largest_nm`: no larger than this. Sizes fall by SHRINK until one keeps them, then the step is halved. `others`
    are to keep the whole limits, not the margin's share of them, or the size falls by STEP_DOWN until they do.
    """
    size = margin * limits.torque_nm if largest_nm is None else min(margin * limits.torque_nm, largest_nm)
    above, moved, near = None, None, None  # near: the last motion, kept or not, to begin the next one from
    for _ in range(SHRINKS):
        near = prior.move(size * shape, near)
        if near is not None and keeps(near, limits, margin):
            moved = near
            break
        above, size = size, size * SHRINK
    for _ in range(HALVINGS if moved is not None and above is not None else 0):
        assert above is not None
        middle = 0.5 * (size + above)
        tried = prior.move(middle * shape, moved)
        if tried is None or not keeps(tried, limits, margin):
            above = middle
        else:
            size, moved = middle, tried
    for other in others:
        near = moved
        while moved is not None:
            near = other.move(moved.torque, near)
            if near is not None and keeps(near, limits, 1.0):
                break
            size *= STEP_DOWN
            moved = prior.move(size * shape, moved) if size > LEAST * limits.torque_nm else None
    return moved
