"""`changed_law`: what the law of a joint's loop says has changed between reference and test runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray
from estimator.loops.corrected_readings import corrected_readings
from estimator.loops.law_check import LawCause, LawCheck, check_law
from estimator.loops.law_faults import LAW_FAULTS, LawFault
from estimator.loops.law_fit import ALPHA, LEAST_SHARE, SUFFICES, Found, LawFit, error_of, fitted, p_value
from estimator.loops.law_run import LawRun, law_runs
from estimator.model import Mechanism


class LawSize(NamedTuple):
    """Sizes (k,) of one fault as the law shows them, their standard deviations, and the number of blocks."""

    size: FloatArray
    std: FloatArray
    blocks: int


@dataclass
class LawSizes:
    """Sizes of faults in the laws of reference runs, each fitted alone when it is asked for, with the terms that nobody
    states."""

    runs: Mapping[int, Sequence[LawRun]] = field(default_factory=dict)
    """Of each joint (0-based); empty for sizes that were read from a file"""
    known: dict[tuple[int, str], LawSize] = field(default_factory=dict)
    """By joint and effect"""
    terms: dict[int, Found] = field(default_factory=dict)

    @classmethod
    def of(cls, datasets: Sequence[Dataset], mechanism: Mechanism) -> LawSizes:
        """Those of runs."""
        found = {j: law_runs(datasets, mechanism, j) for j in mechanism.actuated}
        return cls({j: runs for j, runs in found.items() if runs})

    @property
    def empty(self) -> bool:
        """Whether no loop shows its law."""
        return not (self.runs or self.known)

    def size(self, joint: int, fault: LawFault) -> LawSize | None:
        """Sizes of one fault; None where no reference run shows the law of the joint."""
        key = joint, fault.effect
        if key not in self.known and joint in self.runs:
            fit = fitted(self.runs[joint], self._terms(joint), fault)
            self.known[key] = LawSize(fit.faults[-1][1], *error_of(fit))
        return self.known.get(key)

    def _terms(self, joint: int) -> Found:
        """Terms of the law that nobody states, as the reference runs have them."""
        if joint not in self.terms:
            self.terms[joint] = terms_of(check_law(self.runs[joint], joint))
        return self.terms[joint]

    def every(self) -> dict[tuple[int, str], LawSize]:
        """Sizes of all faults at all joints."""
        for joint in self.runs:
            for fault in LAW_FAULTS:
                if not fault.of_law:
                    self.size(joint, fault)
        return self.known


@dataclass(frozen=True)
class LawChange:
    """One size of the law that changed, the joint 0-based."""

    cause: LawCause
    """As the test runs have it; its size is the change"""
    faults: Found
    """What the test runs are corrected by"""


def changed_law(reference: LawSizes, test: Sequence[Dataset], mechanism: Mechanism) -> list[LawChange]:
    """Faults that the law shows in the test runs, with sizes that differ from those in the reference runs."""
    changes: list[LawChange] = []
    for joint in () if reference.empty else mechanism.actuated:
        runs = law_runs(test, mechanism, joint)
        if runs:
            changes += _changed(reference, runs, joint)
    return changes


def without_changes(test: Sequence[Dataset], mechanism: Mechanism, changes: Sequence[LawChange]) -> tuple[Dataset, ...]:
    """The test runs without the faults that the law shows in their readings."""
    left = tuple(test)
    for one in changes:
        left = corrected_readings(left, mechanism, one.cause.joint, one.faults)
    return left


def terms_of(check: LawCheck) -> Found:
    """Faults of a check that are terms of the law."""
    return tuple((fault, size) for fault, size in check.after.faults if fault.of_law)


def _changed(before: LawSizes, after: Sequence[LawRun], joint: int) -> list[LawChange]:
    changes = []
    check = check_law(after, joint)
    known = terms_of(check)
    by_name = {fault.effect: fault for fault, _ in check.after.faults}
    for cause in check.causes:
        fault = by_name[cause.effect]
        own, then = fitted(after, known, fault), before.size(joint, fault)
        if then is None:
            continue
        std, count = error_of(own)
        change, std = own.faults[-1][1] - then.size, np.hypot(std, then.std)
        p = p_value(change, std, count + then.blocks - 2, 1)
        as_before = LawFit(tuple(after), (*known, (fault, then.size)))
        gained = as_before.share**2 - own.share**2
        if p < ALPHA and gained > max(SUFFICES * as_before.share**2, LEAST_SHARE**2):
            share = as_before.share, own.share
            told = replace(cause, size=change, std=std, p_value=p, share=share, freedom=count + then.blocks - 2)
            changes.append(LawChange(told, own.faults[-1:]))
        known = own.faults
    return changes
