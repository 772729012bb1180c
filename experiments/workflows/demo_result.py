"""`Demo`: what the demo hid, what it found and where it put it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from estimator import FitResult
from estimator.diagnosis import Diagnosis
from estimator.fitting import Validation
from experiments.emulation import Hidden
from experiments.models import Model
from experiments.rig import Setup


@dataclass(frozen=True)
class Demo:
    """What the demo hid, what it found and where it put it."""

    hidden: Hidden
    setup: Setup
    result: FitResult
    """The nominal fit, on the runs that the diagnosis did not keep back."""
    diagnosis: Diagnosis
    model: Model
    """Extended, or nominal where the diagnosis extended nothing."""
    before: Sequence[Validation]
    after: Sequence[Validation]
    """Free runs of the confirm runs by the nominal model, and by `model`."""
    truth: dict[str, float]
    files: dict[str, Path]
    """What -> path, in the order in which they were written."""
    wall_s: float

    def estimates(self) -> dict[str, tuple[float, float]]:
        """Parameter -> (value, std) of `model`."""
        if self.model.effects:
            return {n: (v, self.diagnosis.extended_std[n]) for n, v in self.diagnosis.extended.items()}
        return dict(zip(self.result.mechanism.names, zip(map(float, self.result.beta), map(float, self.result.std))))

    def inside(self) -> int:
        """How many parameters of the plant lie inside their 95 % intervals."""
        return sum(abs(value - self.truth[name]) <= 1.96 * std for name, (value, std) in self.estimates().items())
