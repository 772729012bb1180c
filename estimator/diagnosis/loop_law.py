"""`with_law`: a diagnosis of the leg joined with what the laws of its position loops say of the readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from daq import FloatArray
from estimator.diagnosis.account import label, sizes_text
from estimator.diagnosis.result import Cause, Diagnosis
from estimator.effects import Effect, named
from estimator.loops import LawCause, LawCheck
from estimator.model import Mechanism
from estimator.verdicts import Verdict


def with_law(diagnosis: Diagnosis, checks: Sequence[LawCheck], mechanism: Mechanism, volts: float) -> Diagnosis:
    """`diagnosis`, which is of runs corrected for the faults in `checks`, with these faults as causes.

    `volts` is what a duty of 1 is, of a mechanism on voltage.
    """
    diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, *map(_broken, [c for c in checks if c.broken])))
    shown = [(check, cause) for check in checks for cause in check.causes]
    causes = [_cause(check, cause, mechanism, volts) for check, cause in shown]
    said = [_told(one, cause) for one, (_, cause) in zip(causes, shown)]
    if not shown or diagnosis.verdict == "fit_failed":
        return replace(diagnosis, warnings=(*diagnosis.warnings, *said))
    words = "; ".join(said)
    unsure = [name for _, cause in shown for name in cause.rivals]
    own = tuple(cause for cause in diagnosis.causes if cause.effect not in {one.effect for one in causes})
    alone = diagnosis.verdict == "none"
    sentence = f"{words[0].upper()}{words[1:]}." + ("" if alone else f" Of the leg: {diagnosis.sentence}")
    if alone and unsure:
        also = tuple(replace(causes[0], effect=name, size=(), sentence=named(name).sentence) for name in unsure)
        return replace(diagnosis, verdict="one_of", sentence=sentence, causes=(*causes, *also))
    verdict: Verdict = "named" if diagnosis.verdict in ("none", "named") else "partial"
    return _extended(replace(diagnosis, verdict=verdict, sentence=sentence, causes=(*causes, *own)),
                     [cause for _, cause in shown], mechanism, volts)


def _cause(check: LawCheck, cause: LawCause, mechanism: Mechanism, volts: float) -> Cause:
    effect, size, _, sizes = cause.told(mechanism, volts)
    return Cause(effect.name, effect.joint_number, effect.told(size), sizes, cause.p_value,
                 check.before.deviance - check.after.deviance, cause.rivals)


def _told(cause: Cause, shown: LawCause) -> str:
    before, after = (f"{100.0 * share:.2g} %" for share in shown.share)
    return (f"{cause.sentence}: {label(cause.effect, cause.joint)}, {sizes_text(cause)}; the law of the loop errs by "
            f"{before} of its input without this, by {after} with it")


def _broken(check: LawCheck) -> str:
    return (f"the input of joint {check.joint + 1} is not gain x (command - angle): that errs by "
            f"{100.0 * check.after.share:.2g} % of the input, and no listed fault explains it")


def _extended(diagnosis: Diagnosis, shown: Sequence[LawCause], mechanism: Mechanism, volts: float) -> Diagnosis:
    """With the faults in its extension, which simulates the readings as they are."""
    effects: list[tuple[Effect, FloatArray]] = list(diagnosis.effects)
    beta, covariance = diagnosis.extended_beta, diagnosis.extended_covariance
    if not effects:
        beta = np.array([diagnosis.nominal[name] for name in mechanism.names])
        covariance = np.diag([diagnosis.nominal_std[name] ** 2 for name in mechanism.names])
    for cause in shown:
        effect, size, std, _ = cause.told(mechanism, volts)
        effects.append((effect, size))
        beta, covariance = np.append(beta, size), block_diag(covariance[: len(beta), : len(beta)], np.diag(std**2))
    return replace(diagnosis, effects=tuple(effects), extended_beta=beta, extended_covariance=covariance,
                   extended=diagnosis.extended or dict(diagnosis.nominal),
                   extended_std=diagnosis.extended_std or dict(diagnosis.nominal_std))
