"""Whether a model can be trusted, and for what: the first line of `legid fit` and `legid validate`.

The thresholds stand here and in docs/trust.md, which says what they were held against.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, structs

from estimator import Finding, FitResult, Use
from estimator.model import VELOCITY_SCALE
from estimator.prediction import SHORT_S, PredictionTable
from experiments.judge.budget import precision
from experiments.judge.fit_checks import GOOD_FIT, ROUGH_FIT, check_fit
from experiments.judge.headline import Headline, Level, sentence_of
from experiments.judge.next_steps import DIAGNOSE, EACH, SIMULATE, VALIDATE
from experiments.judge.residuals import torque_fit
from experiments.judge.uses import all_uses, best_words, uses_line
from experiments.models import MechanismSettings, TrustValues

SUSPECT = "DO NOT TRUST the parameters"
NAMED = 2
"""Kinds of suspect results that the first line names."""
IN_SHORT: dict[str, str] = {
    "estimators_disagree": "two estimators disagree", "torque_residual": "the torque residual is autocorrelated",
    "passive_joint": "a passive joint has a torque residual", "sensor_residual": "a sensor residual is autocorrelated",
    "sensor_scale": "a sensor's scale is wrong", "repeating_torque": "an unmeasured torque repeats",
    "omitted_effect": "the model seems to lack an effect", "prior": "the runs contradict [prior]",
    "budget": "the budget is wider than a value", "undetermined": "not all are determined",
    "rig_contradiction": "the rig file contradicts a run"}
"""Kind of a suspect result -> its words in the first line; its own line has the figures."""
FAULTS: dict[str, str] = {"impossible": "no mechanism has these parameters", "columns": "the columns cannot be right"}
"""The same of faults; the first line has all of the others."""
STEPS: dict[str, str] = {
    "columns": "Check units, signs and order of the columns",
    "impossible": "Check gravity and joints under [mechanism]",
    "not_converged": EACH, "rig_contradiction": "Correct the rig file", "prior": "Check the values under [prior]",
    "sensor_scale": "Calibrate that sensor: legid calibrate imu --rig RIG",
    "undetermined": "Record fast and slow motion of every joint, or give a value that you know: legid fit RUN... "
    "--rig RIG --fix NAME=VALUE",
    "budget": "Calibrate what these intervals consist of, and write it under [tolerance]"}
"""Kind of a fault or a suspect result -> next step, the first that is needed first; after others `DIAGNOSE`."""


class Trust(Struct, frozen=True):
    """An answer in one line, and what it rests on."""

    level: Annotated[Level, Meta(description="good, caution or bad")]
    sentence: Annotated[str, Meta(description="the answer, and for what it holds")]
    reasons: Annotated[tuple[str, ...], Meta(description="one a line")] = ()
    next_step: Annotated[str | UnsetType, Meta(description="what to do, and the command")] = UNSET

    def __str__(self) -> str:
        return self.sentence

    @property
    def headline(self) -> Headline:
        """The same as the first lines of a result."""
        return Headline(self.level, self.sentence, self.reasons, action=self.next_step or "")


def fit_trust(result: FitResult) -> Trust:
    """Trust in a fit, by its findings and those of `check_fit`. `validation_trust` judges free runs."""
    paths, driven = result.trajectories, result.mechanism.actuated
    torque = paths and any(np.isfinite(torque_fit(result, j, paths)) for j in driven)
    untested = f"the filters of {result.method} colour the residual" if result.method not in ("mle", "shooting") else \
        "" if torque or not driven else "the torque hardly changes"
    return trust_by((*result.findings, *check_fit(result)), precision(result), untested,
                    "" if driven else ", ".join(result.fixed), all_uses(result))


def trust_by(findings: Sequence[Finding], known: str = "", untested: str = "", scale: str = "",
             uses: Sequence[Use] = ()) -> Trust:
    """Trust in a fit by all that was found about it: one short line, a line for each reason, the next step.

    - `known`: how well its leading parameter is known. `untested`: why no residual tests it; empty if some do.
    - `scale`: parameters that were given where no torque was measured. `uses`: what the model is good for.
    """
    told = {role: tuple(sentence_of(one.text) for one in findings if one.role == role)
            for role in ("fault", "doubt", "fact", "remedy")}
    kinds = [one.kind for one in findings if one.role == ("fault" if told["fault"] else "doubt")]
    step = next((step for kind, step in STEPS.items() if kind in kinds), DIAGNOSE)
    if told["fault"]:
        texts = [one.text for one in findings if one.role == "fault" and one.kind == kinds[0]]
        short = FAULTS.get(kinds[0])
        return Trust("bad", f"NOT TO BE USED: {short or '; '.join(texts)}.", tuple(
            line for line in told["fault"] if short or line not in map(sentence_of, texts)), (*told["remedy"], step)[0])
    good_for, measured = best_words(uses), uses_line(uses)
    used = (sentence_of(measured),) if measured else ()
    if told["doubt"]:
        first = f"{good_for}; {SUSPECT}" if good_for else SUSPECT
        return Trust("caution" if good_for else "bad", sentence_of(f"{first}: {_in_short(kinds, bool(good_for))}"),
                     (*used, *told["doubt"], *told["fact"]), step)
    facts = (*used, *([sentence_of(known)] if known else []), *told["fact"])
    if untested:
        return Trust("caution", f"NOT TESTED: {untested}, which cannot test the parameters.", told["fact"],
                     "Fit by maximum likelihood: legid fit RUN... --rig RIG")
    if scale:
        return Trust("good", "TRUST the ratios of the parameters within their intervals: no torque was measured.",
                     (f"Their scale is that of {scale}, which was given.", *facts), VALIDATE)
    if any(one.kind == "noise_share" for one in findings):
        return Trust("caution", "TRUST WITH CARE: much of the torque counts as noise, so the intervals may be too "
                     "narrow.", facts, "Choose rate, hold and terms by the records: legid tune RUN... --rig RIG")
    first = "TRUST the parameters within their intervals."
    return Trust("good", f"{first} {sentence_of(good_for)}" if good_for else first, facts, VALIDATE)


def _in_short(suspect: Sequence[str], alone: bool) -> str:
    """The first kinds of suspect results, in the order of their steps, and how many more there are; or the first
    `alone`."""
    order = {kind: k for k, kind in enumerate(STEPS)}
    first = sorted(suspect, key=lambda kind: order.get(kind, len(order)))
    kinds = list(dict.fromkeys(IN_SHORT[kind] for kind in first))[: 1 if alone else None]
    return ", ".join(kinds[:NAMED]) + f", and {len(kinds) - NAMED} more" * (len(kinds) > NAMED)


def deciding(table: PredictionTable) -> list[str]:
    """Channels that decide: every encoder, and the gyros where the pivot has none."""
    angles = [name for name in table.judged if not name.startswith("gyro")]
    return angles if any(name.startswith("q1") for name in angles) else list(table.judged)


def fits_of(table: PredictionTable, run: int, horizon_s: float) -> dict[str, float]:
    """Measured channel -> fit [%] of one run by the first model; minus infinity where a whole segment diverges.

    A horizon longer than every segment means whole segments.
    """
    horizon_s = horizon_s if horizon_s in table.horizons_s else np.inf
    found = {name: table.fit_percent(0, name, horizon_s, run) for name in table.judged}
    return {name: share for name, share in found.items() if not np.isnan(share)}


def validation_trust(table: PredictionTable, seen: Sequence[str] = (), contradictions: Sequence[str] = ()) -> Trust:
    """Trust in free runs: over whole runs, or over pieces of a second at least.

    `seen` are runs that the model was fitted to.
    """
    def worst(horizon_s: float) -> tuple[float, str]:
        return min((share, f"{name} in {one.run}") for k, one in enumerate(table.runs)
                   for name, share in fits_of(table, k, horizon_s).items() if name in deciding(table))

    (whole, where), (short, where_short) = worst(np.inf), worst(SHORT_S)
    seconds = f"{min(one.longest_s for one in table.runs):.0f} s"
    suspect = [*(f"the model was fitted to run {run}, so that run does not test it" for run in seen), *contradictions]
    told = f"fit {_percent(whole)} at worst, {where}"
    if whole >= GOOD_FIT:
        if not suspect:
            return Trust("good", f"TRUST for simulation over {seconds}: {told}.", next_step=SIMULATE)
        more = f", and {len(suspect) - 1} more" if suspect[1:] else ""
        return Trust("caution", f"TRUST WITH CARE for simulation over {seconds}: {suspect[0]}{more}.",
                     tuple(map(sentence_of, [told, *suspect[1:]])), VALIDATE if seen else STEPS["rig_contradiction"])
    reasons = tuple(map(sentence_of, [f"over {seconds}: {told}", f"over {SHORT_S:g} s: fit {_percent(short)} at worst, "
                                f"{where_short}", *suspect]))
    if short >= GOOD_FIT:
        return Trust("caution", f"TRUST for predictions of {SHORT_S:g} s, not for simulation over {seconds}.", reasons,
                     DIAGNOSE)
    if max(whole, short) >= ROUGH_FIT:
        return Trust("caution", f"ROUGH: the free runs fit to less than {GOOD_FIT:g} %.", reasons, DIAGNOSE)
    return Trust("bad", f"DO NOT TRUST: the free runs fit to less than {ROUGH_FIT:g} %.", reasons, DIAGNOSE)


def with_fit_trust(trust: Trust, of_fit: TrustValues | None) -> Trust:
    """`trust` in a model's free runs, and not in its parameters where their fit said so."""
    why_not = "" if of_fit is None else of_fit.sentence.partition(f"{SUSPECT}: ")[2]
    if not why_not:
        return trust
    use, _, why = trust.sentence.partition(":")
    if trust.level == "good":
        trust = structs.replace(trust, level="caution", sentence=f"{use}, not the parameters:{why}")
    return structs.replace(trust, reasons=(*trust.reasons, f"The fit did not trust the parameters: {why_not}"))


def _percent(share: float) -> str:
    return f"{share:.1f} %" if np.isfinite(share) else "none, it diverged"


STATED = "actuated", "gravity_mps2", "lever_arm_m", "input"
"""Facts of a rig."""
CHOSEN = "rotor_inertia", "torque_offset", "friction_velocity_radps"
"""Facts that a fit may have chosen, which two models may therefore have otherwise."""


def model_contradictions(model: MechanismSettings, rig: MechanismSettings, facts: Sequence[str] = STATED + CHOSEN
                         ) -> list[str]:
    """Facts in which the rig given differs from the one that a model was fitted with."""
    silent = {"friction_velocity_radps": VELOCITY_SCALE}  # a fit may have chosen another
    return [f"the model was fitted with {name} = {_plain(then)}, the rig says {_plain(now)}" for name in facts
            if (then := getattr(model, name)) != (now := getattr(rig, name)) and now != silent.get(name)]


def _plain(value: object) -> str:
    return str(list(value) or "none") if isinstance(value, tuple) else str(value)
