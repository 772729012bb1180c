"""`export_model_as`: a model as the files of another simulator, and in words what they hold."""

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
class Wanted:
    """Contents of a model's files in addition to it."""

    starts: Prepared | None = None
    """Runs whose first states leg.xml keeps."""
    samples: int = 0
    """Models more, drawn by the joint covariance from `seed`."""
    seed: int = 1
    limits: Limits | None = None
    """Of a rig, for URDF."""


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


def export_model_as(kind: str, model: Model, where: str, out: Path | str, wanted: Wanted = Wanted()) -> Written:
    """Write `model`, which `where` names, to the file or folder `out`. Raises `InputError` naming what no format can
    hold."""
    if kind == "mujoco":
        return _folder(model, where, Path(out), wanted)
    text, notes = export_model(model, kind, where, wanted.limits)
    write_text(out, text)
    return Written(f"{out}: {kind.upper()} model of {where}", tuple(notes))


def _folder(model: Model, where: str, out: Path, wanted: Wanted) -> Written:
    """leg.xml and leg.py, and drawn models."""
    command = command_line() or "legid export"
    starts = [] if wanted.starts is None else starts_of(model, wanted.starts)
    notes = write_simulator(model, where, out, command, starts)
    kept = f" with the first states of {len(starts)} runs" if starts else ""
    lines = [f"{out}: leg.xml{kept} and leg.py of {where}"]
    if wanted.samples:
        samples = draw_models(model, where, wanted.samples, wanted.seed)
        write_samples(samples, where, out, command)
        again = f", {samples.redrawn} draws that no leg can have left out" if samples.redrawn else ""
        lines.append(f"{out}: samples.csv, {wanted.samples} models below samples, batch.py{again}")
        notes = [*notes, *([f"not determined, kept at the model's value: {', '.join(samples.held)}"]
                           if samples.held else [])]
    return Written("\n".join([*lines, f"Next: python {shlex.quote(str(out / 'leg.py'))} RUN.csv"]), tuple(notes))
