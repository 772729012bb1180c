"""Input of a verb: runs, the rig that they were loaded with, a model or its file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from daq import Dataset, InputError, Rig
from experiments.models import Model, load_model
from experiments.provenance import Source, source_of
from experiments.rig import ChosenRig, choose_rig
from legid.results import sources_of

RigLike = Rig | ChosenRig | Path | str
Runs = Dataset | Sequence[Dataset]
ModelLike = Model | Path | str


class GivenModel(NamedTuple):
    """A model, what names it in errors, and its file, if it was given as one."""

    model: Model
    where: str
    source: Source | None


def as_rig(rig: RigLike) -> ChosenRig:
    """The rig, or that of the file, with its source. Raises `InputError`."""
    if isinstance(rig, ChosenRig):
        return rig
    return ChosenRig(rig) if isinstance(rig, Rig) else choose_rig(rig)


def as_model(model: ModelLike, name: str) -> GivenModel:
    """A model, or that of the file; errors call it `name`, or by its file."""
    if isinstance(model, Model):
        return GivenModel(model, name, None)
    return GivenModel(load_model(model), str(model), source_of(model))


def earlier_of(against: Runs | ModelLike) -> tuple[tuple[Dataset, ...] | GivenModel, tuple[Source, ...]]:
    """Earlier runs, or a model that was made from some, and their files."""
    if isinstance(against, ModelLike):
        model = as_model(against, "the model")
        return model, () if model.source is None else (model.source,)
    runs = as_runs(against)
    return runs, sources_of(runs)


def stored_rig(paths: Sequence[Path | str]) -> ChosenRig:
    """The rig inside the first native run."""
    if not any(str(path).lower().endswith(".mcap") for path in paths):
        raise InputError(str(paths[0]) if paths else "load", "holds no rig", "give the path of its rig.toml as rig")
    return choose_rig(None, paths)


def as_runs(runs: Dataset | Iterable[Dataset]) -> tuple[Dataset, ...]:
    """One run, or several, as a tuple."""
    return (runs,) if isinstance(runs, Dataset) else tuple(runs)


def runs_and_rig(runs: Dataset | Iterable[Dataset], rig: RigLike | None) -> tuple[tuple[Dataset, ...], ChosenRig]:
    """The runs as a tuple, and the rig given or else the one that they were loaded with."""
    given = as_runs(runs)
    if not given:
        raise InputError("runs", "is empty", "give a run, or a list of them")
    if rig is not None:
        return given, as_rig(rig)
    first = getattr(given[0], "rig", None)
    for run in given:
        own = getattr(run, "rig", None)
        if own is None:
            raise InputError(getattr(run, "name", str(run)), "was not loaded with a rig",
                             "give the path of its rig.toml as rig")
        if own != first:
            raise InputError(run.name, f"was loaded with another rig than {given[0].name}", "give the rig to be used")
    assert isinstance(first, Rig)
    return given, ChosenRig(first, getattr(given[0], "rig_source", None))
