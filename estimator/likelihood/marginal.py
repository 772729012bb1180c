"""`log_marginal`: the one criterion by which models of the same records are compared.

    log p(y | beta, sizes, Sigma) = -(S + log det H + log det R) / 2 + sum_k s_k log |det J_k|

S is the weighted sum of squares at the likeliest motion, H the matrix of the latents, R the variances of all rows: the
equation of motion at two Gauss points an interval, torque samples, sensors, a disturbance's process. J_k are the
derivatives of interval k's torques by the motion at its end: by it a density of torques becomes one of motions. s_k is
the share of the joints there whose friction the motion fixes. Where it is free at rest no torque tells the motion, and
R counts in units of the variance of that friction: else the sum would depend on the unit of torque. s_k must not depend
on a level: with the share of the variance that is noise a level that rises by 1 % was worth 11, whatever the data. What
all models of the same records share is left out.

The sum of squares at the likeliest motion alone is no likelihood: it rewards every level that shrinks (Neyman and
Scott, Econometrica 16, 1948). Laplace's approximation: Tierney and Kadane, J. Am. Stat. Assoc. 81, 1986.
"""

from __future__ import annotations

import numpy as np

from estimator.likelihood.disturbance import Process
from estimator.likelihood.gauss_rows import GaussRows
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.normal_equations import Linearised
from estimator.likelihood.state import State
from estimator.numerics import Swept, eliminate


def log_marginal(problem: LatentProblem, state: State) -> float:
    """log p of all readings at a state's parameters and noise, up to a constant of the records. Raises `LinAlgError`.

    The state's motion is the likeliest one under these.
    """
    point = problem.motion_equations(state.x, state.beta, state.noise)
    return marginal_at(problem, state, point, eliminate(point.chain), point.objective)


def marginal_at(problem: LatentProblem, state: State, point: Linearised, solved: Swept, squares: float) -> float:
    """`log_marginal` by the linearisation `point` and its elimination `solved`, where least `squares` are known."""
    noise = state.noise
    weight, rest = problem.motion_weight(noise), problem.stiction(noise)
    free = np.zeros_like(weight) if rest is None else rest[problem.left, 1].T
    open_ = free > 0.0
    if noise.torque_correlation is None:
        torque = float(np.sum(np.log(problem.torque_variance(noise))))
    else:
        precision = noise.torque_precision(problem.torque_variance(noise))
        torque = -problem.total / len(precision) * float(np.sum(np.linalg.slogdet(precision)[1]))
    rows = torque - 2.0 * float(np.sum(np.log(weight**2 * np.where(open_, free, 1.0))))
    rows += 2.0 * problem.log_sensors(noise)
    if problem.disturbed:
        rows += Process.of(noise, problem.dt).log_determinant(problem.ends)
    ahead = GaussRows(problem, state.x, state.beta[: problem.mechanism.p], point.extra).ahead()
    return (-0.5 * (squares + solved.log_determinant() + rows)
            + float(np.linalg.slogdet(ahead)[1] @ (1.0 - open_.mean(axis=0))))
