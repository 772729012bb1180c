"""Functions around a fit: other programs' files in, gains of a model, the library of effects, torque plans."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from daq import Column, InputError, Rig
from daq import Dataset as PlainDataset
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
)
from experiments.excite import Band, Bench, Search, design, first_plan
from experiments.models import Model, Tolerances, gains_of
from experiments.session import prepare, require_whole
from experiments.workflows import OF_MODELS, OF_RUNS, Wanted, check_wanted, export_kind, export_model_as
from legid.given import RigLike, Runs, as_rig
from legid.listings import Effects, Excitation, Gains, Guess
from legid.results import Dataset

__all__ = ["effects", "excite", "export", "gains", "guess", "read"]


def guess(file: Path | str, rate_hz: float | None = None) -> Guess:
    """The columns of another program's file with units and signs, by names, gravity and the equation of motion.

    `legid.read(file, guess.columns)` is then the run. A file without times has `rate_hz` rows a second. Raises
    `InputError` for a file that cannot be read, or whose columns no name and no physics tells apart.
    """
    _check_rate(rate_hz)
    return Guess(guess_map(read_imported(file), rate_hz=rate_hz), Path(file).name)


def export(what: Model | PlainDataset | Path | str, out: Path | str, to: str | None = None, *,
           rig: RigLike | None = None, starts: Runs = (), samples: int = 0, seed: int = 1, servo: str = ""
           ) -> tuple[str, ...]:
    """Write a model, or a run, in another format, as `legid export`; returns what the format does not hold, in words.

    A run as csv, parquet or mat; a model as mjcf, urdf, mujoco or learning. `to` is by default what the ending of `out`
    tells; mujoco and learning are folders. A run file goes to ros2, too, at its devices' own rates.

    - `rig`: with urdf, whose limits the joints get; with `starts`, that of the runs; of a run file, its own.
    - `starts`: with mujoco, runs whose first states leg.xml keeps; with learning, runs that measure what is lost.
    - `samples`: with mujoco, so many models more, drawn by the joint covariance from `seed`. `servo`: with learning,
      the actuator as BAM names it.

    Raises `InputError` for what the format cannot hold or take.
    """
    kind, wanted = export_kind(str(out), to), Wanted(samples=samples, seed=seed, servo=servo)
    given = (starts,) if isinstance(starts, PlainDataset) else tuple(starts)
    check_wanted(kind, wanted, bool(given))
    if isinstance(what, Model) != (kind in OF_MODELS):
        raise InputError(str(out), f"{kind} is no format of a {'model' if isinstance(what, Model) else 'run'}",
                         f"a run goes to {', '.join(OF_RUNS)}, a model to {', '.join(OF_MODELS)}")
    if isinstance(what, Model):
        known = None if rig is None else as_rig(rig)
        if given:
            own = known or getattr(given[0], "rig", None)
            if own is None:
                raise InputError(given[0].name, "was not loaded with a rig", "give the path of its rig.toml as rig")
            wanted = replace(wanted, starts=prepare(given, own, beta=np.array(what.beta)))
        elif known is not None:
            wanted = replace(wanted, limits=known.limits)
        return export_model_as(kind, what, "the model", out, wanted).notes
    if kind == "ros2":
        if isinstance(what, PlainDataset) or isinstance(rig, Rig):
            raise InputError(str(out), "ros2 keeps the times of every device", "give the paths of run and rig file")
        return tuple(export_ros2(what, rig, out).notes)
    if not isinstance(what, PlainDataset):
        what = load_any_run(what, rig, None) if isinstance(rig, Rig) else load_to_convert(what, rig, None)
    export_run(require_whole(what), kind, out)
    return ()


def read(file: Path | str, columns: Path | str | Mapping[str, Column | Mapping[str, Any]], rate_hz: float | None = None,
         rig: RigLike | None = None) -> Dataset:
    """A file of another program as a run: columns (n,) in SI units on a uniform grid of `rate_hz`.

    `columns` maps the contract's columns to the file's, as a COLUMNS.toml or its table `[columns]` as a dictionary:
    `{"q2_rad": {"name": "angle", "unit": "deg"}}`. The default of `rate_hz` is the slowest signal's. A `rig` makes the
    run one that `fit` takes without another word. Raises `InputError` naming file and column.
    """
    _check_rate(rate_hz)
    if isinstance(columns, Mapping):
        try:
            known = check_map(msgspec.convert(dict(columns), dict[str, Column]), "columns")
        except msgspec.ValidationError as error:
            raise InputError("columns", str(error), "see docs/exchange.md") from None
    else:
        known = load_map(columns)
    require_scales(known, "columns")
    run = apply_map(read_imported(file), known, rate_hz)
    return Dataset.of(run, None if rig is None else as_rig(rig))


def gains(model: Model, angle_rad: float = 0.05, speed_radps: float = 1.0, torque_nm: float = 1.0,
          delay_s: float = 0.002) -> Gains:
    """Feedforward and PD gains of a model's driven joint, with the margins of the whole leg.

    An LQR about hanging by Bryson's rule: errors of the angle [rad] and speed [rad/s] and the torque [N m] are weighed
    by what is tolerated of each; `delay_s` is everything that is late in the loop [s]. Raises `InputError` for a model
    without one driven joint, `WorkError` where the loop would not be stable.
    """
    wanted = Tolerances(angle_rad, speed_radps, torque_nm, delay_s)
    return Gains(gains_of(model, "the model", wanted), wanted)


def effects() -> Effects:
    """The library of effects that `diagnose` can name, those of installed packages included.

    Raises `InputError` for a package whose effect cannot be used.
    """
    found = Effects()
    _ = found.document
    return found


def excite(rig: RigLike, model: Model | None = None, *, seconds: float = 20.0, low_hz: float | None = None,
           high_hz: float = 3.0, peak_nm: float | None = None, holds: int | None = None, margin: float = 0.8,
           criterion: str = "d", doubt: float = 0.1, tries: int = 2, steps: int = 80, seed: int = 0,
           progress: Callable[[float, float], None] | None = None) -> Excitation:
    """A torque plan of `seconds` [s] for `rig` that tells most about all parameters, by a prior `model` of it.

    Within `margin` of the rig's limits, for models too whose parameters are off by the share `doubt`. `criterion`: d or
    worst, as `legid excite` has them. Without a model: equal sines of `peak_nm` [N m], by default a tenth of the rig's
    limit, or a staircase of so many `holds`; their motion is unknown. `progress` is called with (done, total) starts.
    Raises `InputError` for a model of another rig or a plan beyond the limits, `WorkError` where no plan keeps them.
    """
    known = as_rig(rig)
    if model is None:
        return Excitation(first_plan(known, seed, seconds, peak_nm, low_hz, high_hz, holds), rig=known)
    if peak_nm is not None or holds is not None:
        raise InputError("peak_nm and holds", "are for a plan without a model",
                         "leave them out; margin scales the plan")
    found = design(Bench(model, known, "the model", doubt), Band(seconds, low_hz or 0.0, high_hz),
                   Search(margin, criterion, tries, steps, seed), progress)
    return Excitation(found.best.plan, found, known)


def _check_rate(rate_hz: float | None) -> None:
    """Raises `InputError` for what is no rate [Hz]."""
    if rate_hz is not None and not 0.0 < rate_hz < 1e6:
        raise InputError("rate_hz", f"{rate_hz:g} is not a rate in Hz", "give samples per second")
