"""Rows of the equation of motion at the Gauss points, for what is asked of them alone: how large they are, and how far
the latents follow them."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.measured_runs import slack_of
from estimator.likelihood.memory import pieces
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Extra, Latents
from estimator.numerics import Swept

PIECE = 2048
"""Intervals that are worked on at a time."""
LEAST_OPEN = 1e-6
"""Least share of the rows that counts as not followed by the latents: a level divides by it."""


class GaussRows:
    """Residuals r [N m] and derivatives J of the equation of motion on all K intervals, at one motion, where beta (p,)
    are the mechanism's parameters."""

    def __init__(self, problem: LatentProblem, x: Latents, beta: FloatArray, extra: Extra | None) -> None:
        c, left, n = problem.collocation, problem.left, problem.n
        z, self.slopes = c.fast(*c.motion(x.q, x.v, left), beta)
        """Derivatives (n, 2, 5, n, K) of r by the features of each joint's motion"""
        self.residual = (beta @ z.reshape(len(beta), -1)).reshape(n, 2, -1) - c.torque(x.u, left)
        """(n, 2, K)"""
        if problem.between is not None:
            self.residual -= problem.between
        if extra is not None:
            self.residual += extra.torque
            if extra.slopes is not None:
                self.slopes += extra.slopes.transpose(0, 3, 1, 2, 4)
        self._problem = problem

    def of(self, joint: int, here: slice) -> FloatArray:
        """(2, K', 2 b) derivatives of one joint's residuals by the latents at both ends of the intervals `here`."""
        p, n, b = self._problem, self._problem.n, self._problem.block
        slopes = self.slopes[joint, :, :, :, here]
        out = np.zeros((2, slopes.shape[-1], 2 * b))
        for end in range(2):
            for d in range(2):  # angles, then rates
                at = end * b + d * n
                out[:, :, at : at + n] = np.einsum("gf,gfjk->gkj", p.collocation.basis[..., 2 * end + d], slopes)
            out[:, :, end * b + 2 * n + joint] = -p.collocation.torque_weights[:, end, None]
        return out

    def ahead(self) -> FloatArray:
        """(K, 2 n, 2 n) derivatives of both rows of all joints by angles and rates at the end of each interval."""
        n, b = self._problem.n, self._problem.block
        every = np.concatenate([self.of(j, slice(None)) for j in range(n)])
        return np.ascontiguousarray(every[..., b : b + 2 * n].swapaxes(0, 1))

    def followed(self, solved: Swept, joint: int) -> FloatArray:
        """(2, K) variance [N^2 m^2] of one joint's residuals by what is open of the latents: diag(J P J^T)."""
        diagonal, upper = solved.inverse_blocks()
        b, left = self._problem.block, self._problem.left
        found = np.empty(self.residual.shape[1:])
        for here, start in pieces(left, PIECE):
            start = np.arange(start.start, start.stop) if isinstance(start, slice) else start
            rows = self.of(joint, here)
            first, second = rows[..., :b], rows[..., b:]
            found[:, here] = (np.einsum("gki,kij,gkj->gk", first, diagonal[start], first, optimize=True)
                              + np.einsum("gki,kij,gkj->gk", second, diagonal[start + 1], second, optimize=True)
                              + 2.0 * np.einsum("gki,kij,gkj->gk", first, upper[start], second, optimize=True))
        return found


def unseen_level(problem: LatentProblem, x: Latents, parameters: FloatArray, noise: Noise, solved: Swept) -> FloatArray:
    """(n,) likeliest standard deviation [N m] of the torque that no sample shows, where joints have one; else zero.

    sigma^2 = sum r^2 / (rows - tr(J P J^T) / sigma^2), rows at rest counted less; sigma holds the equation's slack.
    """
    beta = parameters[: problem.mechanism.p]
    rows = GaussRows(problem, x, beta, problem.extra(x, parameters, columns=False) if problem.acts else None)
    own = np.broadcast_to(problem.motion_level(noise) ** 2, (problem.n, problem.left.size))
    share, found = own * problem.motion_weight(noise) ** 2, np.zeros(problem.n)
    slack = slack_of(problem.mechanism) * noise.torque
    for j in map(int, np.flatnonzero(noise.unseen)):
        weight, count = share[j] / np.sqrt(own[j]), 2.0 * float(np.sum(share[j]))
        open_ = max(count - float(np.sum(weight**2 * rows.followed(solved, j))), LEAST_OPEN * count)
        ratio = float(np.sum((weight * rows.residual[j]) ** 2)) / open_
        found[j] = np.sqrt(max(ratio * (slack[j] ** 2 + noise.unseen[j] ** 2) - slack[j] ** 2, 0.0))
    return found
