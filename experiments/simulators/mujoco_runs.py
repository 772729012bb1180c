"""`ExportedLeg`: the exported folder of a model, run by MuJoCo from given states of a record."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from daq import FloatArray, InputError
from experiments.models import Model
from experiments.simulators.folder import simulator_files
from experiments.simulators.mjcf import OLDEST

REMEDY = "pip install 'legid[mujoco]'"


class Piece(NamedTuple):
    """Samples of a record, and the state that they begin with."""

    first: int
    last: int
    q: FloatArray
    """(n,)"""
    v: FloatArray


class Record(NamedTuple):
    """A gap-free segment as it was measured."""

    time_s: FloatArray
    torque: FloatArray
    """(N, motors) as measured"""
    run_s: float = 0.0
    """Since the start of its run."""
    session_s: float = 0.0
    """Start of its run since that of the session."""


def require_mujoco(needed: tuple[int, int] = OLDEST) -> str:
    """Version of MuJoCo. Raises `InputError` where there is none, or an older one than `needed`."""
    try:
        import mujoco
    except ImportError:
        raise InputError("MuJoCo", "is not installed", REMEDY) from None
    found = str(mujoco.__version__)
    if tuple(map(int, found.split(".")[:2])) < needed:
        raise InputError(f"MuJoCo {found}", f"is older than {'.'.join(map(str, needed))}, which this model needs",
                         "pip install --upgrade mujoco")
    return found


class ExportedLeg:
    """The module of a model's folder. Raises `InputError` where MuJoCo is absent or too old for it."""

    def __init__(self, model: Model, where: str) -> None:
        files = simulator_files(model, where, "legid export")
        require_mujoco(files.needs)
        with tempfile.TemporaryDirectory() as folder:
            for name, text in files.texts.items():
                (Path(folder) / name).write_text(text, encoding="utf-8")
            self.module = SimpleNamespace(**run_path(str(Path(folder) / "leg.py")))
            self.leg = _with_rates(self.module)

    def run(self, record: Record, piece: Piece, step_s: float) -> Mapping[str, FloatArray]:
        """Readings by column (K,) of one piece, and the joints' rates as `q1d`, ... NaN from where it diverges."""
        found: Mapping[str, FloatArray] = self.module.replay(
            self.leg, record.time_s, record.torque, piece.q, piece.v, step_s, piece.first, piece.last, record.run_s,
            record.session_s)
        return found


def _with_rates(module: SimpleNamespace) -> Any:
    """A leg whose readings also have the joints' rates."""

    class WithRates(module.Leg):  # type: ignore[misc, name-defined]
        def observe(self) -> dict[str, float]:
            row: dict[str, float] = super().observe()
            rates = {f"q{j}d": float(self.data.qvel[joint.dofadr[0]]) for j, joint in enumerate(self.joints, 1)}
            return row | rates

    return WithRates()


def rows_of(found: Mapping[str, FloatArray], channels: Sequence[str]) -> FloatArray:
    """(C, K) the readings in the order of `channels`."""
    return np.stack([found[channel] for channel in channels])
