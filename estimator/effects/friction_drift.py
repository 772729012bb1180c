"""`FrictionDrift`: a Coulomb level that changes over the session."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, TorqueEffect, View


class FrictionDrift(TorqueEffect):
    """(C (1 - exp(-t / tau)) + D t_run) sign(v): the Coulomb level changes over the session and within each run."""

    name = "friction_drift"
    sizes = (Size("change", "N m", 0.005, tolerance=0.005),
             Size("change_per_minute_within_runs", "N m", 0.01, tolerance=0.005))
    shapes = (Shape("time_constant", "s", (30.0, 100.0, 300.0)),)
    sentence = "the friction level drifts with time (warming up, running in)"
    reference = "Simoni, Beschi, Legnani, Visioli 2015"
    tolerance_source = "grease that warms up within minutes"
    experiment = "the same run repeated cold and warm, temperature recorded"
    depends_on = "session"
    plans = ()
    by_hand = "record the session twice, cold and warm, with the temperature"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        level = -size[0] * np.expm1(-at.session_s / size[2]) + size[1] * at.time_s / 60.0
        return level * at.sign[self.joint or 0]
