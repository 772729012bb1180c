"""One clock out of several: fitted from pings, ticks and sample counts; alignment to a uniform grid."""

from daq.timing.align import Decoded, align, configured, decode, recorded_rig
from daq.timing.clock import fit_samples, fit_ticks
from daq.timing.resample import HOLE_PERIODS, Channel, align_channels, align_table
from daq.timing.skew import measure_skew

__all__ = [
    "HOLE_PERIODS", "Channel", "Decoded", "align", "align_channels", "align_table", "configured", "decode",
    "fit_samples", "fit_ticks", "measure_skew", "recorded_rig"
]
