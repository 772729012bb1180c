"""Whether a model can be trusted, and for what: the first line of `legid fit` and `legid validate`.

The thresholds stand here and in docs/trust.md, which says what they were held against.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from estimator import Finding, FitResult
from estimator.model import VELOCITY_SCALE
from estimator.prediction import SHORT_S, PredictionTable
from experiments.judge.agreement import units
from experiments.judge.budget import precision
from experiments.judge.fit_checks import GOOD_FIT, ROUGH_FIT, check_fit, torque_fits
from experiments.judge.headline import Headline, Level
from experiments.models import MechanismSettings, TrustValues

HEADLINE = 130
"""Most letters of a box's title; of a longer sentence it is the part before the colon."""
NAMED = 2
"""Kinds of suspect results that the first line names."""
IN_SHORT: dict[str, str] = {
    "estimators_disagree": "two estimators disagree", "torque_residual": "the torque residual is autocorrelated",
    "passive_joint": "a passive joint has a torque residual", "sensor_residual": "a sensor residual is autocorrelated",
    "sensor_scale": "a sensor's scale is wrong", "repeating_torque": "an unmeasured torque repeats",
    "omitted_effect": "the residuals look like an effect that the model lacks", "prior": "the runs contradict [prior]",
    "budget": "the budget is wider than a value", "undetermined": "these runs do not determine all parameters",
    "rig_contradiction": "the rig file contradicts a run"}
"""Kind of a suspect result -> its words in the first line; its own line has the figures."""


class Trust(Struct, frozen=True):
    """An answer in one line, and what it rests on."""

    level: Annotated[Level, Meta(description="good, caution or bad")]
    sentence: Annotated[str, Meta(description="the answer, and for what it holds")]
    reasons: Annotated[tuple[str, ...], Meta(description="one a line")] = ()

    def __str__(self) -> str:
        return self.sentence

    @property
    def document(self) -> dict[str, Any]:
        """For the JSON documents."""
        return {"level": self.level, "sentence": self.sentence, "reasons": list(self.reasons)}

    @property
    def headline(self) -> Headline:
        """Its title is the part of a long sentence before the colon; the rest comes before the reasons."""
        title, _, rest = self.sentence.partition(": ") if len(self.sentence) > HEADLINE else (self.sentence, "", "")
        return Headline(self.level, title, [*([_line(rest).removesuffix(".")] if rest else []), *self.reasons])

    @property
    def text(self) -> str:
        """The sentence and its reasons, one a line."""
        return "\n".join([self.sentence, *self.reasons])


def fit_trust(result: FitResult) -> Trust:
    """Trust in a fit, from its findings and those of `check_fit`: one short line, then one line for each reason.

    `validation_trust` judges free runs.
    """
    findings = (*result.findings, *check_fit(result))
    faults = [one for one in findings if one.role == "fault"]
    if faults:
        return _of_faults(faults)
    suspect = [one for one in findings if one.role == "doubt" or one.kind == "rig_contradiction"]
    reasons = tuple(_line(f"the rig file contradicts a run: {one}" if one.kind == "rig_contradiction" else one.text)
                    for one in suspect)
    facts = tuple(_line(one.text) for one in findings if one.role == "fact")
    torque = list(torque_fits(result).values())
    disputes = any(one.kind == "runs_disagree" for one in findings)
    tested = result.method in ("mle", "shooting")
    if suspect:
        use = () if not torque else (
            "Good for torque feedforward within the fitted motion." if min(torque) >= GOOD_FIT else
            "Good for rough torque feedforward only." if min(torque) >= ROUGH_FIT else
            "Not good for torque feedforward either.",)
        return Trust("bad", f"DO NOT TRUST the parameters: {_in_short(suspect)}.", (*reasons, *use, *facts))
    known = f": {told}" if (told := precision(result)) else ""
    if tested and not result.mechanism.actuated:
        return Trust("good", "TRUST the ratios of the parameters within their intervals: no torque was measured.",
                     (f"Their scale is that of {', '.join(result.fixed)}, which was given.", *facts))
    if not tested or not torque:
        return Trust("caution", f"NOT TESTED: the filters of {result.method} colour its residual, which cannot test "
                     "the parameters. Use mle.", facts)
    if any(one.kind == "noise_share" for one in findings):
        return Trust("caution", "TRUST WITH CARE: much of the torque counts as noise, so the intervals may be too "
                     "narrow.", facts)
    if min(torque) < GOOD_FIT:
        return Trust("good", f"TRUST the parameters within their intervals; the model's torque is rough{known}.", facts)
    if disputes:
        return Trust("good", f"TRUST the parameters within their intervals, which are wide because {units(result)} "
                     f"disagree, and the model's torque{known}.", facts)
    return Trust("good", f"TRUST the parameters within their intervals, and the model's torque{known}.", facts)


def _of_faults(faults: Sequence[Finding]) -> Trust:
    """The first kind of fault in short, and each fault of that kind in a line."""
    kind = faults[0].kind
    texts = [one.text for one in faults if one.kind == kind]
    short = {"impossible": "no mechanism has these parameters", "columns": "the columns cannot be right"}.get(kind)
    return Trust("bad", f"NOT TO BE USED: {short or '; '.join(texts)}.", tuple(map(_line, texts)) if short else ())


def _in_short(suspect: Sequence[Finding]) -> str:
    """The first kinds of suspect results, and how many more there are."""
    kinds = list(dict.fromkeys(IN_SHORT[one.kind] for one in suspect))
    more = [f"and {len(kinds) - NAMED} more"] if len(kinds) > NAMED else []
    return ", ".join([*kinds[:NAMED], *more])


def _line(text: str) -> str:
    """`text` as a sentence; a name such as beta1 keeps its small letter."""
    named = re.match(r"\w*\d", text)
    return f"{text if named else text[:1].upper() + text[1:]}."


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
    seconds = min(one.longest_s for one in table.runs)
    level, sentence = _for_what(whole, where, short, where_short, seconds)
    suspect = [f"the model was fitted to run {run}, so that run does not test it" for run in seen]
    suspect += list(contradictions)
    if suspect and level == "good":
        return Trust("caution", f"TRUST WITH CARE: {'; '.join(suspect)}. {sentence}")
    return Trust(level, sentence, tuple(f"{text[:1].upper()}{text[1:]}." for text in suspect))


def with_fit_trust(trust: Trust, of_fit: TrustValues | None) -> Trust:
    """`trust` in a model's free runs, after what the fit said of its parameters where that was not to trust them."""
    if of_fit is None or of_fit.level != "bad":
        return trust
    return Trust("bad", f"{of_fit.sentence.partition(':')[0]}, as their fit said. Free runs: {trust.sentence}",
                 (f"The fit: {of_fit.sentence}", *trust.reasons))


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
                           "Run legid diagnose to find what is missing.")
    return "bad", f"DO NOT TRUST: {told} over {seconds:.0f} s, {told_short} over {SHORT_S:g} s. Run legid diagnose."


def _percent(share: float) -> str:
    return f"{share:.1f} %" if np.isfinite(share) else "none, it diverged"


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
