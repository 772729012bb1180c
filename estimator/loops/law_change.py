"""`changed_law`: what the law of a joint's loop says has changed between reference and test runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import Dataset
from estimator.loops.law_check import LawCause, check_law
from estimator.loops.law_fit import ALPHA, LEAST_SHARE, SUFFICES, Found, LawFit, error_of, fitted, p_value
from estimator.loops.law_run import LawRun, law_runs
from estimator.model import Mechanism


@dataclass(frozen=True)
class LawChange:
    """One size of the law that changed, the joint 0-based."""

    cause: LawCause
    """As the test runs have it; its size is the change"""
    faults: Found
    """What the test runs are corrected by"""


def changed_law(reference: Sequence[Dataset], test: Sequence[Dataset], mechanism: Mechanism) -> list[LawChange]:
    """Faults that the law shows in the test runs, with sizes that differ from those in the reference runs."""
    found = []
    for joint in mechanism.actuated:
        before, after = law_runs(reference, mechanism, joint), law_runs(test, mechanism, joint)
        if before and after:
            found += _changed(before, after, joint)
    return found


def _changed(before: Sequence[LawRun], after: Sequence[LawRun], joint: int) -> list[LawChange]:
    known: Found = ()
    found = []
    check = check_law(after, joint)
    by_name = {fault.effect: fault for fault, _ in check.after.faults}
    for cause in check.causes:
        fault = by_name[cause.effect]
        own, then = fitted(after, known, fault), fitted(before, known, fault)
        (std, count), (std_then, count_then) = error_of(own), error_of(then)
        change, std = own.faults[-1][1] - then.faults[-1][1], np.hypot(std, std_then)
        p = p_value(change, std, count + count_then - 2, 1)
        as_before = LawFit(tuple(after), (*known, then.faults[-1]))
        gained = as_before.share**2 - own.share**2
        if p < ALPHA and gained > max(SUFFICES * as_before.share**2, LEAST_SHARE**2):
            share = as_before.share, own.share
            told = LawCause(cause.effect, joint, change, std, p, share, cause.rivals, count + count_then - 2)
            found.append(LawChange(told, own.faults[-1:]))
        known = own.faults
    return found
