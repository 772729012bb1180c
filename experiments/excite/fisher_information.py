"""Fisher information of a torque plan about the parameters, and its gradient by the torque.

F is the information of the default fit at the prior's own motion: the equation of motion at two Gauss points an
interval, torque, encoders and gyro as in `latent_problem`, with one simplification:
the accelerometer counts as a
tilt sensor of sigma_a / g (its lever arm's share is small compared with the gyro's). Latents are eliminated exactly,

    F = min over Y of |J_beta - J_x Y|^2,

so a change of F for fixed weights needs no derivative of Y: with y, w fixed and r = J_beta w - J_x y the gradient of
w' F w by the motion is twice the derivative of (J_x)' r in the direction (-y, w), and the adjoint of the simulation
carries it to the torque. One value and gradient cost a few simulations, however many numbers describe the torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray
from estimator.fitting import PASSIVE_SHARE
from estimator.likelihood import REST_SPREAD, slack_of
from estimator.model import Collocation, Mechanism, simulate
from estimator.numerics import BlockTridiagonal, eliminate, solve_bidiagonal

SMOOTH_RADPS = 0.03
"""Least friction smoothing velocity here: smaller ones make the criterion rough for the optimiser."""
STEP = 1e-6
"""Of the difference quotient, as a share of one radian or of the parameters."""


@dataclass(frozen=True)
class Moved:
    """A plan's motion on the prior model."""

    torque: FloatArray
    """(N,) of the driven joint [N m]"""
    q: FloatArray
    """(N, n)"""
    v: FloatArray
    """(N, n)"""


class PlanInformation:
    """Information on beta (p,) of a run from rest, for one mechanism, noise and rate."""

    def __init__(self, mechanism: Mechanism, beta: FloatArray, noise: Mapping[str, float], rate_hz: float,
                 has_imu: bool) -> None:
        """`noise` by channel, for samples at `rate_hz`."""
        self.rest_radps = REST_SPREAD * mechanism.velocity_scales
        wide = np.maximum(mechanism.velocity_scales, SMOOTH_RADPS)
        self.mechanism = replace(mechanism, velocity_scale=tuple(wide.tolist()))
        self.beta, self.rate_hz, self.n = beta, rate_hz, mechanism.n
        self.driven = mechanism.actuated[0]
        self.collocation = Collocation(self.mechanism, 1.0 / rate_hz, "zero")
        torque = np.full(self.n, PASSIVE_SHARE * noise["torque_nm"])
        torque[self.driven] = noise["torque_nm"]
        self.torque_level = np.maximum(torque, [noise.get("passive_joint_nm", 0.0) if j != self.driven else 0.0
                                                for j in range(self.n)])
        self.q_weight, self.v_weight = np.full(self.n, noise["encoder_rad"] ** -2.0), np.zeros(self.n)
        if has_imu:
            self.q_weight[0] = (mechanism.gravity_mps2 / noise.get("accel_x_mps2", noise["accel_mps2"])) ** 2
            self.v_weight[0] = noise["gyro_radps"] ** -2.0
        self.dry = np.zeros(self.n)
        for k, parameter in enumerate(mechanism.parameters):
            if parameter.term == "coulomb":
                self.dry[parameter.at[0]] = beta[k]

    def with_beta(self, beta: FloatArray) -> PlanInformation:
        """The same for other parameters (p,), for its motion only: what dry friction leaves open stays."""
        other = copy(self)
        other.beta = beta
        return other

    def move(self, torque: FloatArray, guess: Moved | None = None) -> Moved | None:
        """The motion under torque (N,), zero-order hold; None where it diverges."""
        tau = np.zeros((torque.size, self.n))
        tau[:, self.driven] = torque
        rest = np.zeros(self.n)
        q, v, _ = simulate(self.mechanism, self.beta, rest, rest, tau, 1.0 / self.rate_hz, "zero",
                           None if guess is None else (guess.q, guess.v))
        return Moved(torque, q, v) if np.isfinite(q).all() else None

    def eliminated(self, moved: Moved) -> Eliminated:
        """F there, with what its gradient needs. Raises LinAlgError where it cannot be solved."""
        n, p, (count, _) = self.n, self.mechanism.p, moved.q.shape
        left = np.arange(count - 1)
        motion = self.collocation.motion(moved.q, moved.v, left)
        z, slopes = self.collocation.terms(motion)
        shape = motion.angle.shape[1:]
        scale = 1.0 / (slack_of(self.mechanism) * self.torque_level)
        jac = self.collocation.jacobian(slopes, self.beta, shape)  # (n, 2, 4, n, K)
        rows = np.zeros((count - 1, n, 2, 2, 3, n))  # ..., end, (q, v, u), joint
        rows[:, :, :, :, :2] = jac.transpose(4, 0, 1, 2, 3).reshape(count - 1, n, 2, 2, 2, n)
        for j in range(n):
            rows[:, j, :, :, 2, j] = -self.collocation.torque_weights
        rows = (rows * scale[:, None, None, None, None]).reshape(count - 1, 2 * n, 6 * n)
        border = (self.collocation.to_joint(z) * scale[:, None, None]).transpose(3, 1, 2, 0).reshape(-1, 2 * n, p)
        local = rows.swapaxes(1, 2) @ rows
        b = 3 * n
        diagonal = np.zeros((count, b, b))
        diagonal[:-1] += local[:, :b, :b]
        diagonal[1:] += local[:, b:, b:]
        at = np.arange(n)
        diagonal[:, at, at] += self.q_weight
        diagonal[:, n + at, n + at] += self.v_weight
        diagonal[:, 2 * n + at, 2 * n + at] += self._torque_weight(moved.v)[0]
        right = np.zeros((count, b, p))
        at_ends = rows.swapaxes(1, 2) @ border
        right[:-1] += at_ends[:, :b]
        right[1:] += at_ends[:, b:]
        solved = eliminate(BlockTridiagonal.of(diagonal, local[:, b:, :b], right.reshape(-1, p)))
        ends = solved.solutions()
        residual = border - rows @ np.concatenate([ends[:-1], ends[1:]], axis=1)
        return Eliminated(np.einsum("krp,krq->pq", border, border) - solved.product(), ends, residual, jac)

    def _torque_weight(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """1 / variance of torque samples (N, n), and its derivative by v: a joint near rest holds any torque."""
        root = np.sqrt(v * v + self.rest_radps**2)
        open_part = 1.0 - np.abs(v) / root
        variance = self.torque_level**2 + (self.dry * open_part) ** 2
        slope = -2.0 * self.dry**2 * open_part * np.sign(v) * self.rest_radps**2 / root**3
        return 1.0 / variance, -slope / variance**2

    def by_motion(self, moved: Moved, at: Eliminated, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient of trace(weights' F weights) by q and v, each (N, n), for weights (p, m)."""
        n, count = self.n, len(moved.q)
        by_q, by_v = np.zeros((count, n)), np.zeros((count, n))
        y = np.einsum("kbp,pm->mkb", at.latents, weights)
        r = np.einsum("krp,pm->mkr", at.residual, weights) / np.repeat(slack_of(self.mechanism) * self.torque_level, 2)
        slope = self._torque_weight(moved.v)[1]
        for m, w in enumerate(weights.T):
            along_q, along_v = y[m, :, :n], y[m, :, n : 2 * n]
            size = STEP / max(float(np.max(np.abs(y[m, :, : 2 * n]))), float(np.max(np.abs(w / self.beta))), 1e-300)
            for sign in (1.0, -1.0):
                e = sign * size
                at_ends = self._carried_back(moved.q - e * along_q, moved.v - e * along_v, self.beta + e * w, r[m])
                part = sign * at_ends / size  # twice the derivative: 2 / (2 size)
                by_q[:-1] += part[:, 0]
                by_v[:-1] += part[:, 1]
                by_q[1:] += part[:, 2]
                by_v[1:] += part[:, 3]
            by_v += slope * y[m, :, 2 * n :] ** 2
        return by_q, by_v

    def _carried_back(self, q: FloatArray, v: FloatArray, beta: FloatArray, r: FloatArray) -> FloatArray:
        """(K, 4, n): residuals r (K, 2 n) of the motion carried back to each interval's ends."""
        motion = self.collocation.motion(q, v, np.arange(len(q) - 1))
        slopes = self.collocation.terms(motion)[1]
        jac = self.collocation.jacobian(slopes, beta, motion.angle.shape[1:])
        n = self.n
        return np.asarray(np.einsum("jgeiK,Kjg->Kei", jac, r.reshape(-1, n, 2)))

    def by_torque(self, at: Eliminated, by_q: FloatArray, by_v: FloatArray) -> FloatArray:
        """Gradient by the driven joint's torque (N,) of what has these gradients by the motion: the adjoint."""
        count, b = len(by_q) - 1, 2 * self.n
        left, own = at.jacobian.transpose(2, 3, 1, 0, 4).reshape(2, b, b, count)  # variable, equation, interval
        blocks = np.stack([np.roll(left, -1, axis=-1), own], axis=1)[..., ::-1]  # the last interval first
        right = np.concatenate([by_q[1:], by_v[1:]], axis=1).T[:, ::-1]
        multiplier = solve_bidiagonal(blocks, right)[::-1].reshape(count, 2, self.n)[:, :, self.driven]
        weights = self.collocation.torque_weights
        out = np.zeros(count + 1)
        out[:-1] += multiplier @ weights[:, 0]
        out[1:] += multiplier @ weights[:, 1]
        return out


@dataclass(frozen=True)
class Eliminated:
    """F at one motion, and what is left of the equations there."""

    information: FloatArray
    """(p, p)"""
    latents: FloatArray
    """(N, 3 n, p) Y: how q, v, u follow beta."""
    residual: FloatArray
    """(N - 1, 2 n, p) the equation of motion's rows of J_beta - J_x Y."""
    jacobian: FloatArray
    """(n, 2, 4, n, N - 1) of the equation of motion, unscaled."""
