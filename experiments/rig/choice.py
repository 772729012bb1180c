"""Which rig file a command goes by: the one given, the one that a run holds, or ./rig.toml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from daq import InputError, Rig, load_rig, parse_rig
from experiments.provenance import Source, source_of, text_source

HERE = "rig.toml"
COMPARED = ("mechanism", "terms", "imu", "motor", "calibration")
"""Tables that are facts of the rig; the others are choices of a recording or of an analysis."""


@dataclass(frozen=True)
class ChosenRig:
    """A rig, and where it comes from."""

    rig: Rig
    source: Source
    note: str
    """Which was taken, where none was given; else empty."""
    warnings: tuple[str, ...]
    """Runs that were recorded on another rig, and how it differs."""


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
        where, note = f"{name} (rig.toml inside)", f"rig: the one that {name} holds"
        rig, source = parse_rig(text, where), text_source(text, HERE, name)
    else:
        path = rig_path(given)
        rig, where, source = load_rig(path), str(path), source_of(path)
        note = "" if given is not None else f"rig: ./{HERE}"
    return ChosenRig(rig, source, note, tuple(w for name, text in held for w in _differences(name, text, rig, where)))


def rig_path(given: Path | str | None) -> Path | str:
    """The path given, else ./rig.toml. Raises `InputError` where that is not there."""
    if given is None and not Path(HERE).is_file():
        raise InputError("--rig", f"is not given, and neither a run nor ./{HERE} says what the rig is",
                         "give the rig's TOML file")
    return HERE if given is None else given


def _differences(name: str, text: str, rig: Rig, where: str) -> list[str]:
    try:
        then, now = (_tables(r) for r in (parse_rig(text, name), rig))
    except InputError as error:
        return [f"the rig file inside it cannot be compared: {error}"]
    return [f"{name} was recorded with {table}.{key} = {value}, {where} says {now[table][key]}"
            for table in then.keys() & now.keys() for key, value in then[table].items()
            if value != now[table][key] and value is not None]  # what a recording left open contradicts nothing


def _tables(rig: Rig) -> dict[str, dict[str, object]]:
    """Name to entries of the tables that are compared; of several IMUs one each."""
    found = {table: msgspec.to_builtins(getattr(rig, table)) for table in COMPARED if table != "imu"}
    return found | {f"imu {k + 1}" if k else "imu": msgspec.to_builtins(imu) for k, imu in enumerate(rig.imus)}
