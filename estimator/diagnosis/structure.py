"""`with_structure`: the structure of what a diagnosis leaves unexplained, offered where it holds."""

from __future__ import annotations

from dataclasses import replace

from estimator.diagnosis.account import counted_as_noise
from estimator.diagnosis.model import Model
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.uses import model_told
from estimator.fit_errors import FIT_ERRORS
from estimator.prediction import RunSignals, find_structure


def with_structure(diagnosis: Diagnosis, nominal: Model) -> Diagnosis:
    """`diagnosis` with the structure of the residual of its model, if its verdict leaves a material residual.

    The structure is offered only if it removes a material share of the free-run error on left-out runs, surely some,
    and at no horizon surely adds to it. Else a warning gives that share.
    """
    if diagnosis.verdict not in ("unexplained", "partial"):
        return diagnosis
    split = nominal.split
    runs = [RunSignals(name, tuple(signals), start)
            for name, signals, start in zip(split.names, split.runs, split.starts_s)]
    try:
        structure = find_structure(model_told(diagnosis, nominal), runs, replace(
            split.options, noise=dict(split.known)), split.workers)
    except FIT_ERRORS:
        return diagnosis
    if structure is None:
        return diagnosis
    if structure.holds(diagnosis.material):
        refuted = [counted_as_noise((law.joint or 0) + 1) for law in structure.laws]
        return replace(diagnosis, structure=structure,
                       warnings=tuple(w for w in diagnosis.warnings if not w.endswith(tuple(refuted))))
    ends = structure.removed_ci95
    interval = "" if ends is None else f" [{', '.join(f'{100.0 * end:.0f}' for end in ends)}]"
    return replace(diagnosis, warnings=(*diagnosis.warnings, (
        f"torques learnt as functions of the state remove {100.0 * structure.removed:.0f} %{interval} of the free-run "
        "error on left-out runs, or add to it at 0.1 s, 1 s or over whole runs: they are not offered")))
