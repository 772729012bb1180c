"""Whether a model can be trusted, and for what: the first line of `legid fit` and `legid validate`.

The thresholds stand here and in docs/trust.md, which says what they were held against.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq import FloatArray
from estimator import FitResult
from estimator.model import VELOCITY_SCALE
from experiments.models import GYRO, SHORT_S, MechanismSettings, Prediction
from experiments.reports.html import Level, VerdictBox
from experiments.reports.residual_tests import (
    STRONG,
    autocorrelation,
    fit_percent,
    residuals_of,
    torque_fit,
    torque_step,
)
from experiments.reports.run_agreement import disputed

STRUCTURE = 0.3
"""Correlation of a driven joint's torque residual, at any of 25 lags, beyond which the model lacks something."""
NEIGHBOURS = 4
"""Lags at which the estimated motion colours the residuals of sensors, on a right model too: they are not looked at."""
GOOD_FIT, ROUGH_FIT = 90.0, 70.0
"""Fit [%], 100 (1 - rms error / rms motion about its mean): from here on trusted, from there on roughly."""
PRECISE = 0.1
"""Half of a 95 % interval over the value, beyond which a parameter counts as loosely known."""


@dataclass(frozen=True)
class Trust:
    """An answer in one line, and what it rests on."""

    level: Level
    sentence: str
    reasons: tuple[str, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """For the JSON documents."""
        return {"level": self.level, "sentence": self.sentence, "reasons": list(self.reasons)}

    def verdict(self, warnings: Sequence[str] = ()) -> VerdictBox:
        """For the head of a page."""
        title, _, rest = self.sentence.partition(": ")
        lines = [f"{rest[:1].upper()}{rest[1:]}"] if rest else []
        return VerdictBox(self.level, title, [*lines, *self.reasons], [f"Warning: {text}" for text in warnings])


def fit_trust(result: FitResult, contradictions: Sequence[str] = ()) -> Trust:
    """Of a fit by itself: what its residuals, its intervals and physics say. Free runs are `validation_trust`'s."""
    names = {p.name for p in result.mechanism.parameters} - set(result.fixed)
    if not result.converged:
        return Trust("bad", "NOT TO BE USED: the fit did not converge.")
    if names and names <= result.open_parameters:
        return Trust("bad", "NOT TO BE USED: these runs determine no parameter.")
    impossible = _impossible(result)
    if impossible:
        return Trust("bad", f"NOT TO BE USED: no leg has these parameters ({'; '.join(impossible)}).")
    tested = result.method == "mle"
    structure, torque = _structure(result) if tested else {}, _torque_fit(result)
    disputes = _disputes(result)
    allowed = "; the intervals allow for what runs disagree about" if disputes else " and the intervals are too narrow"
    doubts = [f"the torque left over at joint {j} has structure (correlation {r:.2f}, {STRUCTURE:g} allowed), so "
              f"something is missing in the model{allowed}: see legid diagnose"
              for j, r in structure.items() if r > STRUCTURE]
    doubts += _sensor_doubts(result) if tested else []
    doubts += [f"these runs do not determine {', '.join(map(str, result.undetermined))}"] if result.undetermined else []
    doubts += [f"the rig file contradicts a run: {text}" for text in contradictions]
    fits = "; ".join(f"torque of joint {j} {share:.1f} %" for j, share in torque.items())
    loose = _loose(result)
    facts = [*([f"Fit: {fits} ({GOOD_FIT:g} wanted)."] if fits else []),
             *([f"Runs disagree about {disputes}: the next run may differ as much."] if disputes else []),
             *([f"Known loosely: {', '.join(loose)}."] if loose else []),
             "What no residual shows: a wrong scale of a sensor passes for other parameters. Calibrate.",
             "How far a simulation follows the leg is not known until legid validate has tried it on other runs."]
    if doubts:
        use = ("" if not torque else " Good for torque feedforward within the motion fitted."
               if min(torque.values()) >= GOOD_FIT else " Good for rough torque feedforward only."
               if min(torque.values()) >= ROUGH_FIT else " Not good for torque feedforward either.")
        return Trust("caution", f"DO NOT TRUST the parameters: {'; '.join(doubts)}.{use}", tuple(facts))
    if tested and not result.mechanism.actuated:
        return Trust("caution", f"TRUST the ratios of the parameters within their intervals: no torque was measured, "
                     f"and their scale is that of {', '.join(result.fixed)}, which was given.", tuple(facts))
    if not tested or not torque:
        return Trust("caution", f"NOT TESTED: what {result.method} leaves over is coloured by its filters and cannot "
                     "judge the parameters; mle's can.", tuple(facts))
    if min(torque.values()) < GOOD_FIT:
        return Trust("caution", "TRUST the parameters within their intervals; the model's torque is rough.",
                     tuple(facts))
    if disputes:
        return Trust("caution", "TRUST the parameters within their intervals, which are wide because runs disagree, "
                     "and the model's torque.", tuple(facts))
    return Trust("good", "TRUST the parameters within their intervals, and the model's torque.", tuple(facts))


def _impossible(result: FitResult) -> list[str]:
    """What physics forbids: an inertia matrix that is not positive definite, friction that drives."""
    found = []
    paths = [path.q[:: max(1, len(path.q) // 200)] for path in result.trajectories]
    q = np.concatenate(paths) if paths else np.zeros((1, result.mechanism.n))
    least = np.linalg.eigvalsh(result.mechanism.inertia_matrix(q, result.beta))
    if not np.isfinite(least).all() or least.min() <= 0.0:
        found.append("a mass that is not positive")
    for p, value, std in zip(result.mechanism.parameters, result.beta, result.std):
        if "friction" in p.meaning and p.name not in result.open_parameters and value + 3.0 * std < 0.0:
            found.append(f"{p.name}, {p.meaning}, is negative")
    return found


def _structure(result: FitResult) -> dict[int, float]:
    """Driven joint, from 1 -> largest correlation of its torque's residual at 25 lags, apart as a right model leaves
    them independent."""
    found = residuals_of(result)
    return {j + 1: autocorrelation(name, found[name], torque_step(result, j, found[name])).largest
            for j in result.mechanism.actuated if (name := f"torque {j + 1}") in found}


def _sensor_doubts(result: FitResult) -> list[str]:
    """What passive joints and the sensors' own residuals say against a fit.

    Nothing drives a passive joint, and no torque sensor's noise is in its equation: an error beyond that noise is the
    model's, or that of the sensors of motion.
    """
    found = []
    passive, driven = result.noise.get("passive_joint_nm", 0.0), result.noise.get("torque_nm", 0.0)
    if passive > driven > 0.0:
        found.append(f"the equation of a joint that nothing drives is off by {passive:.2g} N m, more than the driven "
                     f"one's torque by noise ({driven:.2g}), so the model or a sensor is wrong: see legid diagnose")
    for name, residuals in residuals_of(result).items():
        if not name.startswith("torque"):
            far = float(np.max(np.abs(autocorrelation(name, residuals).values[NEIGHBOURS:])))
            if far > STRONG:
                found.append(f"what is left over of {name} has structure (correlation {far:.2f}, {STRONG:g} allowed): "
                             "see legid diagnose")
    return found


def _torque_fit(result: FitResult) -> dict[int, float]:
    """Driven joint, from 1 -> fit of the model's torque to the measured one [%]; without those that hardly move."""
    found = {j + 1: torque_fit(result, j) for j in result.mechanism.actuated} if result.trajectories else {}
    return {j: share for j, share in found.items() if np.isfinite(share)}


def _disputes(result: FitResult) -> str:
    """What runs disagree about, in words; empty where they agree."""
    if result.agreement is None or not result.agreement.disagree:
        return ""
    return ", ".join(result.mechanism.names[k] for k in disputed(result)) or "the parameters"


def _loose(result: FitResult) -> list[str]:
    found = []
    for p, value, half in zip(result.mechanism.parameters, result.beta, result.half_width):
        share = half / abs(value) if value else np.inf
        if p.name not in result.open_parameters and p.name not in result.fixed and share > PRECISE:
            found.append(f"{p.name} ({p.meaning}) to {100 * share:.0f} %" if np.isfinite(share) else p.name)
    return found


def judged(prediction: Prediction) -> list[str]:
    """Columns that decide: every encoder, and the gyros where the pivot has none."""
    angles = [name for name in prediction.measured if not name.startswith(GYRO)]
    return angles if any(name.startswith("q1") for name in angles) else list(prediction.measured)


def fits_of(prediction: Prediction, simulated: Mapping[str, FloatArray] | None) -> dict[str, float]:
    """Column -> fit [%]; minus infinity where the simulation ran away."""
    return {name: -np.inf if simulated is None else fit_percent(values, simulated[name])
            for name, values in prediction.measured.items()}


def validation_trust(predictions: Sequence[Prediction], seen: Sequence[str] = (),
                     contradictions: Sequence[str] = ()) -> Trust:
    """Of free runs: over whole runs, or over pieces of a second at least. `seen` are runs that the model was fitted
    to."""
    def worst(simulated: str) -> tuple[float, str]:
        return min((share, f"{name} in {p.run}") for p in predictions
                   for name, share in fits_of(p, getattr(p, simulated)).items() if name in judged(p))

    (whole, where), (short, where_short) = worst("whole"), worst("short")
    seconds = min(p.longest_s for p in predictions)
    level, sentence = _for_what(whole, where, short, where_short, seconds)
    doubts = [f"run {run} was fitted, so it shows nothing of other motion" for run in seen]
    doubts += list(contradictions)
    if doubts and level == "good":
        return Trust("caution", f"TRUST WITH CARE: {'; '.join(doubts)}. {sentence}")
    return Trust(level, sentence, tuple(f"{text[:1].upper()}{text[1:]}." for text in doubts))


def _for_what(whole: float, where: str, short: float, where_short: str, seconds: float) -> tuple[Level, str]:
    told = f"fit {_percent(whole)} at worst, {where}"
    told_short = f"fit {_percent(short)} at worst, {where_short}"
    if whole >= GOOD_FIT:
        return "good", f"TRUST for simulation over {seconds:.0f} s: {told}."
    if short >= GOOD_FIT:
        return "caution", (f"TRUST for predictions of {SHORT_S:g} s ({told_short}), NOT for simulation over "
                           f"{seconds:.0f} s ({told}).")
    if max(whole, short) >= ROUGH_FIT:
        return "caution", (f"ROUGH: over {SHORT_S:g} s {told_short}; over {seconds:.0f} s {told}. "
                           "See legid diagnose for what is missing.")
    return "bad", f"DO NOT TRUST: {told} over {seconds:.0f} s, {told_short} over {SHORT_S:g} s. See legid diagnose."


def _percent(share: float) -> str:
    return f"{share:.1f} %" if np.isfinite(share) else "none, it ran away"


def model_contradictions(model: MechanismSettings, rig: MechanismSettings) -> list[str]:
    """Facts in which the rig given differs from the one that a model was fitted with."""
    pairs = ((name, getattr(model, name), getattr(rig, name)) for name in
             ("actuated", "gravity_mps2", "lever_arm_m", "rotor_inertia", "torque_offset", "friction_velocity_radps",
              "input"))
    silent = {"friction_velocity_radps": VELOCITY_SCALE}  # a fit may have chosen another
    return [f"the model was fitted with {name} = {_plain(then)}, the rig says {_plain(now)}"
            for name, then, now in pairs if then != now and now != silent.get(name)]


def _plain(value: object) -> str:
    return str(list(value)) if isinstance(value, tuple) else str(value)
