"""`all_uses`: what a fit is good for, its parameters among it, and the words for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

from estimator import FitResult, TorqueError, Use, best_first, use_of_parameters
from experiments.judge.budget import leading
from experiments.judge.fit_checks import check_fit

UNFIT = ("sensor_scale", "rig_contradiction")
"""Kinds of suspect results that speak against every use: held-out data have the same wrong reading."""


def all_uses(result: FitResult) -> tuple[Use, ...]:
    """Uses of a fit, the supported ones first; of its parameters by the interval of the leading one."""
    k = leading(result)
    against = [one for one in (*result.findings, *check_fit(result)) if one.role in ("fault", "doubt")]
    unfit = any(one.role == "fault" or one.kind in UNFIT for one in against)
    found = [replace(one, supported=one.supported and not unfit) for one in result.uses]
    if k is not None and result.converged:
        found.append(use_of_parameters(float(result.half_width[k]), float(result.beta[k]), not against))
    return best_first(found)


def best_words(uses: Sequence[Use]) -> str:
    """The first supported use that was measured, for the first line; empty without any."""
    said = [_words(one) for one in uses if one.supported and one.measured_on == "held_out"]
    return f"{said[0]} on held-out data" if said else ""


def uses_line(uses: Sequence[Use]) -> str:
    """Every use that was measured, with its interval, and errors of the torque by speed; empty without any."""
    said = " and ".join(f"{_words(one)} {_within(one.ci95, 100.0)}" for one in uses if one.measured_on == "held_out")
    by_speed = [f". The torque of joint {joint} errs by {', '.join(_error(one) for one in same)}"
                for joint, same in groupby((error for one in uses for error in one.by_speed), lambda one: one.joint)]
    return f"{said} of the spread of what is measured, on one more run{''.join(by_speed)}" if said else ""


def _error(error: TorqueError) -> str:
    return f"{error.rms:.2g} {error.unit} {'at rest' if error.speed == 'rest' else error.speed} {_within(error.ci95)}"


def _within(ci95: tuple[float, float] | None, scale: float = 1.0) -> str:
    return f"[{', '.join(f'{scale * end:.2g}' for end in ci95)}]" if ci95 else "(too few runs for an interval)"


def _words(use: Use) -> str:
    share = f"to {100 * use.figure:.2g} %"
    return f"predicts {use.horizon_s:.3g} s {share}" if use.use == "simulation" else f"gives the torque {share}"
