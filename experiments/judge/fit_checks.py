"""Findings about a fit from its own residuals, intervals and physics.

The thresholds stand here and in docs/trust.md, which says what they were held against.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator import Finding, FitResult
from estimator.prediction import repeated_share, state_columns, taken
from experiments.judge.agreement import disputed, units
from experiments.judge.opinion import disagreement
from experiments.judge.prior import contradictions_of
from experiments.judge.residuals import STRONG, autocorrelation, residuals_of, torque_autocorrelation

STRUCTURE = 0.3
"""Correlation of a driven joint's torque residual, at any of 25 lags, less that of a right model, beyond which the
model lacks something."""
NEIGHBOURS = 4
"""Lags at which the estimated motion colours the residuals of sensors, on a right model too: they are not looked at."""
GOOD_FIT, ROUGH_FIT = 90.0, 70.0
"""Fit [%], 100 (1 - rms error / rms motion about its mean): from here on trusted, from there on roughly."""
REPEATED, SEGMENTS = 0.5, 8
"""Share of an unmeasured torque, predicted from other runs, beyond which it is structure; parts of a single run."""
LEAST_P = 1e-9
"""A smaller probability is printed as this one."""
HELD = ("torque_residual", "passive_joint", "sensor_residual", "repeating_torque")
"""Kinds of findings about residuals that intervals with a budget hold, where the runs enlarge no tolerance by more
than ALLOWED."""
ALLOWED = 4.0
"""Factor by which runs may enlarge a tolerance."""
PRECISE = 0.1
"""Half of a 95 % interval over the value, beyond which a parameter counts as loosely known."""


def check_fit(result: FitResult) -> list[Finding]:
    """Findings in addition to those in `result`: faults alone if there are any, else suspect results and facts."""
    names = {p.name for p in result.mechanism.parameters} - set(result.fixed)
    if not result.converged:
        return [Finding("fault", "not_converged", "the fit did not converge")]
    if names and names <= result.open_parameters:
        return [Finding("fault", "undetermined", "these runs determine no parameter")]
    if any(one.role == "fault" for one in result.findings):
        return []
    impossible = _impossible(result)
    if impossible:
        return [Finding("fault", "impossible", text) for text in impossible]
    return [*_findings(result), *_facts(result)]


def _findings(result: FitResult) -> list[Finding]:
    """Reasons not to trust the parameters."""
    apart, held = disagreement(result), within_budget(result)
    findings = [] if apart is None else [Finding("doubt", "estimators_disagree", apart)]
    if result.method in ("mle", "shooting"):
        allowed = f"; the intervals allow for what {units(result)} disagree about" if disputed(result) else \
            "" if result.method == "shooting" else " and the intervals are too narrow"
        if over := [f"joint {j} ({r:.2f})" for j, r in _structure(result).items() if r > STRUCTURE]:
            findings.append(Finding("doubt", "torque_residual", f"the torque residual of {', '.join(over)} is "
                                    f"autocorrelated (limit {STRUCTURE:g}): the model is missing something{allowed}"))
        findings += _sensor_findings(result)
        findings += _repeating_torques(result)
        findings += _omitted(result)
    if held:
        findings = [replace(one, role="fact", text="the tolerances in the intervals hold this: "
                            f"{one.text.partition(': ')[0]}") if one.kind in HELD else one for one in findings]
    findings += [Finding("doubt", "prior", text) for text in contradictions_of(result)]
    findings += _unknown(result)
    if result.undetermined:
        findings.append(Finding("doubt", "undetermined",
                                f"these runs do not determine {', '.join(map(str, result.undetermined))}"))
    return findings


def within_budget(result: FitResult) -> bool:
    """Whether the runs show nothing that the tolerances, or a few times these, do not hold.

    Noise that takes much of the torque hides what a tolerance would have to grow for. Where no joint is driven the
    budget has no tolerance of a torque.
    """
    noisy = any(one.kind == "noise_share" for one in result.findings)
    return (result.budget is not None and bool(result.mechanism.actuated) and not noisy
            and max(result.budget.enlarged.values(), default=1.0) <= ALLOWED)


def _facts(result: FitResult) -> list[Finding]:
    """What limits the use of the parameters."""
    disputes = ", ".join(result.mechanism.names[k] for k in disputed(result))
    loose = _loose(result)
    return [*([Finding("fact", "runs_disagree", f"{units(result).capitalize()} disagree about {disputes}; the "
                       "intervals allow for it")] if disputes else []),
            *([Finding("fact", "loose", f"Wide intervals: {', '.join(loose)}")] if loose else []),
            Finding("fact", "not_shown", "No residual shows a wrong sensor scale: it changes the parameters instead")]


def _impossible(result: FitResult) -> list[str]:
    """What physics forbids of parameters that the runs determine: negative masses, friction that drives."""
    found = []
    paths = [path.q[:: max(1, len(path.q) // 200)] for path in result.trajectories]
    q = np.concatenate(paths) if paths else np.zeros((1, result.mechanism.n))
    least = np.linalg.eigvalsh(result.mechanism.inertia_matrix(q, result.beta))
    masses = {p.name for p in result.mechanism.parameters if p.term in ("inertia", "rotor")}
    if not masses & result.open_parameters and (not np.isfinite(least).all() or least.min() <= 0.0):
        found.append("a mass that is not positive")
    for p, value, std in zip(result.mechanism.parameters, result.beta, result.std):
        if "friction" in p.meaning and p.name not in result.open_parameters and value + 3.0 * std < 0.0:
            found.append(f"{p.name}, {p.meaning}, is negative")
    return found


def _structure(result: FitResult) -> dict[int, float]:
    """Driven joint, from 1 -> largest correlation of its torque's residual at 25 lags, less what a right model
    leaves."""
    found = residuals_of(result)
    return {j + 1: torque_autocorrelation(result, j, found[name]).largest
            for j in result.mechanism.actuated if (name := f"torque {j + 1}") in found}


def _sensor_findings(result: FitResult) -> list[Finding]:
    """What passive joints and the sensors' own residuals say against a fit.

    Nothing drives a passive joint, and no torque sensor's noise is in its equation: an error beyond that noise is the
    model's, or that of the sensors of motion.
    """
    findings: list[Finding] = []
    passive, driven = result.noise.get("passive_joint_nm", 0.0), result.noise.get("torque_nm", 0.0)
    if passive > driven > 0.0:
        findings.append(Finding("doubt", "passive_joint", "the torque residual of a joint without a motor is "
                             f"{passive:.2g} N m, above the torque noise of the driven joint ({driven:.2g} N m): the "
                             "model or a sensor is wrong"))
    far = {name: float(np.max(np.abs(autocorrelation(name, residuals).values[NEIGHBOURS:])))
           for name, residuals in residuals_of(result).items() if not name.startswith("torque")}
    if over := [f"{name} ({r:.2f})" for name, r in far.items() if r > STRONG]:
        findings.append(Finding("doubt", "sensor_residual", f"the residual of {', '.join(over)} is autocorrelated "
                                f"(limit {STRONG:g})"))
    return findings


def _repeating_torques(result: FitResult) -> list[Finding]:
    """Disturbance torques that are functions of the state: structure that a law is missing for, and no disturbance.

    Structure smaller than the noise of a measured torque is left out. Parts of a single run stand for runs.
    """
    paths = result.trajectories
    if not paths or paths[0].disturbance is None or not (noise := result.noise.get("torque_nm", 0.0)):
        return []
    q, v, torque, e = (np.concatenate([getattr(path, name) for path in paths])
                       for name in ("q", "qd", "tau_measured", "disturbance"))
    ends = np.cumsum([len(path.q) for path in paths])
    run = np.repeat(np.arange(len(paths)), np.diff(ends, prepend=0)) if len(paths) > 1 else \
        np.arange(len(q)) * SEGMENTS // len(q)
    columns = state_columns(q, v, torque[:, list(result.mechanism.actuated)], ends)
    found, which = [], taken(len(q))
    for j, share in enumerate(repeated_share(e[which], columns, run[which])):
        size = float(np.sqrt(share * np.mean(e[:, j] ** 2)))
        if share > REPEATED and size > noise:
            found.append(Finding("doubt", "repeating_torque", f"an unmeasured torque of {size:.2g} N m (rms) at joint "
                                 f"{j + 1} is a function of the state: the model lacks a term"))
    return found


def _unknown(result: FitResult) -> list[Finding]:
    """Inertias and gravity terms that the budget leaves wholly unknown."""
    wide = [p.name for p, value, half in zip(result.mechanism.parameters, result.beta, result.half_width)
            if p.rigid and half > abs(value) and p.name not in {*result.fixed, *result.at_bound}]
    return [] if result.budget is None or not set(wide) - result.open_parameters else [
        Finding("doubt", "budget", f"the interval of {', '.join(wide)} is wider than the value")]


def _omitted(result: FitResult) -> list[Finding]:
    """The most significant listed effect that the residuals look like and that would move a parameter far."""
    if not result.omitted:
        return []
    first, *others = result.omitted
    name, _, joint = first.effect.partition("@")
    where = f"{name} (joint {joint})" if joint else name
    more = f". So would {len(others)} other{'s' * (len(others) > 1)}" if others else ""
    return [Finding("doubt", "omitted_effect", f"the residuals look like {where}, which the model lacks "
                    f"(p {max(first.p_value, LEAST_P):.1g}); it would move {first.parameter} by "
                    f"{first.half_widths:.1f} half widths of its interval{more}")]


def _loose(result: FitResult) -> list[str]:
    found = []
    for p, value, half in zip(result.mechanism.parameters, result.beta, result.shown_half_width):
        share = half / abs(value) if value else np.inf
        if p.name not in result.open_parameters and p.name not in result.fixed and share > PRECISE:
            found.append(f"{p.name} ({p.meaning}) to {100 * share:.0f} %" if share <= 1.0 else
                         f"{p.name} ({p.meaning}), wider than its value" if np.isfinite(share) else p.name)
    return found
