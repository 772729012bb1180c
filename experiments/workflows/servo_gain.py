"""A servo's gain from one parameter that is given: all others are known over the gain, so is that one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator import FitError, FitResult, RunNoise


def scaled(result: FitResult, name: str, value: float) -> tuple[FitResult, float, float]:
    """`result` of a fit in units of the servo's gain, as it is where parameter `name` has `value`; the gain, and half
    of its 95 % interval. Raises `FitError` where the fit does not know that parameter.

    With b that parameter, gain = value / b, and beta_k value / b has the covariance of its slope by all of them. What
    runs say one by one is multiplied by the gain of all.
    """
    k = result.mechanism.column(name)
    known, value = float(result.beta[k]), float(value)  # a caller's may be one of numpy's, which no document holds
    if name in result.open_parameters or abs(known) < 2.0 * float(result.std[k]) or value / known <= 0.0:
        raise FitError(f"the runs do not determine {name} over the servo's gain ({known:.3g}, std {result.std[k]:.2g})"
                       ": give servo.gain, or another parameter")
    gain = value / known
    slope = gain * (np.eye(result.beta.size) - np.outer(result.beta, np.eye(result.beta.size)[k]) / known)
    covariance = slope @ result.covariance @ slope.T
    half = gain * float(result.half_width[k]) / abs(known)

    def torques(levels: dict[str, float]) -> dict[str, float]:
        return {channel: level * (gain if channel.endswith("_nm") else 1.0) for channel, level in levels.items()}

    agreement = result.agreement
    if agreement is not None:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        narrower = np.where(result.std > 0.0, agreement.own_std / np.where(result.std > 0.0, result.std, 1.0), 1.0)
        agreement = replace(agreement, own_std=std * narrower, mean=gain * agreement.mean,
                            scatter=gain * agreement.scatter, by_run=gain * agreement.by_run,
                            seen=agreement.seen & (np.arange(agreement.seen.size) != k))
    own, budget = result.run_noise, result.budget
    if budget is not None:
        budget = replace(budget, moved=slope @ budget.moved, parts=tuple(
            replace(part, directions=part.directions @ slope.T) for part in budget.parts))
    share = float(result.std[k]) / known
    loop = tuple(one if one.key == "delay_s" else replace(
        one, value=gain * one.value, std=gain * float(np.hypot(one.std, share * one.value))) for one in result.loop)
    return replace(
        result, loop=loop, beta=gain * result.beta, covariance=covariance, noise=torques(dict(result.noise)),
        torque_residual_rms=gain * result.torque_residual_rms, fixed={name: value}, agreement=agreement, budget=budget,
        at_bound={held: gain * upper for held, upper in result.at_bound.items()},
        run_noise=own and RunNoise(own.runs, {channel: levels * (gain if channel.endswith("_nm") else 1.0)
                                              for channel, levels in own.levels.items()}),
        trajectories=tuple(replace(t, tau=gain * t.tau, tau_measured=gain * t.tau_measured)
                           for t in result.trajectories)), gain, half

