"""Form of friction in a motion without motors: what each of its terms takes of the energy that is lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator import FitResult


class FrictionShare(NamedTuple):
    """Share of Coulomb friction in the energy that the friction of a joint dissipates."""

    joint: int
    """From 1."""
    coulomb: float
    low: float
    """Of its 95 % interval, as `high`; both within 0 and 1."""
    high: float


def friction_shares(result: FitResult) -> list[FrictionShare]:
    """One for each joint with both terms.

    Empty if a joint is driven, since the motor's power hides the dissipation, or if neither term is positive.
    """
    if result.mechanism.actuated or not result.trajectories:
        return []
    qd = np.concatenate([path.qd for path in result.trajectories])
    shares = []
    for j in range(result.mechanism.n):
        columns = [k for k, p in enumerate(result.mechanism.parameters)
                   if p.term in ("coulomb", "viscous") and p.at[0] == j]
        names = {result.mechanism.parameters[k].name for k in columns}
        if len(columns) < 2 or names & result.open_parameters or not np.any(result.beta[columns] > 0.0):
            continue
        share, half = coulomb_share(result, columns, qd[:, j])
        low, share, high = np.clip([share - half, share, share + half], 0.0, 1.0)
        shares.append(FrictionShare(j + 1, float(share), float(low), float(high)))
    return shares


def coulomb_share(result: FitResult, columns: list[int], qd: FloatArray) -> tuple[float, float]:
    """Share of the work of Coulomb friction in that of both parameters `columns`, at speeds `qd` (N,), and half of its
    95 % interval, to first order."""
    coulomb = [result.mechanism.parameters[k].term == "coulomb" for k in columns]
    work = np.array([np.sum(np.abs(qd)) if dry else np.sum(qd**2) for dry in coulomb])
    loss = work * result.beta[columns]
    share = float(loss @ coulomb / np.sum(loss))
    slope = work * (np.array(coulomb, dtype=float) - share) / np.sum(loss)
    variance = float(slope @ result.covariance[np.ix_(columns, columns)] @ slope)
    widest = float(np.max(result.half_width[columns] / np.maximum(result.std[columns], 1e-300)))
    return share, widest * np.sqrt(variance)
