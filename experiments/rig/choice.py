"""Choice of the rig file of a command: the one given, the one that a run holds, or ./rig.toml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from daq import InputError, Rig, load_rig, parse_rig
from experiments.provenance import Source, source_of, text_source

HERE = "rig.toml"


@dataclass(frozen=True)
class ChosenRig:
    """A rig, and where it comes from."""

    rig: Rig
    source: Source | None = None
    """None for a rig that is no file's."""
    note: str = ""
    """Which was taken, where none was given; else empty."""
    file: str | None = None
    """Its path; None where a run holds it."""


def choose_rig(given: Path | str | None, runs: Sequence[Path | str] = ()) -> ChosenRig:
    """The rig file `given`, else the first that one of `runs` holds, else ./rig.toml.

    Raises `InputError` where there is none, or it cannot be used.
    """
    held = []
    for run in runs:
        if str(run).lower().endswith(".mcap"):
            from daq.runs import attached_texts

            text = attached_texts(run).get(HERE)
            held += [(Path(run).name, text)] if text is not None else []
    if given is None and held:
        name, text = held[0]
        return ChosenRig(parse_rig(text, f"{name} (rig.toml inside)"), text_source(text, HERE, name),
                         f"rig: the one that {name} holds")
    path = rig_path(given)
    return ChosenRig(load_rig(path), source_of(path), "" if given is not None else f"rig: ./{HERE}", str(path))


def rig_path(given: Path | str | None) -> Path | str:
    """The path given, else ./rig.toml. Raises `InputError` where that is not there."""
    if given is None and not Path(HERE).is_file():
        raise InputError("--rig", f"is not given, no run contains a rig file, and there is no ./{HERE}",
                         f"give the rig's TOML file, or write it: legid init {HERE}")
    return HERE if given is None else given
