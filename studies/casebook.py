"""Case studies on public records: what is published against what the program finds, on one page.

What is known of a data set is in `experiments/rigs/`, never here: `cases.toml` says which runs of which folder to put
through which rig file, and what is published of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct

from daq import InputError, WorkError, load_rig
from estimator import CAUSED, FitError, FitResult, Method
from estimator.calibration import SIGNALS, EncoderFit
from estimator.diagnosis import Diagnosis
from estimator.prediction import Validation, validations_of
from estimator.signals import torque_column
from experiments.calibrate import compare, read_moving
from experiments.documents import errors_of
from experiments.judge import model_of
from experiments.models import mechanism_settings
from experiments.session import Setup, load_runs, prepare
from experiments.workflows import diagnose_prepared, fit_runs, model_of_fit, predict_setup

T = TypeVar("T")
RIGS = Path(__file__).parent / "rigs"
SCHEMA = "legid.casebook/1"


class FitTask(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One fit, and what is published for it, in the units of the mechanism's parameters."""

    title: str
    rig: str
    runs: tuple[str, ...]
    method: Method = "mle"
    fix: dict[str, float] = {}
    validate: tuple[str, ...] = ()
    """Runs to simulate that the fit does not see."""
    published: dict[str, float] = {}
    relative_error_percent: tuple[float, ...] = ()
    """By joint: rms of the model's torque residual, as a share of the measured torque's rms."""


class SweepTask(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The same fit at several bandwidths of `[filter] cutoff_hz`, by several methods."""

    rig: str
    runs: tuple[str, ...]
    cutoffs_hz: tuple[float, ...]
    published: dict[str, float]
    methods: tuple[Literal["mle", "wls"], ...] = ("mle", "wls")


class DiagnoseTask(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One diagnosis, and the effects that the publication knows of."""

    rig: str
    runs: tuple[str, ...]
    expected: tuple[str, ...] = ()
    published: dict[str, float] = {}
    """Sizes of those effects, by the size's name."""
    again: Annotated[int, Meta(ge=0)] = 0
    """Number of repetitions with other seeds of the bootstrap replicates: does the verdict depend on them?"""


class CalibrateTask(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The IMU against the encoder of its own link."""

    rig: str
    runs: tuple[str, ...]
    angle_below_rad: float
    """Published rms error of the link's angle by the IMU."""


class Case(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One folder of records."""

    title: str
    folder: str
    source: str
    known: str
    """What is known of it, in a sentence."""
    fit: tuple[FitTask, ...] = ()
    sweep: tuple[SweepTask, ...] = ()
    diagnose: tuple[DiagnoseTask, ...] = ()
    calibrate: tuple[CalibrateTask, ...] = ()


class _Cases(Struct, forbid_unknown_fields=True, frozen=True):
    case: tuple[Case, ...]


@dataclass(frozen=True)
class Fitted:
    """Outcome of a fit: a result, or the line in which it was refused."""

    task: FitTask
    result: FitResult | None
    refusal: str
    validations: Sequence[Validation] = ()
    validation_refusal: str = ""

    def relative_error_percent(self) -> list[float]:
        """Relative errors by joint, see `FitTask`; NaN for a joint without torque."""
        if self.result is None or not self.result.trajectories:
            return []
        tau = np.concatenate([t.tau_measured for t in self.result.trajectories])
        size = np.sqrt(np.nanmean(tau**2, axis=0))
        left = np.asarray(self.result.torque_residual_rms)
        return [float(100.0 * r / s) if s > 0 else float("nan") for r, s in zip(left, size)]


@dataclass(frozen=True)
class Swept:
    """Outcome of a sweep: (method, cutoff) to the published parameters' estimates, or to the line of a refusal."""

    task: SweepTask
    found: Mapping[tuple[str, float], Mapping[str, float] | str]

    def departure(self, method: str, cutoff_hz: float) -> dict[str, float]:
        """Share by which each published parameter is missed; empty where the fit was refused."""
        found = self.found[method, cutoff_hz]
        return {} if isinstance(found, str) else {n: found[n] / v - 1.0 for n, v in self.task.published.items()}


@dataclass(frozen=True)
class Diagnosed:
    """Outcome of a diagnosis."""

    task: DiagnoseTask
    found: Diagnosis | None
    refusal: str
    drive_rms: tuple[float, ...] = ()
    """(n,) rms of what drives each joint, over all records."""
    others: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Verdict and effects of every repetition."""

    def residual_percent(self) -> tuple[list[float], list[float]]:
        """Torque residual of the nominal and the extended model on the confirm runs [% of `drive_rms`], by joint.

        NaN for a joint that nothing drives; empty where there is no gain to tell of.
        """
        if self.found is None:
            return [], []
        before, after = ([100.0 * r / s if s > 0 else float("nan") for r, s in zip(rms, self.drive_rms)]
                         for rms in self.found.torque_rms_nm)
        return before, after

    def agrees(self) -> bool | None:
        """Whether every effect that is published is among the named causes; None where none is published."""
        if not self.task.expected:
            return None
        return set(self.task.expected) <= set(self.named)

    @property
    def ending(self) -> tuple[str, tuple[str, ...]]:
        """Verdict and effects, as in `others`."""
        return ("", ()) if self.found is None else (self.found.verdict, tuple(c.effect for c in self.found.causes))

    @property
    def steady(self) -> bool:
        """Whether every repetition ends alike."""
        return all(other == self.ending for other in self.others)

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that the diagnosis says are all present; none where it leaves a choice."""
        present = self.found is not None and self.found.verdict in CAUSED and self.found.verdict != "one_of"
        return tuple(c.effect for c in self.found.causes) if self.found and present else ()


@dataclass(frozen=True)
class Calibrated:
    """Outcome of a calibration."""

    task: CalibrateTask
    found: EncoderFit | None
    refusal: str


@dataclass(frozen=True)
class Study:
    """A case with all that was found."""

    case: Case
    fits: Sequence[Fitted]
    sweeps: Sequence[Swept]
    diagnoses: Sequence[Diagnosed]
    calibrations: Sequence[Calibrated] = ()


def load_cases(path: Path = RIGS / "cases.toml") -> tuple[Case, ...]:
    """All cases of the file. Raises `InputError`."""
    try:
        return msgspec.toml.decode(path.read_bytes(), type=_Cases).case
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "give a file of cases") from None
    except msgspec.MsgspecError as error:
        raise InputError(str(path), str(error), "correct the entry named") from None


def cases_in(folder: Path, cases: Sequence[Case]) -> list[Case]:
    """The cases whose folder is in `folder`. Raises `InputError` where there is none."""
    found = [case for case in cases if (folder / case.folder).is_dir()]
    if not found:
        raise InputError(str(folder), "holds none of the known folders " + ", ".join(case.folder for case in cases),
                         "give the directory that holds them")
    return found


def study_case(case: Case, folder: Path, seed: int = 0) -> Study:
    """Run all that `case` asks for on the records under `folder`; what is refused is kept as its line."""
    home = folder / case.folder
    return Study(case, [_fit(task, home) for task in case.fit], [_sweep(task, home) for task in case.sweep],
                 [_diagnose(task, home, seed) for task in case.diagnose],
                 [_calibrate(task, home) for task in case.calibrate])


def _fit(task: FitTask, home: Path) -> Fitted:
    rig = load_rig(RIGS / task.rig)

    def estimate() -> FitResult:
        return fit_runs([home / run for run in task.runs], rig, fixed=task.fix, method=task.method, choose=False).result

    result, refusal = _attempt(estimate)
    if result is None or not task.validate:
        return Fitted(task, result, refusal)

    def simulate() -> list[Validation]:
        model = model_of(result, mechanism_settings(rig), result.hold, task.runs)
        prepared = prepare([home / run for run in task.validate], rig, fixed=task.fix, model=model)
        return validations_of(predict_setup([model_of_fit(result)], prepared.setup))

    validations, problem = _attempt(simulate)
    return Fitted(task, result, refusal, validations or (), problem)


def _sweep(task: SweepTask, home: Path) -> Swept:
    rig = load_rig(RIGS / task.rig)
    found: dict[tuple[str, float], Mapping[str, float] | str] = {}
    for cutoff in task.cutoffs_hz:
        narrow = msgspec.structs.replace(rig, filter=msgspec.structs.replace(rig.filter, cutoff_hz=cutoff))
        runs = load_runs([home / run for run in task.runs], narrow)
        for method in task.methods:
            fitted, refusal = _attempt(partial(fit_runs, runs, narrow, method=method, choose=False))
            if fitted is None:
                found[method, cutoff] = refusal
            else:  # also what is not determined: what a method makes of noise is what a sweep shows
                names, beta = fitted.result.mechanism.names, fitted.result.beta
                found[method, cutoff] = {n: float(beta[names.index(n)]) for n in task.published}
    return Swept(task, found)


def _diagnose(task: DiagnoseTask, home: Path, seed: int) -> Diagnosed:
    rig = load_rig(RIGS / task.rig)
    prepared, refusal = _attempt(lambda: prepare([home / run for run in task.runs], rig))
    if prepared is None:
        return Diagnosed(task, None, refusal)
    found, refusal = _attempt(lambda: diagnose_prepared(prepared, seed))
    others = [] if found is None else [diagnose_prepared(prepared, seed + k) for k in range(1, task.again + 1)]
    return Diagnosed(task, found, refusal, drive_rms(prepared.setup),
                     tuple((other.verdict, tuple(c.effect for c in other.causes)) for other in others))


def drive_rms(setup: Setup) -> tuple[float, ...]:
    """(n,) rms of the measured torque of each joint over all runs, zero where nothing drives it."""
    found = [0.0] * setup.mechanism.n
    for j in setup.mechanism.actuated:
        torque = np.concatenate([data[torque_column(setup.mechanism, j)] for data in setup.datasets])
        found[j] = float(np.sqrt(np.nanmean(torque**2)))
    return tuple(found)


def _calibrate(task: CalibrateTask, home: Path) -> Calibrated:
    rig = load_rig(RIGS / task.rig)
    return Calibrated(task, *_attempt(lambda: compare([read_moving(home / run, rig) for run in task.runs], rig)))


def _attempt(work: Callable[[], T]) -> tuple[T | None, str]:
    """The result, or the line that says why there is none: a case may be there to be refused."""
    try:
        return work(), ""
    except (InputError, WorkError, FitError) as error:
        return None, str(error)


def casebook_document(studies: Sequence[Study]) -> dict[str, Any]:
    """`legid.casebook/1`: published against found, verdicts, gains."""
    return {"schema": SCHEMA, "cases": [
        {"folder": s.case.folder, "title": s.case.title, "fits": [_fit_entry(f) for f in s.fits],
         "sweeps": [_sweep_entry(w) for w in s.sweeps], "diagnoses": [_diagnosis_entry(d) for d in s.diagnoses],
         "calibrations": [_calibration_entry(c) for c in s.calibrations]}
        for s in studies]}


def _fit_entry(f: Fitted) -> dict[str, Any]:
    entry: dict[str, Any] = {"title": f.task.title, "method": f.task.method, "refused": f.refusal or None,
                             "published": f.task.published}
    if f.result is not None:
        entry |= {"converged": bool(f.result.converged), "undetermined": list(map(str, f.result.undetermined)),
                  "found": values(f.result), "std": dict(zip(f.result.mechanism.names, map(float, f.result.std))),
                  "torque_residual_rms": [float(r) for r in f.result.torque_residual_rms],
                  "relative_error_percent": f.relative_error_percent(),
                  "validation_rmse": [{"run": v.run, **{n: float(x) for n, x in v.rmse.items()}}
                                      for v in f.validations]}
    return entry


def _sweep_entry(w: Swept) -> dict[str, Any]:
    return {"published": w.task.published, "fits": [
        {"method": method, "cutoff_hz": cutoff, **({"refused": found} if isinstance(found, str) else
                                                   {"found": dict(found)})}
        for (method, cutoff), found in w.found.items()]}


def _diagnosis_entry(d: Diagnosed) -> dict[str, Any]:
    entry: dict[str, Any] = {"refused": d.refusal or None, "expected": list(d.task.expected),
                             "published": d.task.published, "agrees": d.agrees()}
    if d.found is not None:
        entry |= {"verdict": d.found.verdict, "sentence": d.found.sentence,
                  "causes": [c.effect for c in d.found.causes],
                  "free_run_rmse": errors_of(d.found.sensors),
                  "gap_closed": d.found.gap_closed, "gap_closed_ci95": d.found.gap_closed_ci95,
                  "sizes": {c.effect: {x.name: {"value": x.value, "ci95": list(x.ci95), "unit": x.unit} for x in c.size}
                            for c in d.found.causes},
                  "torque_rms": {"before": list(d.found.torque_rms_nm[0]), "after": list(d.found.torque_rms_nm[1])},
                  "other_seeds": [{"verdict": verdict, "causes": list(causes)} for verdict, causes in d.others],
                  "left_over_percent": dict(zip(("before", "after"), d.residual_percent()))}
    return entry


def _calibration_entry(c: Calibrated) -> dict[str, Any]:
    entry: dict[str, Any] = {"refused": c.refusal or None, "published_angle_rms_rad": c.task.angle_below_rad}
    if c.found is not None:
        entry |= {"found": {f.term.name: {"value": f.value, "half": f.half} for f in c.found.found
                            if f.determined and f.term.name not in c.found.held},
                  "rms": {name: {"before": before, "after": after} for name, before, after in
                          zip(SIGNALS, c.found.before[:, 0].tolist(), c.found.after[:, 0].tolist())}}
    return entry


def values(result: FitResult) -> Mapping[str, float]:
    """Parameter to estimate; NaN for one that the data does not determine."""
    return {name: float("nan") if name in result.open_parameters else float(value)
            for name, value in zip(result.mechanism.names, result.beta)}
