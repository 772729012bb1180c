r"""Test whether runs agree about the parameters, and wider intervals where they do not.

The covariance H^-1 of a fit includes white noise only, and is too small if runs have different parameters. Run r has
score s_r and information I_r at the optimum (sum s_r = 0, sum I_r = H). If all have the same beta, s_r is normal with
covariance I_r - I_r H^-1 I_r:

- Cochran's Q = sum s_r' I_r^-1 s_r is chi-squared with the sum of the ranks of I_r less that of H for its degrees of
  freedom (Cochran, Biometrics 10, 1954, for several parameters at once). What runs disagree about is often one
  parameter, lost in a sum over all: each one's variance in J below, over that in H^-1, is asked as well. Where the
  least of these probabilities, times their number, is below `ALPHA`, runs disagree, else nothing changes.
- The scores' own scatter then makes the covariance, J = H^-1/2 (sum a_r a_r') H^-1/2, where a_r = (1 - B_r)^-1/2
  H^-1/2 s_r and B_r = H^-1/2 I_r H^-1/2: the cluster-robust covariance with the correction CR2, without bias where runs
  agree, and quantiles of Student's t with degrees of freedom by Satterthwaite (Bell and McCaffrey, Survey Methodology
  28, 2002; Pustejovsky and Tipton, J. Bus. Econ. Stat. 36, 2018). In no direction it is less than H^-1.
- Random effects tell where the scatter comes from: beta_r = mu + b_r, b_r normal with variances tau_k^2, by restricted
  maximum likelihood (Laird and Ware, Biometrics 38, 1982) of the runs' one-step estimates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray
from estimator.numerics import inverse_root, pseudo_inverse, student_quantile
from estimator.result import TWO_SIDED, RunAgreement
from estimator.score.run_scores import RunScores
from estimator.score.score import Score
from estimator.score.score_tests import ALPHA

LEAST_SHARE = 1e-6
"""Of what all runs know of a direction: a run that holds less says nothing of it, and runs that leave less to all
others have no second witness."""
CONVERGED = 0.02
"""Relative change of the variances between runs at which their search ends."""
STEPS = 300
"""Most steps of that search."""
SEEN = 0.5
"""Of a variance between runs: with less left unknown in the runs' own values it is seen, not only allowed."""
START = 10.0
"""Variances of a parameter, times the number of runs, at which that search starts: it only shrinks."""


def agreement_of(scores: RunScores, beta: FloatArray, covariance: FloatArray, free: BoolArray,
                 prior: FloatArray | None = None) -> tuple[FloatArray, RunAgreement]:
    """The covariance (p, p) with what runs disagree about, and what there is to say of it.

    Beta (m,) and `free` (m,) are those of the scores, the first p of them the parameters; `covariance` (p, p) is the
    fit's by noise alone. What is known from elsewhere has the information `prior` (p, p): it votes in no run, and what
    runs disagree about moves the parameters the less for it.
    """
    own_std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    index = np.flatnonzero(free)
    if len(scores.scores) < 2 or not index.size:
        return covariance, RunAgreement(scores.runs, None, own_std)
    score, information = arrays(scores.scores)
    score, information = score[:, index], information[:, index[:, None], index]
    root = inverse_root(information.sum(axis=0))
    score = score - information @ (root @ (root.T @ score.sum(axis=0)))  # what is left of steps not taken
    white, share = score @ root, root.T @ information @ root
    adjust, outer = _adjusted(white, share)
    robust = np.sqrt(np.einsum("ki,ij,kj->k", root, outer, root))
    freedom = _freedom(root, share, adjust)
    p_value = probability_of_scatter(homogeneity(white, share), robust**2 / np.maximum(np.sum(root**2, axis=1), 1e-300),
                                     freedom)
    if p_value >= ALPHA:
        return covariance, RunAgreement(scores.runs, p_value, own_std, unit=scores.unit)

    p = len(covariance)
    kept = index < p
    at = index[kept]
    if prior is not None:
        whole = information.sum(axis=0)
        both = whole.copy()
        both[np.ix_(kept, kept)] += prior[np.ix_(at, at)]
        root = pseudo_inverse(both) @ whole @ root
        robust = np.sqrt(np.einsum("ki,ij,kj->k", root, outer, root))
    wide = covariance.copy()
    wide[np.ix_(at, at)] += (root @ _positive(outer - np.eye(index.size)) @ root.T)[np.ix_(kept, kept)]
    std = np.sqrt(np.maximum(np.diag(wide)[at], 1e-300))
    quantile, mean, by_run = np.full(p, TWO_SIDED), beta[:p].copy(), np.tile(beta[:p], (len(scores.runs), 1))
    quantile[at] = np.maximum(TWO_SIDED, (_t_quantiles(freedom) * robust)[kept] / std)
    effects = random_effects(score, information)
    mean[at] += effects.mean[kept]
    by_run[:, at] += (effects.mean + effects.by_run)[:, kept]
    scatter, seen = np.zeros(p), np.zeros(p, bool)
    scatter[at] = effects.scatter[kept]
    seen[at] = (effects.unsure < SEEN * effects.scatter**2)[kept]
    return wide, RunAgreement(scores.runs, p_value, own_std, True, quantile, mean, scatter, by_run, seen, scores.unit)


def arrays(scores: Sequence[Score]) -> tuple[FloatArray, FloatArray]:
    """Scores (R, m) and informations (R, m, m) of R runs."""
    return np.array([one.score for one in scores]), np.array([one.information for one in scores])


def robust_covariance(score: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance (m, m) of parameters by the scatter of R clusters' scores (R, m) with informations (R, m, m), and
    (m,) standard deviations to either side of a 95 % interval: CR2 and Student's t, as above.

    Clusters are independent of each other; within one anything may depend on anything. Directions of which no cluster
    knows have a huge variance.
    """
    whole = information.sum(axis=0)
    root = inverse_root(whole)
    unknown = pseudo_inverse(whole) - root @ root.T
    share = root.T @ information @ root
    adjust, outer = _adjusted(score @ root, share)
    return root @ outer @ root.T + unknown, _t_quantiles(_freedom(root, share, adjust))


def homogeneity(white: FloatArray, share: FloatArray) -> float:
    """Probability of Cochran's Q or more, of scores `white` (R, m) and informations `share` (R, m, m), both in units
    in which the whole information is one."""
    values, vectors = np.linalg.eigh(share)
    along = (vectors.swapaxes(1, 2) @ white[:, :, None])[:, :, 0]
    told = values > LEAST_SHARE
    q = float(np.sum(along[told] ** 2 / values[told]))
    freedom = int(told.sum()) - int(np.sum(np.linalg.eigvalsh(share.sum(axis=0)) > 0.5))
    return _above(q / freedom, freedom) if freedom else 1.0


def probability_of_scatter(whole: float, ratios: FloatArray, freedom: FloatArray) -> float:
    """Probability, by Bonferroni, of one as low as `whole`, or of any variance `ratios` (m,) times what noise makes of
    it, with `freedom` (m,) degrees of freedom."""
    single = min(_above(float(ratio), float(nu)) for ratio, nu in zip(ratios, freedom, strict=True))
    return min(1.0, 2.0 * min(whole, len(ratios) * single))


def _above(ratio: float, freedom: float) -> float:
    """Probability of chi-squared over its degrees of freedom being above `ratio`."""
    spread = 2.0 / (9.0 * freedom)  # Wilson and Hilferty, PNAS 17, 1931: the cube root is nearly normal
    return 0.5 * math.erfc((math.cbrt(ratio) - 1.0 + spread) / math.sqrt(2.0 * spread))


class RandomEffects(NamedTuple):
    """Parameters of R runs as mean and scatter."""

    mean: FloatArray
    """(m,) less the optimum that the scores are of"""
    scatter: FloatArray
    """(m,) tau, standard deviation between runs"""
    by_run: FloatArray
    """(R, m) each run's, less the mean"""
    unsure: FloatArray
    """(m,) variance of those, by what runs do not know; mean over runs"""


def random_effects(score: FloatArray, information: FloatArray) -> RandomEffects:
    """Random effects by scores (R, m) and informations (R, m, m) at one optimum.

    Expectation and maximisation (Laird and Ware): a run's step I_r^-1 s_r is normal with covariance I_r^-1 + T, T the
    diagonal matrix of tau^2, and of runs that do not know all parameters the inverse is never taken.
    """
    size = np.sqrt(np.diag(pseudo_inverse(information.sum(axis=0))))
    s, i = score * size, information * np.outer(size, size)
    tau2 = np.full(s.shape[1], START * len(s))
    for _ in range(STEPS):
        c = np.linalg.inv(i + np.diag(1.0 / tau2))
        ic = i @ c
        spread = pseudo_inverse((i - ic @ i).sum(axis=0))
        mean = spread @ (s - (ic @ s[:, :, None])[:, :, 0]).sum(axis=0)
        effect = (c @ (s - i @ mean)[:, :, None])[:, :, 0]
        ci = c @ i
        unsure = np.einsum("rkk->k", c + ci @ spread @ ci.swapaxes(1, 2)) / len(s)
        before, tau2 = tau2, np.maximum(np.mean(effect**2, axis=0) + unsure, LEAST_SHARE)
        if np.all(np.abs(np.log(tau2 / before))[tau2 > 0.01 * len(s)] < CONVERGED):
            break
    return RandomEffects(mean * size, np.sqrt(tau2) * size, effect * size, unsure * size**2)


def _adjusted(white: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(1 - B_r)^-1/2 (R, m, m), and the sum of a_r a_r' (m, m)."""
    values, vectors = np.linalg.eigh(share)
    rest = 1.0 - values
    factor = np.where(rest > LEAST_SHARE, 1.0 / np.sqrt(np.maximum(rest, LEAST_SHARE)), 0.0)
    adjust = (vectors * factor[:, None, :]) @ vectors.swapaxes(1, 2)
    a = (adjust @ white[:, :, None])[:, :, 0]
    return adjust, a.T @ a


def _positive(matrix: FloatArray) -> FloatArray:
    """The part of a symmetric matrix with positive eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _freedom(root: FloatArray, share: FloatArray, adjust: FloatArray) -> FloatArray:
    """(m,) Satterthwaite's degrees of freedom of each parameter's variance in J, were the runs alike."""
    c = adjust @ root.T  # (R, m, k): what of a run's score enters the k-th parameter
    known = share @ c
    out = np.empty(root.shape[0])
    for k in range(out.size):
        w = np.diag(np.einsum("ri,ri->r", c[:, :, k], known[:, :, k])) - known[:, :, k] @ known[:, :, k].T
        out[k] = np.trace(w) ** 2 / max(float(np.sum(w**2)), 1e-300)
    return np.maximum(out, 1.0)


def _t_quantiles(freedom: FloatArray) -> FloatArray:
    return np.array([student_quantile(float(nu)) for nu in freedom])
