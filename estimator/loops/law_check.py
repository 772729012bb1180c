"""`check_law`: faults of readings that the law of a joint's position loop shows, the likeliest one first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from daq import FloatArray
from estimator.effects import Effect, named, placed
from estimator.loops.law_faults import LAW_FAULTS
from estimator.loops.law_fit import (
    ALPHA,
    EDGE,
    LEAST_SHARE,
    MOST_FAULTS,
    RIVAL,
    SUFFICES,
    LawFit,
    error_of,
    fitted,
    p_value,
)
from estimator.loops.law_run import LawRun
from estimator.model import Mechanism
from estimator.numerics import student_quantile
from estimator.verdicts import SizeEstimate

BROKEN = 0.1
"""Error as a share of the input beyond which it is not this law that makes the input."""


@dataclass(frozen=True)
class LawCause:
    """One fault that the law shows."""

    effect: str
    joint: int
    """0-based"""
    size: FloatArray
    std: FloatArray
    p_value: float
    share: tuple[float, float]
    """Residual of the law as a share of the input, before and after"""
    rivals: tuple[str, ...] = ()
    """Other effects that explain as much"""
    freedom: int = 1
    """Degrees of freedom of the standard deviation"""
    gain: float = 1.0
    """Of the loop, mean over runs [N m/rad]"""

    def told(self, mechanism: Mechanism, volts: float
             ) -> tuple[Effect, FloatArray, FloatArray, tuple[SizeEstimate, ...]]:
        """The effect, its sizes (k,) in its units, their standard deviations (k,), and the sizes with 95 % intervals.

        `volts` is what a duty of 1 is.
        """
        kind = named(self.effect)
        own = kind.per_joint or (kind.per_motor and len(mechanism.actuated) > 1)
        effect = placed(kind, self.joint if own else None, mechanism)
        factor = {"torque_saturation": volts**-2, "missing_integral": self.gain * volts}.get(self.effect, 1.0)
        size, std = factor * self.size, factor * self.std
        every = zip(effect.sizes, size, student_quantile(self.freedom) * std)
        return effect, size, std, tuple(SizeEstimate(s.name, mechanism.unit(s.unit), float(v), (
            float(v - h), float(v + h))) for s, v, h in every)


@dataclass(frozen=True)
class LawCheck:
    """The law of one joint in several runs, and the faults in it."""

    joint: int
    before: LawFit
    """The law alone"""
    after: LawFit
    """With the faults and with what is a term of the law"""
    causes: tuple[LawCause, ...]

    @property
    def broken(self) -> bool:
        """Whether the input is not made by this law, with all that was found."""
        return self.after.share > BROKEN


def check_law(runs: Sequence[LawRun], joint: int) -> LawCheck:
    """The faults of a joint's (0-based) readings and loop that its law shows in `runs`.

    A fault is named where the law errs by more than LEAST_SHARE, and the fault explains the share SUFFICES of that,
    with a size that differs from zero over runs. Nothing is named where the law with all that was found is `broken`.
    """
    begin = now = LawFit(tuple(runs), ())
    causes: list[LawCause] = []
    while len(now.faults) < MOST_FAULTS and now.share >= LEAST_SHARE:
        taken = {fault.effect for fault, _ in now.faults}
        tried = [fitted(runs, now.faults, fault) for fault in LAW_FAULTS if fault.effect not in taken]
        best = min(tried, key=lambda one: one.deviance)
        gained = now.share**2 - best.share**2
        if gained < SUFFICES * now.share**2 or gained < LEAST_SHARE**2:
            break
        fault, size = best.faults[-1]
        if not fault.of_law:
            std, count = error_of(best)
            p = p_value(size, std, count - 1, len(tried))
            if p > ALPHA:
                break
            causes.append(LawCause(fault.effect, joint, size, std, p, (now.share, best.share),
                                   rivals(best, tried, now), count - 1))
        now = best
    if now.share > BROKEN:  # then its faults are not those of the devices either: a torque controller has no such law
        return LawCheck(joint, begin, begin, ())
    gain = float(now.gains.mean())
    return LawCheck(joint, begin, now, tuple(replace(cause, gain=gain) for cause in causes))


def rivals(best: LawFit, tried: Sequence[LawFit], before: LawFit) -> tuple[str, ...]:
    """Effects that explain as much as the last fault of `best` of what is left of the law `before`, with as few sizes.
    """
    gained, sizes = before.share**2 - best.share**2, best.faults[-1][1].size
    return tuple(fault.effect for one in tried if one is not best for fault, size in one.faults[-1:]
                 if before.share**2 - one.share**2 >= RIVAL * gained and one.share <= EDGE * best.share
                 and size.size <= sizes and not fault.of_law)
