"""`probability_of`: the probability that a diagnosis states of its answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.context import keys_of
from estimator.diagnosis.decision_rule import EDGE
from estimator.diagnosis.error_table import ErrorTable
from estimator.diagnosis.model_comparison import LEAST_APART, margin, nested, set_apart
from estimator.diagnosis.verdict import NOMINAL, Decision, judge


def probability_of(decision: Decision, material: float) -> float | None:
    """Probability (0 to 1) that the answer is true if its causes are among the effects that were tried.

    It is that the stated causes are exactly those present; for `one_of` that one of the sets is; for `partial` that the
    listed causes are present; for `none` that nothing material is. None for `unexplained`, which names no cause.

        P = mean_d 1{V(d) = V} * mean_d [sum_A w_s(d) / sum_s w_s(d)]
        w_s(d) = 1{E_s(d) <= min_t E_t(d) + m E_0(d)} exp(-(G - G_s) / (2 T_s)),  T_s = 1 + L_s / L_0

    d is a resampling of the blocks of the held-out runs. V(d) is the verdict on it and E_s(d) the free-run error of the
    set s, 0 the nominal model and m the material share. A has the stated sets, and s counts all sets of as many
    effects. G_s is their gain, G the largest. T_s tempers the likelihood by what both models have wrong: L_s is the
    `margin` of s and L_0 LEAST_APART. So a set at the limit of a tie has the odds (1 - SURE) / SURE.
    For `none` the second factor is mean_d 1{min_s E_s(d) >= (1 - m) E_0(d)} over all sets s.
    """
    judged = decision.judged
    if judged is None or decision.verdict not in ("none", "named", "partial"):
        return None
    holds = ("named", "partial") if decision.verdict == "partial" else (decision.verdict,)
    table, whole = judged.table, np.arange(judged.table.values.shape[1])[None]
    same = np.mean([judge(replace(judged, table=resampled(table, d), draws=whole), None, material).verdict in holds
                    for d in judged.draws])
    share = share_without_cause if decision.verdict == "none" else share_of_stated
    return float(same) * share(judged.unturned or judged, material)


def share_of_stated(asked: Decision, material: float) -> float:
    """Share of the stated sets in the weights w_s(d) of `probability_of`, a mean over the resamplings.

    A set that is a stated one with another size of zero, as a spring without stiffness is an offset, is no rival.
    """
    stated = {keys_of(e) for e in asked.best}
    count = len(asked.best[0].model.effects)
    rivals = [(e, row) for e, row in asked.possible
              if len(e.model.effects) == count and keys_of(e) != keys_of(asked.best[0])
              and (keys_of(e) in stated or set_apart(e) or not any(nested(best, e) for best in asked.best))]
    sets, rows = zip(*[(asked.best[0], asked.row), *rivals])
    most = max(sets, key=lambda e: e.gain)
    tempered = np.array([1.0 + margin(e, most) / LEAST_APART for e in sets])
    log_odds = np.array([e.gain - most.gain for e in sets]) / (2.0 * tempered)
    own = np.array([keys_of(e) in stated for e in sets])
    shares, nominal = [], asked.table.errors(NOMINAL, asked.draws)
    for errors, whole in zip(np.stack([asked.table.errors(row, asked.draws) for row in rows], axis=1), nominal):
        near = errors <= errors.min() + material * whole
        weights = np.exp(np.where(near, log_odds - log_odds[near].max(), -np.inf))
        shares.append(weights[own].sum() / weights.sum())
    return float(np.mean(shares))


def share_without_cause(asked: Decision, material: float) -> float:
    """Share of the resamplings in which no set reduces the error by a material amount."""
    table, draws = asked.table, asked.draws
    least = (1.0 - material) * table.errors(NOMINAL, draws)
    stays = [table.errors(row, draws) >= least for _, row in asked.possible]
    return float(np.mean(np.all([np.ones(least.shape, dtype=bool), *stays], axis=0)))


def probability_of_no_error(table: ErrorTable, rng: np.random.Generator) -> float:
    """Share (0 to 1) of resamplings whose nominal error stays within the noise: `none` where no effect is detected."""
    return float(np.mean(table.errors(NOMINAL, table.draws(rng)) <= EDGE))


def resampled(table: ErrorTable, blocks: NDArray[np.intp]) -> ErrorTable:
    """`table` on these blocks (B,) of its runs."""
    return replace(table, values=table.values[:, blocks], runs=table.runs[blocks])
