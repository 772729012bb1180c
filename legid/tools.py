"""Functions around a fit: other programs' files in, lists, fits one by one, what a model gives: plans, runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import msgspec

from daq import Column, InputError
from daq import Dataset as PlainDataset
from daq.recording import Plan
from estimator import Method
from experiments.console import work_bar
from experiments.exchange import (
    apply_map,
    check_map,
    export_ros2,
    export_run,
    guess_map,
    load_any_run,
    load_map,
    load_to_convert,
    read_imported,
    require_scales,
    with_scales,
)
from experiments.excite import Band, Bench, Search, design, first_plan
from experiments.models import Model, range_note_of
from experiments.provenance import source_of
from experiments.reports import choose
from experiments.reports import list_runs as lines_of
from experiments.session import prepare, require_whole
from experiments.workflows import (
    OF_MODELS,
    OF_RUNS,
    Refit,
    Written,
    check_wanted,
    choose_executor,
    export_file,
    export_folder,
    export_kind,
    follow_commands,
    plan_for,
    refit_all,
    simulate_run,
)
from legid.given import ModelLike, RigLike, Runs, as_model, as_rig, as_runs, runs_and_rig, stored_rig
from legid.listings import Effects, Excitation, Guess
from legid.results import Dataset, origin_from
from legid.run_lists import Fits, RunList


def guess(file: Path | str, rate_hz: float | None = None, scale: Mapping[str, float] | None = None) -> Guess:
    """The columns of another program's file with units and signs, by names, gravity and the equation of motion.

    `legid.read(file, guess.columns)` is then the run. A file without times has `rate_hz` rows a second; `scale` is as
    in `read`. A `UserWarning` says each point to be looked at. Raises `InputError` for a file that cannot be read, or
    whose columns no name and no physics tells apart.
    """
    _check_rate(rate_hz)
    found = guess_map(read_imported(file), rate_hz=rate_hz, scale=scale)
    for text in (*found.unexplained, *found.warnings):
        warnings.warn(text, stacklevel=2)
    return Guess(found, Path(file).name)


def export(what: ModelLike | PlainDataset, out: Path | str, to: str | None = None, *, rig: RigLike | None = None,
           starts: Runs = (), samples: int = 0, seed: int = 1, rate_hz: float | None = None, damaged: bool = False
           ) -> Written:
    """Write a model, or a run, in another format, as `legid export`; `notes` of what it returns say what is not held.

    A run as csv, parquet or mat; a model as mjcf, urdf or mujoco. `to` is by default what the ending of `out` tells;
    mujoco is a folder. A run file goes to ros2, too, at its devices' own rates.

    - `rig`: with urdf, whose limits the joints get; with `starts`, that of the runs; of a run file, its own.
    - `starts`: with mujoco, runs whose first states leg.xml keeps.
    - `samples`: with mujoco, so many models more, drawn by the joint covariance from `seed`.
    - `rate_hz`: samples per second of a run file, by default the rig's; `damaged`: also of one that lacks something.

    Raises `InputError` for what the format cannot hold or take.
    """
    kind, given = export_kind(str(out), to), as_runs(starts)
    check_wanted(kind, bool(given), samples)
    if isinstance(what, PlainDataset if kind in OF_MODELS else Model):
        raise InputError(str(out), f"{kind} is no format of a {'model' if isinstance(what, Model) else 'run'}",
                         f"a run goes to {', '.join(OF_RUNS)}, a model to {', '.join(OF_MODELS)}")
    if not isinstance(what, PlainDataset) and kind in OF_MODELS:
        model, where, _ = as_model(what, "the model")
        if kind == "mujoco":
            runs = prepare(given, runs_and_rig(given, rig)[1].rig, model=model) if given else None
            return export_folder(model, where, Path(out), runs, samples, seed)
        return export_file(kind, model, where, out, None if rig is None else as_rig(rig).rig.limits)
    assert not isinstance(what, Model)
    return _export_run(what, kind, out, rig, rate_hz, damaged)


def _export_run(what: PlainDataset | Path | str, kind: str, out: Path | str, rig: RigLike | None,
                rate_hz: float | None, damaged: bool) -> Written:
    if kind == "ros2":
        if isinstance(what, PlainDataset) or not isinstance(rig, Path | str | None):
            raise InputError(str(out), "ros2 keeps the times of every device", "give the paths of run and rig file")
        done = export_ros2(what, rig, out)
        return Written(f"{out}: {done.messages} messages of {what}", tuple(done.notes))
    if not isinstance(what, PlainDataset):
        what = load_to_convert(what, rig, rate_hz) if isinstance(rig, Path | str | None) else load_any_run(
            what, as_rig(rig).rig, rate_hz)
    data = require_whole(what, damaged)
    rows = export_run(data, kind, out)
    return Written(f"{out}: {rows} samples at {data.rate_hz:g} Hz, columns time_s, {', '.join(data.columns)}",
                   (f"{data.name} is damaged: {'; '.join(map(str, data.damage))}",) if data.damage else ())


def read(file: Path | str, columns: Path | str | Mapping[str, Column | Mapping[str, Any]], rate_hz: float | None = None,
         rig: RigLike | None = None, scale: Mapping[str, float] | None = None) -> Dataset:
    """A file of another program as a run: columns (n,) in SI units on a uniform grid of `rate_hz`.

    `columns` maps the contract's columns to the file's, as a COLUMNS.toml or its table `[columns]` as a dictionary:
    `{"q2_rad": {"name": "angle", "unit": "deg"}}`. The default of `rate_hz` is the slowest signal's. A `rig` makes the
    run one that `fit` takes without another word. `scale` has factors by column, such as {"tau2_nm": 0.12} for a log in
    amperes: N m per A, gear included. Raises `InputError` naming file and column.
    """
    _check_rate(rate_hz)
    if isinstance(columns, Mapping):
        try:
            known = check_map(msgspec.convert(dict(columns), dict[str, Column]), "columns")
        except msgspec.ValidationError as error:
            raise InputError("columns", str(error), "see docs/exchange.md") from None
    else:
        known = load_map(columns)
    known = with_scales(known, scale or {})
    require_scales(known, "columns")
    run = apply_map(read_imported(file), known, rate_hz)
    if rig is None:
        return Dataset.of(run)
    chosen = as_rig(rig)
    return Dataset.of(run, chosen.rig, rig_source=chosen.source)


def effects() -> Effects:
    """The library of effects that `diagnose` can name, those of installed packages included.

    Raises `InputError` for a package whose effect cannot be used.
    """
    found = Effects(origin_from(()))
    _ = found.document
    return found


def fit_each(files: Sequence[Path | str], rig: RigLike | Sequence[RigLike] | None = None, method: Method = "mle",
             sensors: str | None = None, fixed: Mapping[str, float] | None = None, latent: str = "trajectory",
             damaged: bool = False, workers: int | None = 1, cluster: str | None = None) -> Fits:
    """Every run file fitted alone, as `fit` does: one document a run, or why it has none.

    `rig` is one for all or one for each; None: the one inside each native run. The fits are shared by so many
    `workers` (None: one a core), or those of the Dask scheduler `cluster`. Raises `InputError` for a file that is not
    there; one that cannot be used is told of in its place.
    """
    rigs = [stored_rig([file]) for file in files] if rig is None else [as_rig(one) for one in (
        [rig] * len(files) if isinstance(rig, RigLike) else rig)]
    pieces = [Refit(str(Path(file).resolve()), known.rig, method, sensors, latent, dict(fixed or {}), damaged,
                    origin_from([source_of(file)], known.source)) for file, known in zip(files, rigs, strict=True)]
    with work_bar("fitting", len(pieces), "run") as done:
        return Fits(tuple(refit_all(pieces, choose_executor(workers, cluster), done)))


def list_runs(folder: Path | str, model: str | None = None, since: date | None = None, until: date | None = None,
              verdict: str | None = None, faulty: bool = False) -> RunList:
    """The run files in `folder` and below, oldest first: what each holds and lost, and its newest verdict.

    Only those of the rig's `model`, recorded from `since` to `until` (UTC), with that `verdict` ("-": without one),
    `faulty` ones. Raises `InputError` where there is no such folder.
    """
    every = lines_of(folder)
    lines = choose(every, model, since, until, verdict, faulty)
    where = Path(folder) if Path(folder).is_dir() else Path(folder).parent
    return RunList(tuple(lines), len(every), origin_from([source_of(where / line.file) for line in lines]))


def simulate(model: ModelLike, plan: Plan | Path | str, rate_hz: float | None = None,
             start: Sequence[float] | None = None, noise_seed: int | None = None, rig: RigLike | None = None
             ) -> Dataset:
    """The run that `model` would give under `plan`, from rest at the angles `start` (joints,) [rad], default zero.

    Columns (n,) as a recorded run has them, at `rate_hz` (default: the plan's). A file as `plan` holds a torque plan,
    or is a run, of which the measured torque is taken; with a `rig` it holds the commands that the rig's servo
    follows. `noise_seed` adds the model's own noise levels. A `UserWarning` says where the motion leaves the range of
    the model's structure. Raises `InputError` where the plan does not fit, `WorkError` where the motion diverges.
    """
    given = as_model(model, "the model")
    if rig is not None:
        if isinstance(plan, Plan):
            raise InputError("plan", "holds torques", "with a rig give a CSV of the commands that its servo follows")
        found = follow_commands(given.model, plan, as_rig(rig).rig, given.where, start)
    else:
        torque = plan if isinstance(plan, Plan) else plan_for(plan, given.model)
        found = simulate_run(given.model, torque, given.where, rate_hz, start, noise_seed)
    note = range_note_of(given.model, found)
    if note:
        warnings.warn(note, stacklevel=2)
    return Dataset.of(found)


def excite(rig: RigLike, model: ModelLike | None = None, *, seconds: float = 20.0, low_hz: float | None = None,
           high_hz: float = 3.0, peak_nm: float | None = None, holds: int | None = None, margin: float = 0.8,
           criterion: str = "d", doubt: float = 0.1, tries: int = 2, steps: int = 80, seed: int = 0,
           progress: Callable[[float, float], None] | None = None) -> Excitation:
    """A torque plan of `seconds` [s] for `rig` that tells most about all parameters, by a prior `model` of it.

    Within `margin` of the rig's limits, for models too whose parameters are off by the share `doubt`. `criterion`: d or
    worst, as `legid excite` has them. Without a model: equal sines of `peak_nm` [N m], by default a tenth of the rig's
    limit, or a staircase of so many `holds`; their motion is unknown. `progress` is called with (done, total) starts.
    Raises `InputError` for a model of another rig or a plan beyond the limits, `WorkError` where no plan keeps them.
    """
    known = as_rig(rig).rig
    if model is None:
        return Excitation(first_plan(known, seed, seconds, peak_nm, low_hz, high_hz, holds), rig=known)
    if peak_nm is not None or holds is not None:
        raise InputError("peak_nm and holds", "are for a plan without a model",
                         "leave them out; margin scales the plan")
    prior = as_model(model, "the model")
    found = design(Bench(prior.model, known, prior.where, doubt), Band(seconds, low_hz or 0.0, high_hz),
                   Search(margin, criterion, tries, steps, seed), progress)
    return Excitation(found.best.plan, found, known)


def _check_rate(rate_hz: float | None) -> None:
    """Raises `InputError` for what is no rate [Hz]."""
    if rate_hz is not None and not 0.0 < rate_hz < 1e6:
        raise InputError("rate_hz", f"{rate_hz:g} is not a rate in Hz", "give samples per second")
