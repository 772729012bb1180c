"""`write_simulator`: a model as a folder for MuJoCo, which needs nothing of legid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from experiments.console import make_directory, write_text
from experiments.models import Model
from experiments.simulators.mjcf import Start, mjcf_notes, mjcf_of, needed_mujoco
from experiments.simulators.module import module_of
from experiments.simulators.parts import parts_of


class SimulatorFiles(NamedTuple):
    """A folder in memory."""

    texts: dict[str, str]
    """By name."""
    notes: list[str]
    """What they hold otherwise than the model."""
    needs: tuple[int, int]
    """The first version of MuJoCo that reads them."""


def simulator_files(model: Model, where: str, command: str, starts: Sequence[Start] = ()) -> SimulatorFiles:
    """leg.xml and leg.py. Raises `InputError` naming what no simulator's model can hold."""
    parts = parts_of(model, where)
    notes = mjcf_notes(parts)
    left = sorted({effect.name for effect in parts.left} | ({"structure"} if model.structure else set()))
    if left:
        notes.append(f"leg.py applies {', '.join(left)}; leg.xml alone does not")
    texts = {"leg.xml": mjcf_of(parts, notes, starts), "leg.py": module_of(parts, command)}
    return SimulatorFiles(texts, notes, needed_mujoco(parts))


def write_simulator(model: Model, where: str, folder: Path, command: str, starts: Sequence[Start] = ()) -> list[str]:
    """Write leg.xml and leg.py; returns what they hold otherwise than the model. Raises `InputError`."""
    files = simulator_files(model, where, command, starts)
    make_directory(folder)
    for name, text in files.texts.items():
        write_text(folder / name, text)
    return files.notes
