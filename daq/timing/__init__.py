"""One clock out of several: fitted from pings, ticks and sample counts; alignment to a uniform grid."""

from daq.timing.align import align, configured, recorded_rig
from daq.timing.clock import fit_samples, fit_ticks
from daq.timing.resample import HOLE_PERIODS, align_table
from daq.timing.skew import measure_skew

__all__ = [
    "HOLE_PERIODS", "align", "align_table", "configured", "fit_samples", "fit_ticks", "measure_skew", "recorded_rig"
]
