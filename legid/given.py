"""Input of a verb: runs, the rig that they were loaded with, a model or its file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from daq import Dataset, InputError, Rig, load_rig
from experiments.models import Model, load_model
from experiments.provenance import Source
from experiments.reports import source_of
from legid.results import sources_of

RigLike = Rig | Path | str
Runs = Dataset | Sequence[Dataset]


def as_rig(rig: RigLike) -> Rig:
    """The rig itself, or that of the file. Raises `InputError`."""
    return rig if isinstance(rig, Rig) else load_rig(rig)


def as_model(model: Model | Path | str, name: str) -> tuple[Model, str]:
    """A model, and what names it in errors: its file, or else `name`."""
    return (model, name) if isinstance(model, Model) else (load_model(model), str(model))


def earlier_of(against: Runs | Model | Path | str) -> tuple[Model | tuple[Dataset, ...], str, tuple[Source, ...]]:
    """Earlier runs, or a model and what names it, and their files."""
    if isinstance(against, Model | Path | str):
        return *as_model(against, "the model"), () if isinstance(against, Model) else (source_of(against),)
    runs = as_runs(against)
    return runs, "", sources_of(runs)


def stored_rig(paths: Sequence[Path | str]) -> Rig:
    """The rig inside the first native run."""
    from daq.runs import read_run
    from daq.timing import recorded_rig

    for path in paths:
        if str(path).lower().endswith(".mcap"):
            return recorded_rig(read_run(path))
    raise InputError(str(paths[0]) if paths else "load", "holds no rig", "give the path of its rig.toml as rig")


def as_runs(runs: Dataset | Iterable[Dataset]) -> tuple[Dataset, ...]:
    """One run, or several, as a tuple."""
    return (runs,) if isinstance(runs, Dataset) else tuple(runs)


def runs_and_rig(runs: Dataset | Iterable[Dataset], rig: RigLike | None) -> tuple[tuple[Dataset, ...], Rig]:
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
    return given, first
