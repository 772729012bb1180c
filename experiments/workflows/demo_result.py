"""`Demo`: what the demo hid, what it found and where it put it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from estimator import FitResult
from estimator.diagnosis import Diagnosis
from estimator.prediction import PredictionTable
from experiments.emulation import Hidden
from experiments.judge import Estimate, estimates_of, normal
from experiments.models import Model
from experiments.session import Prepared, Setup


@dataclass(frozen=True)
class Demo:
    """The hidden effect, the findings and the files of a demo."""

    hidden: Hidden
    setup: Setup
    result: FitResult
    """The nominal fit, on the runs that the diagnosis did not hold out."""
    diagnosis: Diagnosis
    model: Model
    """Extended, or nominal where the diagnosis extended nothing."""
    held: Prepared
    """The runs that the diagnosis held out."""
    before: PredictionTable
    after: PredictionTable
    """Free runs of the confirm runs by the nominal model, and by `model`."""
    truth: dict[str, float]
    files: dict[str, Path]
    """What -> path, in the order in which they were written."""
    wall_s: float

    def estimates(self) -> dict[str, Estimate]:
        """Parameter -> what `model` has for it."""
        if self.model.effects:
            return {n: normal(v, self.diagnosis.extended_std[n]) for n, v in self.diagnosis.extended.items()}
        return estimates_of(self.result)

    def inside(self) -> int:
        """Number of the plant's parameters inside their 95 % intervals."""
        return sum(one.holds(self.truth[name]) for name, one in self.estimates().items())
