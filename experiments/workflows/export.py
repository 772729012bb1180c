"""A model as the files of another simulator, and in words what they hold."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from daq import InputError, Limits
from experiments.console import command_line, write_text
from experiments.models import Model
from experiments.session import Prepared
from experiments.simulators import draw_models, export_model, write_samples, write_simulator
from experiments.workflows.in_mujoco import starts_of

OF_RUNS, OF_MODELS = ("csv", "parquet", "mat", "ros2"), ("mjcf", "urdf", "mujoco")
"""Formats of a run, and of a model."""
ENDINGS = {".csv": "csv", ".csv.gz": "csv", ".parquet": "parquet", ".mat": "mat", ".mcap": "ros2",
           ".xml": "mjcf", ".mjcf": "mjcf", ".urdf": "urdf"}
"""Ending of a file's name -> its format."""


@dataclass(frozen=True)
class Written:
    """Files that were written, in words."""

    text: str
    """For a person."""
    notes: tuple[str, ...] = ()
    """What the files do not hold, or hold otherwise than the model."""


def export_kind(out: str, kind: str | None = None) -> str:
    """`kind`, or the format that the ending of `out` tells. Raises `InputError`."""
    found = kind or next((told for ending, told in ENDINGS.items() if out.lower().endswith(ending)), None)
    if found not in (*OF_RUNS, *OF_MODELS):
        what = "has no ending that tells a format" if found is None else f"cannot be of the format {found!r}"
        raise InputError(out, what, f"give --to {'|'.join((*OF_RUNS, *OF_MODELS))}")
    return found


def check_wanted(kind: str, starts: bool, samples: int) -> None:
    """Raises `InputError` for what the format does not take; `starts`: whether runs were given."""
    for flag, given in (("--starts", starts), ("--samples", samples)):
        if given and kind != "mujoco":
            raise InputError(flag, "is for --to mujoco", "leave it out")


def export_file(kind: str, model: Model, where: str, out: Path | str, limits: Limits | None = None) -> Written:
    """Write `model`, which `where` names, as one file, with the `limits` of a rig in URDF. Raises `InputError` naming
    what the format cannot hold."""
    text, notes = export_model(model, kind, where, limits)
    write_text(out, text)
    return Written(f"{out}: {kind.upper()} model of {where}", tuple(notes))


def export_folder(model: Model, where: str, out: Path, runs: Prepared | None = None, count: int = 0, seed: int = 1
                  ) -> Written:
    """Write leg.xml, which keeps the first states of `runs`, leg.py, and `count` models drawn from `seed`. Raises
    `InputError`."""
    command = command_line() or "legid export"
    starts = [] if runs is None else starts_of(model, runs)
    notes = write_simulator(model, where, out, command, starts)
    kept = f" with the first states of {len(starts)} runs" if starts else ""
    lines = [f"{out}: leg.xml{kept} and leg.py of {where}"]
    if count:
        samples = draw_models(model, where, count, seed)
        write_samples(samples, where, out, command)
        again = f", {samples.redrawn} draws that no leg can have left out" if samples.redrawn else ""
        lines.append(f"{out}: samples.csv, {count} models below samples, batch.py{again}")
        notes += [f"not determined, kept at the model's value: {', '.join(samples.held)}"] if samples.held else []
    return Written("\n".join([*lines, f"Next: python {shlex.quote(str(out / 'leg.py'))} RUN.csv"]), tuple(notes))
