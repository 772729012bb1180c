"""The kind of motion that tells most about the parameters and that no earlier run has had."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from daq.recording import Plan
from estimator.effects import PlanKind
from experiments.excite.optimal_design import RATE_HZ, Bench, Candidate, Search
from experiments.excite.session import shaped
from experiments.excite.waveforms import KINDS


class Motion(NamedTuple):
    """A plan of a kind."""

    kind: PlanKind
    what: str
    candidate: Candidate
    gain: float
    """Half the log determinant of the parameters' information that it adds to that of the earlier plans."""


def next_motion(bench: Bench, seconds: float, search: Search, recorded: Sequence[Plan], kinds: Collection[str]
                ) -> Motion | None:
    """The plan of `seconds` [s] that adds most information to the plans `recorded`, of no kind in `kinds`.

    None where no kind is left, or no plan keeps the limits.
    """
    known = np.sum([_information(bench, plan) for plan in recorded], axis=0)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    found = []
    for run, (kind, how) in enumerate(KINDS.items(), len(recorded)):
        candidate = shaped(bench, kind, time_s, search, run) if how.shape is not None and kind not in kinds else None
        if candidate is not None:
            found.append(Motion(kind, how.what, candidate, _added(known, candidate.information)))
    return max(found, key=lambda one: one.gain, default=None)


def _information(bench: Bench, plan: Plan) -> FloatArray:
    """(p, p) of the parameters by one run of the plan; zero where its motion diverges."""
    time_s = np.arange(round(plan.duration_s * RATE_HZ)) / RATE_HZ
    moved = bench.fine.move(np.interp(time_s, plan.time_s, plan.torque_nm))
    p = bench.mechanism.p
    return np.zeros((p, p)) if moved is None else bench.fine.eliminated(moved).information


def _added(known: FloatArray, more: FloatArray) -> float:
    """Half of log det(known + more) - log det(known), parameters scaled to their information."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(known + more), 1e-300))
    sizes = [np.linalg.slogdet(part * np.outer(scale, scale))[1] for part in (known + more, known)]
    return float(0.5 * (sizes[0] - sizes[1])) if np.isfinite(sizes).all() else float(np.inf)
