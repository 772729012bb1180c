"""`require_scale`: motion without any torque tells parameters up to a common factor only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import Dataset
from estimator.errors import ScaleError
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import torque_column


def has_torque(datasets: Sequence[Dataset], mechanism: Mechanism) -> bool:
    """Whether any run shows another torque than zero."""
    columns = [torque_column(mechanism, j) for j in mechanism.actuated]
    return any(np.any(np.nan_to_num(data[c])) for data in datasets for c in columns if c in data)


def require_scale(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> None:
    """Raises `ScaleError` where no run has a torque and no parameter is given or known beforehand."""
    if not options.fixed and not options.prior and not has_torque(datasets, mechanism):
        term = "gravity" if mechanism.gravity_mps2 > 0.0 and mechanism.gravity else "inertia"
        known = [p for p in mechanism.parameters if p.term == term][-1]
        raise ScaleError("no run has a torque, so motion tells parameters up to a common factor only: give one, e.g. "
                         f"--fix {known.name}=VALUE ({known.meaning} [{known.unit}]); 1 gives ratios")
