"""The commands' verbs as functions, for scripts and notebooks.

    import legid

    runs = legid.load(["run1.mcap", "run2.mcap"])
    result = legid.fit(runs)
    print(result.mechanism.names, result.beta, result.ci95())

A `rig` is the path of a rig.toml or the `Rig` that `load_rig` makes of it; left out, it is the one that the runs were
loaded with, and for a native run the one that is stored in its file. Runs are `Dataset` objects: columns of
contract names in SI units on one uniform grid, NaN where a sample is missing. Every function that takes runs also takes
a single run. What reads and writes recordings is imported by the functions that need it: a fit of a CSV does not wait
for it. Nothing is printed but a progress bar on a terminal. Unusable input raises `InputError`; what cannot be
done on this data or device raises `WorkError`, `FitError` or a `DriverError`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

import numpy as np

from daq import Dataset as PlainDataset
from daq import InputError as InputError
from daq import Rig as Rig
from daq import WorkError as WorkError
from daq import load_rig as load_rig
from daq.recording import Plan as Plan
from daq.recording import read_plan as read_plan
from daq.recording import write_plan as write_plan
from drivers import DriverError as DriverError
from estimator import FitError as FitError
from estimator import FitResult as PlainFit
from estimator import Method
from estimator.diagnosis import MATERIAL
from estimator.diagnosis import Diagnosis as PlainDiagnosis
from estimator.prediction import HORIZONS_S
from experiments import workflows  # each verb loads its own
from experiments.console import work_bar
from experiments.documents import Pair
from experiments.excite import random_multisine
from experiments.models import Model as Model
from experiments.models import load_model as load_model
from experiments.models import save_model as save_model
from experiments.provenance import source_of
from experiments.rig import ChosenRig
from experiments.session import load_runs, prepare, with_terms_of
from legid.changes import Change, Sessions
from legid.comparisons import Comparison
from legid.diagnoses import Diagnosis
from legid.fits import FitResult
from legid.found_models import model_of_diagnosis, model_of_fit
from legid.given import (
    GivenModel,
    ModelLike,
    RigLike,
    Runs,
    as_model,
    as_rig,
    as_runs,
    earlier_of,
    runs_and_rig,
    stored_rig,
)
from legid.listings import Tuning
from legid.results import Dataset, origin_from, sources_of
from legid.validations import Validations

if TYPE_CHECKING:
    from daq.recording import RecordReport

Progress = Callable[[str, float], None]
multisine = random_multisine


@dataclass(frozen=True)
class Recording:
    """A finished recording."""

    run: Dataset
    """What was recorded, as `load` gives it."""
    report: RecordReport
    """Duration [s], commands sent and left out, IMU samples, bound of the controller's clock [s]."""
    warnings: tuple[str, ...]
    """What made the clock less certain than it could be, one line each."""


@overload
def load(runs: Path | str, rig: RigLike | None = None, damaged: bool = False  # type: ignore[overload-overlap]
         ) -> Dataset: ...
@overload
def load(runs: Sequence[Path | str], rig: RigLike | None = None, damaged: bool = False) -> tuple[Dataset, ...]: ...
def load(runs: Path | str | Sequence[Path | str], rig: RigLike | None = None, damaged: bool = False
         ) -> Dataset | tuple[Dataset, ...]:
    """A run file on the uniform grid of the rig's `[sampling] rate_hz`; of a list of files, a tuple in its order.

    Columns (n,) in SI units, angles and IMU axes by the contract (docs/formats.md, "A run as CSV"). Without a `rig` the
    one stored in the (first) native run is taken. A file of which something is missing is refused unless `damaged` ones
    are wanted. Raises `InputError` naming file, line and column.
    """
    paths = [runs] if isinstance(runs, Path | str) else list(runs)
    known, sources = stored_rig(paths) if rig is None else as_rig(rig), [source_of(path) for path in paths]
    found = tuple(Dataset.of(data, known.rig, source, known.source)
                  for source, data in zip(sources, load_runs(paths, known.rig, damaged), strict=True))
    return found[0] if isinstance(runs, Path | str) else found


def fit(runs: Runs, rig: RigLike | None = None, method: Method = "mle", sensors: str | None = None,
        fixed: Mapping[str, float] | None = None, latent: str = "trajectory", choose: bool = True) -> FitResult:
    """Identify the parameters of the rig's mechanism from `runs`, all together.

    Runs that cannot be used are set aside. The records choose what the rig file leaves open, unless `choose` is False.
    The result's `findings` say both.

    - `method`: mle (maximum likelihood along one motion, the default), wls (section III of Dolinsky and Celikovsky,
      IEEE TCST 26(4), 2018), rls, hekf (its appendices). `latent="free"`: the paper's maximum likelihood, section IV.
    - `sensors`: imu or encoder, the source of the pivot's angle; None takes the IMU where all runs have it.
    - `fixed`: given parameters by name.

    The result is the document `legid.fit/1` (docs/formats.md): `trust`, `parameters`, `noise`, and so on. It also has
    `beta` (p,) in the order of `mechanism.parameters`, which have the units (kg m^2, kg m, N m s/rad, N m), `ci95()`
    (p, 2), `covariance` (p, p), the estimated motion (`trajectories`), `to_frame()` and `plot()`.

    Check `converged` and `undetermined`; `model` refuses an unusable result. Raises `InputError`, or `FitError` where
    the data cannot answer.
    """
    given, known = runs_and_rig(runs, rig)
    found = workflows.fit_runs(given, known.rig, sensors=sensors, fixed=fixed, latent=latent, method=method,
                               choose=choose)
    return FitResult.made_from(found, given, origin_from(sources_of(given), known.source))


def validate(model: ModelLike, runs: Runs, rig: RigLike | None = None, sensors: str | None = None,
             against: ModelLike | None = None, horizons_s: Sequence[float] | None = None,
             simulator: Literal["legid", "mujoco"] = "legid") -> Validations:
    """Free-run simulation of `model` against runs that it was not fitted to (Table V of the paper).

    Models are given as they are or as their files. `simulator="mujoco"`: by MuJoCo, with what `legid export --to
    mujoco` writes.

    Each gap-free segment is simulated from its first state under its measured torque alone. The result is the document
    `legid.validation/1` (docs/formats.md): `trust`, `runs`, and `horizons` with the errors over `horizons_s` [s]
    (default 0.1, 0.5, 1, 5) and over whole segments, next to those of the model `against`. It is also a sequence of one
    `Validation` a segment: `q` and `reference_q` (N, joints) [rad], `rmse` and `sums` by column. `model` may hold
    effects. Raises `InputError` for a model of another mechanism, `FitError` where a first state cannot be estimated.
    """
    given, known = runs_and_rig(runs, rig)
    one, where, source = as_model(model, "the model")
    other = None if against is None else as_model(against, "the other model")
    if other is not None and other.model.mechanism.model != one.mechanism.model:
        raise InputError(other.where, f"is a {other.model.mechanism.model}, not a {one.mechanism.model}",
                         "give a model of the same mechanism")
    prepared = prepare(given, known.rig, sensors=sensors, model=one)
    files = sources_of(given)
    found = workflows.validate_prepared(one, prepared, where, files, other and other.model, _lengths(horizons_s))
    if simulator == "mujoco":
        found = workflows.validate_in_mujoco(one, found, where)
    return Validations.made_from(found, one, where, origin_from(files, known.source, source))


@overload
def diagnose(runs: Runs, rig: RigLike | None = None, seed: int = 0, reference: ModelLike | None = None,
             progress: Progress | None = None, workers: int | None = 1, material: float = MATERIAL,
             fixed: Mapping[str, float] | None = None, against: None = None) -> Diagnosis: ...
@overload
def diagnose(runs: Runs, rig: RigLike | None = None, *, against: Runs | ModelLike) -> Change: ...
def diagnose(runs: Runs, rig: RigLike | None = None, seed: int = 0, reference: ModelLike | None = None,
             progress: Progress | None = None, workers: int | None = 1, material: float = MATERIAL,
             fixed: Mapping[str, float] | None = None, against: Runs | ModelLike | None = None) -> Diagnosis | Change:
    """Errors of the simulation of the rig's model on `runs`, their causes, and the gain of extending the model.

    Give whole runs of one rig in the order in which they were recorded; eight of 20 s are good.

    - `material`: smallest relative reduction of the free-run rms error that counts.
    - `seed`: of bootstrap replicates and intervals. `reference`: an earlier model whose parameters are compared.
    - `progress` is called with (stage, fraction done). `workers` are forked processes, None: one a core. Use one in
      a program with threads.
    - `fixed`: given parameters by name; runs without a torque need one.

    The result is the document `legid.diagnosis/1` (docs/formats.md). Its `verdict` is none, named, partial, one_of,
    unexplained or fit_failed; `causes` have sizes with units and 95 % intervals. Raises `InputError` for runs that do
    not belong together.

    With earlier runs of the rig `against` which these are held, or a model (or its file) that a diagnosis of them
    gave, it is a `Change` since then; `seed`, `reference`, `progress`, `workers`, `material` and `fixed` have no part
    in it.
    """
    given, known = runs_and_rig(runs, rig)
    if against is not None:
        return _change_since(given, against, known)
    before = None if reference is None else as_model(reference, "reference")
    prepared = prepare(given, with_terms_of(known.rig, before and before.model), fixed=fixed, workers=workers)
    values = before and workflows.reference_values(before.model, before.where, prepared.setup)
    found = workflows.diagnose_prepared(prepared, seed, values, progress, workers, material)
    return Diagnosis.made_from(found, prepared, given, known.rig, origin_from(
        sources_of(given), known.source, before and before.source, seed=seed))


def _change_since(given: tuple[PlainDataset, ...], against: Runs | ModelLike, known: ChosenRig) -> Change:
    """Change of `given` since the runs `against`, or those that a model was made from."""
    earlier, files = earlier_of(against)
    found = (workflows.find_change_since(given, earlier.model, earlier.where, known.rig)
             if isinstance(earlier, GivenModel) else workflows.find_change(given, earlier, known.rig))
    made = Change.of(found.change, found.set_aside, files, found.datasets)
    made.provenance = origin_from(sources_of(given), known.source,
                                  earlier.source if isinstance(earlier, GivenModel) else None)
    return made


@overload
def compare(a: ModelLike, b: ModelLike, runs: Runs, rig: RigLike | None = None, sensors: str | None = None,
            names: tuple[str, str] = ("A", "B"), horizons_s: Sequence[float] | None = None) -> Comparison: ...
@overload
def compare(a: Runs, b: Runs, *, rig: RigLike | None = None, names: tuple[str, str] = ("A", "B")) -> Sessions: ...
def compare(a: ModelLike | Runs, b: ModelLike | Runs, runs: Runs = (), rig: RigLike | None = None,
            sensors: str | None = None, names: tuple[str, str] = ("A", "B"),
            horizons_s: Sequence[float] | None = None) -> Comparison | Sessions:
    """Two models on `runs` that neither was fitted to: parameters, free-run errors over horizons, which is better.

    Or the runs of two sessions: whether they differ beyond the scatter of runs within a session, and by what. Sizes are
    those of `b` less those of `a`.

    `names` are what the result calls them. The errors of two models are over `horizons_s` [s], by default 0.1, 0.5, 1
    and 5, and over whole segments. Runs that cannot be used are set aside. Raises `InputError` for models of
    another mechanism than the rig's and for runs that do not belong together, `FitError` where no motion can be
    estimated.
    """
    if not isinstance(a, ModelLike) and not isinstance(b, ModelLike):
        return compare_sessions([a, b], names, rig)
    if not isinstance(a, ModelLike) or not isinstance(b, ModelLike):
        raise InputError("compare", "was given a model and runs", "give two models and runs, or two sessions' runs")
    (first, _, of_a), (second, _, of_b) = as_model(a, names[0]), as_model(b, names[1])
    given, known = runs_and_rig(runs, rig)
    found = workflows.compare_models((first, second), names, given, known.rig, sensors, _lengths(horizons_s))
    return Comparison.made_from(found, given, first.mechanism.model, origin_from(
        sources_of(given), known.source, models=[one for one in (of_a, of_b) if one is not None]))


def compare_sessions(sessions: Sequence[Runs], names: Sequence[str], rig: RigLike | None = None,
                     workers: int | None = 1, cluster: str | None = None) -> Sessions:
    """Differences of each session of a rig from the first, as `compare` of two; `names` are what they are called.

    Pairs are shared by so many `workers` (None: one a core), or those of the Dask scheduler `cluster`. Raises
    `InputError`.
    """
    given, known = [as_runs(own) for own in sessions], runs_and_rig(sessions[0], rig)[1]
    count = len(given) - 1
    jobs = [workflows.SessionPair(given[0], own, (names[0], name), known.rig, count)
            for name, own in zip(names[1:], given[1:])]
    with work_bar("comparing", count, "session") as done:
        found = workflows.find_differences(jobs, workflows.choose_executor(1 if count == 1 else workers, cluster), done)
    every = [run for own in given for run in own]
    made = Sessions.of([Pair.of(one.change, job.names) for job, one in zip(jobs, found)],
                       [run for one in found for run in one.set_aside], every)
    made.provenance = origin_from(sources_of(every), known.source)
    return made


def tune(runs: Path | str | Sequence[Path | str], rig: RigLike | None = None, sensors: str | None = None,
         damaged: bool = False, progress: Progress | None = None, fixed: Mapping[str, float] | None = None) -> Tuning:
    """The entries of a rig file that predict its records best: grid, hold, filter, encoders' error and zeros, terms.

    Each is chosen by how well a fit to half of the runs predicts the other half. `runs` are files, since they are read
    on several grids. `progress` is called with (entry, share done). `fixed`: parameters that are given, by name. Raises
    `InputError`, and `FitError` where no run can be used.
    """
    paths = [runs] if isinstance(runs, Path | str) else list(runs)
    known = stored_rig(paths) if rig is None else as_rig(rig)
    origin = origin_from([source_of(path) for path in paths], known.source)
    found = workflows.tune_runs(paths, known.rig, sensors, damaged, progress or (lambda what, share: None), fixed)
    made = found.as_document(Tuning)
    made.provenance = origin
    return made


def model(found: FitResult | Diagnosis | PlainFit | PlainDiagnosis, runs: Runs | None = None,
          rig: RigLike | None = None) -> Model:
    """A fit, or a diagnosis with its effects, as the model that `validate`, `simulate` and `save_model` take.

    `runs` and `rig` are those that the estimator's own result was made from; a result of `fit` or `diagnose` remembers
    them. Raises `WorkError` for a fit that did not converge or left parameters undetermined, and for a diagnosis that
    failed.
    """
    if isinstance(found, FitResult):
        return model_of_fit(found.estimate, found.fitted.setup, found.runs, found.provenance or None)
    if isinstance(found, Diagnosis):
        made = model_of_diagnosis(found.details, found.prepared.setup, found.rig, found.fitted,
                                  found.provenance or None)
        return workflows.as_reference(made, found.prepared)
    given, known = runs_and_rig(() if runs is None else runs, rig)
    setup = prepare(given, known.rig).setup
    return model_of_fit(found, setup, given) if isinstance(found, PlainFit) else \
        model_of_diagnosis(found, setup, known.rig, given)


def record(rig: Path | str, plan: Plan, out: Path | str, emulate: str | None = None, seed: int = 1,
           progress: Callable[[float, float], None] | None = None) -> Recording:
    """Run `plan` on the real leg under the rig's limits and record it into the new file `out` (.mcap).

    `rig` is a path: a copy of that file goes into the run. `emulate` names an effect hidden in an emulated leg instead
    ("none": nothing), whose noise is drawn from `seed`; no device is opened then. `progress` is called with (done,
    total) in seconds. Ctrl-C stops the motor. Raises `InputError` for a plan beyond the limits, `WorkError` naming the
    limit that ended the run (what was recorded is kept), a `DriverError` for a device.
    """
    from experiments.workflows import record_plan

    report, warnings = record_plan(rig, plan, out, emulate, seed, progress)
    return Recording(load(out, rig), report, tuple(warnings))


def _lengths(horizons_s: Sequence[float] | None) -> Sequence[float]:
    """Lengths of free runs [s]. Raises `InputError`."""
    if horizons_s is None:
        return HORIZONS_S
    wrong = [one for one in horizons_s if not 0.0 < one < np.inf]
    if wrong or not horizons_s:
        raise InputError("horizons_s", f"{wrong or 'nothing'} is no length of time", "give seconds, such as 0.25")
    return horizons_s
