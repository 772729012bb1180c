"""`EncoderEccentricity`: an encoder disc off centre."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size
from estimator.effects.sensor_effects import EncoderEffect


class EncoderEccentricity(EncoderEffect):
    """reading = q + a sin q + b (cos q - 1): once a turn of the measured angle."""

    name = "encoder_eccentricity"
    sizes = (Size("sine_amplitude", "rad", 0.005, tolerance=0.002),
             Size("cosine_amplitude", "rad", 0.005, tolerance=0.002))
    sentence = "the encoder's disc is off centre: an error once a turn"
    in_log = "the logged angle has an error once a turn, and the loop hears the true angle"
    reference = "eccentricity of a graduated disc: first harmonic of the angle measured"
    tolerance_source = "a disc 0.05 mm off centre at a radius of 25 mm"
    experiment = "a full slow turn"
    plans = ("steady", "ramps")

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        return size[0] * np.sin(q) + size[1] * np.cos(q)
