"""Functions around a fit: other programs' files in, gains of a model, the library of effects, torque plans."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from daq import Column, InputError, Rig, load_rig
from experiments.exchange import apply_map, check_map, load_map, read_imported
from experiments.excite import Band, Bench, Search, design, first_plan
from experiments.models import Model, Tolerances, gains_of
from legid.listings import Effects, Excitation, Gains
from legid.results import Dataset, dressed

__all__ = ["effects", "excite", "gains", "read"]
RigLike = Rig | Path | str


def read(file: Path | str, columns: Path | str | Mapping[str, Mapping[str, Any]], rate_hz: float | None = None,
         rig: RigLike | None = None) -> Dataset:
    """A file of another program as a run: columns (n,) in SI units on a uniform grid of `rate_hz`.

    `columns` maps the contract's columns to the file's, as a COLUMNS.toml or its table `[columns]` as a dictionary:
    `{"q2_rad": {"name": "angle", "unit": "deg"}}`. The default of `rate_hz` is the slowest signal's. A `rig` makes the
    run one that `fit` takes without another word. Raises `InputError` naming file and column.
    """
    if rate_hz is not None and not 0.0 < rate_hz < 1e6:
        raise InputError("rate_hz", f"{rate_hz:g} is not a rate in Hz", "give samples per second")
    if isinstance(columns, Mapping):
        try:
            known = check_map(msgspec.convert(dict(columns), dict[str, Column]), "columns")
        except msgspec.ValidationError as error:
            raise InputError("columns", str(error), "see docs/exchange.md") from None
    else:
        known = load_map(columns)
    run = apply_map(read_imported(file), known, rate_hz)
    return dressed(Dataset, run, rig=None if rig is None else _rig(rig))


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
    known = _rig(rig)
    if model is None:
        return Excitation(first_plan(known, seed, seconds, peak_nm, low_hz, high_hz, holds), rig=known)
    if peak_nm is not None or holds is not None:
        raise InputError("peak_nm and holds", "are for a plan without a model",
                         "leave them out; margin scales the plan")
    found = design(Bench(model, known, "the model", doubt), Band(seconds, low_hz or 0.0, high_hz),
                   Search(margin, criterion, tries, steps, seed), progress)
    return Excitation(found.best.plan, found, known)


def _rig(rig: RigLike) -> Rig:
    return rig if isinstance(rig, Rig) else load_rig(rig)
