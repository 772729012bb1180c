"""`EncoderOffset`: a wrong zero of an encoder."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size
from estimator.effects.sensor_effects import EncoderEffect


class EncoderOffset(EncoderEffect):
    """reading = q + o."""

    name = "encoder_offset"
    sizes = (Size("offset", "rad", 0.005, tolerance=0.003),)
    sentence = "the encoder's zero is wrong"
    in_log = "the zero of the logged angle is wrong, and the loop hears the true angle"
    reference = "docs/formats.md: q2 = 0 is straight"
    tolerance_source = "a zero set by hand against a stop or a level"
    experiment = "rest hanging straight"
    plans = ("rest",)

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        return np.full_like(q, size[0])
