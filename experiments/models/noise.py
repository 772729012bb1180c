"""`noise_level`: a model's noise level of a column of a run."""

from __future__ import annotations

from collections.abc import Mapping

CHANNELS = {"gyro": ("gyro_radps",), "accel_x": ("accel_x_mps2", "accel_mps2"),
            "accel_y": ("accel_y_mps2", "accel_mps2"), "tau": ("torque_nm",),
            "voltage": ("torque_nm",), "q": ("encoder_rad",)}
"""How a column's name begins, and the noise levels that may belong to it, the closest first."""


def noise_level(noise: Mapping[str, float], column: str) -> float:
    """Standard deviation of the column's white noise in its unit; 0 where the model states none."""
    keys = next((keys for begin, keys in CHANNELS.items() if column.startswith(begin)), ())
    return next((noise[key] for key in (column, *keys) if key in noise), 0.0)
