"""`first_plan`: a torque plan for a rig of which no model is known."""

from __future__ import annotations

from daq import InputError, Rig
from daq.recording import Plan
from experiments.excite.multisine import random_multisine
from experiments.excite.staircase import staircase

FIRST_SHARE = 0.1
"""Peak of a first plan, as a share of the torque limit."""
FIRST_LOW_HZ = 0.1


def first_plan(rig: Rig, seed: int, seconds: float, peak_nm: float | None = None, low_hz: float | None = None,
               high_hz: float = 3.0, holds: int | None = None) -> Plan:
    """A plan for a rig of which no model is known: gentle, a tenth of its torque limit where `peak_nm` is not given.

    Equal sines with random phases, or a staircase of so many `holds`. What the motion will be is unknown. Raises
    `InputError` beyond the limit, and where no frequency fits.
    """
    limit = rig.limits.torque_nm
    peak = FIRST_SHARE * limit if peak_nm is None else peak_nm
    if peak > limit:
        raise InputError("--peak", f"{peak:g} N m is beyond the rig's limit of {limit:g} N m", "lower it")
    if holds is not None:
        return staircase(peak, holds)
    try:
        return random_multisine(seed, seconds, peak, low_hz=FIRST_LOW_HZ if low_hz is None else low_hz,
                                high_hz=high_hz)
    except ValueError as error:
        raise InputError("--seconds", str(error), "give more seconds or a wider band") from None
