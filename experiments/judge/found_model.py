"""The model that a fit or a diagnosis found, and whether a fit is sound enough to be one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

import numpy as np

from daq import FloatArray, WorkError
from estimator import FitResult
from estimator.diagnosis import Diagnosis
from experiments.judge.fit_checks import check_fit
from experiments.judge.trust import fit_trust
from experiments.models import (
    MechanismSettings,
    Model,
    ParameterValue,
    PartValues,
    Provenance,
    TrustValues,
    build_mechanism,
    effect_value,
    fitted_settings,
    structure_values,
)
from experiments.provenance import program_version
from experiments.session import Setup


def check_sound(result: FitResult, for_model: bool) -> None:
    """Raises `WorkError` for a fit that did not converge or that knows nothing; `for_model`, for one that is not sure
    of every parameter too."""
    missing = f"this data does not determine {', '.join(map(str, result.undetermined))}" if result.undetermined else ""
    several = result.agreement is not None and result.agreement.unit == "run" and len(result.agreement.runs) > 1
    if not result.converged:
        raise WorkError(f"did not converge after {result.iterations} iterations; the values above are not to be used, "
                        + ("; or ".join(result.remedies) or _remedy(result, several))
                        + (f"; {missing}" if missing else ""))
    if missing and result.open_parameters >= {p.name for p in result.mechanism.parameters} - set(result.fixed):
        raise WorkError(f"{missing}; move every joint")
    if faults := faults_of(result):
        why = "; ".join(faults)
        raise WorkError(f"these parameters are no mechanism's: {why}; "
                        + ("; or ".join(result.remedies) or "no other sign, unit, order or gear of a column that was "
                           "tried makes a mechanism of them: check gravity and the joints under [mechanism], or give a "
                           "value that you know with --fix NAME=VALUE"
                           + ", and fit each run individually with --each" * several))
    if missing and for_model:
        raise WorkError(f"no model was written: {missing}; record richer motion, or give parameters with "
                        "--fix NAME=VALUE")


def faults_of(result: FitResult) -> tuple[str, ...]:
    """Reasons why these parameters are not to be used, as the first line of the text says."""
    return tuple(one.text for one in (*result.findings, *check_fit(result)) if one.role == "fault")


def _remedy(result: FitResult, several: bool) -> str:
    """What to do about a fit that did not converge, by what is known of it. More motion helps open parameters alone."""
    if result.undetermined:
        return "record motion of every joint, fast and slow"
    if several:
        return "fit each run individually with --each: one of them may differ from the others"
    return "run legid diagnose on several runs of this leg: the model may lack something"


def model_of(result: FitResult, settings: MechanismSettings, hold: str, runs: Sequence[str],
             date: datetime | None = None) -> Model:
    """The identified model, ready to be saved."""
    covariance = tuple(tuple(float(c) if np.isfinite(c) else None for c in row) for row in result.covariance)
    return Model(
        schema="legid.model/1", mechanism=fitted_settings(settings, result.mechanism),
        parameters=tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(value))
                         for p, value in zip(result.mechanism.parameters, result.beta)),
        covariance=covariance, ci95=_intervals(result),
        trust=TrustValues(level=(trust := fit_trust(result)).level, sentence=trust.sentence, reasons=trust.reasons),
        budget=() if result.budget is None else tuple(
            PartValues(source=part.source, tolerance=part.tolerance,
                       directions=tuple(tuple(map(float, row)) for row in part.directions))
            for part in result.budget.parts),
        noise={name: float(level) for name, level in result.noise.items()},
        hold=result.hold if hold == "auto" else hold,
        provenance=Provenance(runs=tuple(runs), method=result.method,
                              prior={one.name: (one.value, one.std) for one in result.prior},
                              sensors=result.sensors,  # type: ignore[arg-type]
                              date=(date or datetime.now(UTC)).isoformat(timespec="seconds"),
                              version=program_version()))


def _intervals(result: FitResult) -> tuple[tuple[float, float] | None, ...]:
    """Empty where they are by the standard deviations alone."""
    if not result.at_bound and (result.agreement is None or not result.agreement.disagree):
        return ()
    return tuple((float(low), float(high)) if np.isfinite([low, high]).all() else None for low, high in result.ci95())


def diagnosed_model(diagnosis: Diagnosis, setup: Setup, gear_ratio: float) -> Model:
    """The extended model, or the nominal one where the verdict extends nothing."""
    settings = setup.settings if diagnosis.mechanism is None else fitted_settings(setup.settings, diagnosis.mechanism)
    mechanism = build_mechanism(settings)
    p = mechanism.p
    if diagnosis.effects:
        beta, covariance = diagnosis.extended_beta[:p], diagnosis.extended_covariance
    else:
        beta = np.array([diagnosis.nominal[name] for name in mechanism.names])
        covariance = np.diag([diagnosis.nominal_std[name] ** 2 for name in mechanism.names])
    return Model(
        schema="legid.model/1", mechanism=settings, parameters=_parameters(settings, beta),
        covariance=tuple(tuple(float(c) if np.isfinite(c) else None for c in row) for row in covariance),
        noise={name: float(level) for name, level in diagnosis.noise.items()},
        hold=diagnosis.hold or setup.options.hold,
        effects=tuple(effect_value(effect, size) for effect, size in diagnosis.effects),
        structure=None if diagnosis.structure is None else structure_values(diagnosis.structure), gear_ratio=gear_ratio,
        reach=tuple((float(low), float(high)) for low, high in (diagnosis.angle_range if diagnosis.effects else ())),
        provenance=Provenance(runs=_whole_runs(_fitted(diagnosis), setup),
                              method="mle",
                              sensors=setup.options.sensors,  # type: ignore[arg-type]
                              date=datetime.now(UTC).isoformat(timespec="seconds"),
                              version=program_version()))


def _fitted(diagnosis: Diagnosis) -> Iterable[str]:
    """Runs that the model was fitted to: a structure is learnt from the held-out ones, too."""
    groups = ("fit", "screen", *(("confirm",) if diagnosis.structure is not None else ()))
    return [name for group in groups for name in diagnosis.runs.get(group, ())]


def _whole_runs(names: Iterable[str], setup: Setup) -> tuple[str, ...]:
    """The runs that `names` are of: a diagnosis of few runs cuts them into pieces, `ONE.csv[0.0-4.2 s]`."""
    runs = [data.name for data in setup.datasets]
    return tuple(dict.fromkeys(next((run for run in runs if name.startswith(f"{run}[")), name) for name in names))


def _parameters(settings: MechanismSettings, beta: FloatArray) -> tuple[ParameterValue, ...]:
    return tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(value))
                 for p, value in zip(build_mechanism(settings).parameters, beta))
