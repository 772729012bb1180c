"""`with_loop_terms`: what a rig does not state of its position loops, estimated together with the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Loop
from estimator.effects import CommandDelay, DampingValue, Effect, LimitValue, MissingIntegral
from estimator.fit_errors import FIT_ERRORS
from estimator.fitting.extension import ExtendedFit, extend, without_sizes
from estimator.fitting.latent_motion import marginal_of
from estimator.result import TWO_SIDED, LoopTerm
from estimator.score import Score, robust_covariance
from estimator.signals import SignalSet

KINDS: dict[str, type[Effect]] = {"delay_s": CommandDelay, "limit": LimitValue, "integral": MissingIntegral,
                                  "damping": DampingValue}
"""Key of `[servo]` -> the effect whose size it is, in the order in which they are tried."""
LATEST_S = 0.2
"""Largest delay of a command that is believed."""
FACTOR = 2.0
"""By which a limit may differ from where it is sought"""
UNLIMITED = 1e6
"""Limit from which on a loop has none"""
LEAST_GAIN, SURE_STD = 0.01, 3.3
"""Fall of -2 log likelihood a sample, and standard deviations from zero, from which on the runs show a value."""


def with_loop_terms(fitted: ExtendedFit, keys: Sequence[str] | None = None, unlimited: bool = False) -> ExtendedFit:
    """The fit with the values `keys`, by default all unknown ones, of every loop that makes the torque of its joint.

    With `unlimited` their limits are held where no motion meets them. It stays as it was where a fit with them does not
    converge.
    """
    state, keys = fitted.state, fitted.options.unknown_loop if keys is None else keys
    own = [(key, j, start) for key in KINDS if key in keys for j in fitted.problem.mechanism.followers
           if (start := _start(fitted, key, j)) is not None]
    if not own:
        return fitted
    held, count = np.array([unlimited and key == "limit" for key, *_ in own]), len(own)
    starts = np.where(held, UNLIMITED, [start for *_, start in own])
    effects = [KINDS[key](j) for key, j, _ in own]
    try:
        _, again = extend(fitted, tuple(zip(effects, starts[:, None])), ~held, state.noise.levels())
    except FIT_ERRORS:
        return fitted
    sizes, std = again.beta[-count:], np.sqrt(np.diag(again.covariance)[-count:])
    if not again.converged or not all(h or _believed(*one) for h, *one in zip(held, own, sizes)):
        return fitted
    terms = tuple(LoopTerm(key, j, float(size) + _stated(fitted.signals, key, j), float(one))
                  for (key, j, _), size, one, h in zip(own, sizes, std, held) if not h)
    return fitted._replace(state=without_sizes(state, again), terms=tuple(zip(effects, sizes[:, None])), loop=terms)


def _believed(one: tuple[str, int, float], size: float) -> bool:
    """Whether a value is near where it was sought. With a limit near zero all parameters and the noise would be zero,
    too, which the likelihood takes for the best of fits."""
    key, _, start = one
    if key == "limit":
        return start / FACTOR < size < start * FACTOR
    return key != "delay_s" or abs(size) <= LATEST_S


def find_loop_terms(fitted: ExtendedFit, sure: Sequence[str]) -> tuple[LoopTerm, ...]:
    """Values of loops by the runs: those of the keys `sure`, then of each other key of `options.unknown_loop` whether
    the runs show it."""
    now, limited = with_loop_terms(fitted, sure), True
    if not now.loop and "limit" in sure:  # with values that may be zero it need not converge: one after the other
        sure = [key for key in sure if key in ("delay_s", "limit")]
        now = with_loop_terms(fitted, sure)
    if any(one.key == "limit" for one in now.loop):
        bare = with_loop_terms(fitted, sure, unlimited=True)
        limited = not bare.terms or _is_shown(now, bare)
    rest = [key for key in KINDS if key in fitted.options.unknown_loop and key not in sure]
    keys, told = list(sure), list[LoopTerm]()
    for key in rest:
        if key == "damping" and not _tells_damping(fitted, now.loop):
            continue
        tried = with_loop_terms(fitted, [*keys, key])
        own = [one for one in tried.loop if one.key == key]
        shown = any(one.value > SURE_STD * one.std for one in own) and _is_shown(tried, now)
        told += [] if shown else [replace(one, found=False) for one in own]
        if shown:
            now, keys = tried, [*keys, key]
    sized = [replace(one, found=one.key == "delay_s" or ((one.key != "limit" or limited)
                                                         and one.value > SURE_STD * one.std)) for one in now.loop]
    return (*sized, *told)


def _is_shown(larger: ExtendedFit, smaller: ExtendedFit) -> bool:
    """Whether -2 log p falls by more than chance, and by a material share."""
    fall = 2.0 * (marginal_of(*larger.whole) - marginal_of(*smaller.whole))
    return fall > max(LEAST_GAIN * larger.whole[0].total, SURE_STD**2)


def scattered(terms: Sequence[LoopTerm], scores: Sequence[Score]) -> tuple[LoopTerm, ...]:
    """`terms` of a fit whose runs disagree, with standard deviations that the scatter of its runs' scores shows.

    The terms are the last of the scores' columns; see `robust_covariance`. None is less than that by noise.
    """
    covariance, quantile = robust_covariance(np.array([one.score for one in scores]),
                                             np.array([one.information for one in scores]))
    wide = (np.sqrt(np.maximum(np.diag(covariance), 0.0)) * quantile / TWO_SIDED)[-len(terms) :]
    return tuple(replace(one, std=max(one.std, float(std))) for one, std in zip(terms, wide))


def _start(fitted: ExtendedFit, key: str, joint: int) -> float | None:
    """Size of a value from which it is sought; None where the runs cannot show it."""
    if key != "limit":
        return 0.0
    stated = _stated_limit(fitted.signals, joint)
    return stated if np.isfinite(stated) else None


def _tells_damping(fitted: ExtendedFit, terms: Sequence[LoopTerm]) -> bool:
    """Whether a loop damps otherwise than viscous friction: by the commanded rate, or within a limit that is met."""
    loops = [loop for j in fitted.problem.mechanism.followers if (loop := _loop(fitted.signals, j)) is not None]
    return any(loop.feedforward for loop in loops) or any(one.key == "limit" for one in terms) or any(
        np.isfinite(_stated_limit(fitted.signals, j)) for j in fitted.problem.mechanism.followers)


def _loop(signals: Sequence[SignalSet], joint: int) -> Loop | None:
    return signals[0].commands.loops[joint] if signals[0].commands is not None else None


def _stated_limit(signals: Sequence[SignalSet], joint: int) -> float:
    loop = _loop(signals, joint)
    return np.inf if loop is None or float(loop.limit) >= UNLIMITED else float(loop.limit)


def _stated(signals: Sequence[SignalSet], key: str, joint: int) -> float:
    """What the loop of a joint has already of a value that its size is added to."""
    loop = _loop(signals, joint)
    return 0.0 if loop is None or key == "limit" else float(getattr(loop, key))
