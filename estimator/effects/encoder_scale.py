"""`EncoderScale`: a wrong scale of an encoder."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size
from estimator.effects.sensor_effects import EncoderEffect


class EncoderScale(EncoderEffect):
    """reading = (1 + s) q."""

    name = "encoder_scale"
    sizes = (Size("scale_error", "1", 0.01, tolerance=0.001),)
    sentence = "the encoder's scale is wrong (counts or gear ratio)"
    in_log = "the scale of the logged angle is wrong (its unit or conversion), and the loop hears the true angle"
    reference = "counts per turn"
    tolerance_source = "counts a turn are exact; linearity of magnetic encoders such as the AS5600 over part of a turn"
    experiment = "a full turn between two known stops"
    plans = ("ramps",)
    by_hand = "turn the joint by hand from one known stop to the other in one run"

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        return size[0] * q
