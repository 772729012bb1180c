"""The IMU of a rig: where it sits, how noisy it is and how late its readings are; [imu] of rig.toml."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from daq.rig_types import Joint, Length, Positive, Table

ARRIVAL = 0.75, 0.25
"""Age of a reading that is stamped when it arrives, and its standard deviation, in conversion periods: half a period
where the newest reading is asked for at any time, a whole one where each is delivered at the end of the next."""
OTHER_S = 3e-4
"""Standard deviation of what else delays a reading: messages on a bus, and clocks that were put together by them [s].
"""


class Age(NamedTuple):
    """Time from when a reading was true to its stamp."""

    mean_s: float
    std_s: float


class Imu(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One IMU, or one of several under [[imu]], whose columns are numbered in this order."""

    link: Joint = 1
    lever_arm_m: Length = 0.0
    """From the link's joint to the IMU along it."""
    gyro_radps: Positive | None = None
    """Its own noise levels, which go before those of [noise]."""
    accel_mps2: Positive | None = None
    odr_hz: Positive | None = None
    """Conversions a second."""
    cutoff_hz: Positive | None = None
    """-3 dB point of its own low pass."""
    stamped: Literal["sample", "arrival"] | None = None
    """What the times of its readings are: those of the conversions, or of their arrival at who reads them."""

    @property
    def age(self) -> Age | None:
        """Nominal age of its readings [s]; None where the rig file states nothing of it.

        A low pass of first order delays slow motion by 1 / (2 pi f), a Butterworth of second order by
        sqrt(2) / (2 pi f) (-d phase / d omega at omega = 0; Oppenheim and Schafer, Discrete-time signal processing,
        5.1). Data sheets seldom state the order: their mean is taken, and half their difference as standard deviation.
        """
        if self.cutoff_hz is None and self.stamped is None:
            return None
        first = 0.0 if self.cutoff_hz is None else 1.0 / (2.0 * math.pi * self.cutoff_hz)
        period = 1.0 / self.odr_hz if self.stamped == "arrival" and self.odr_hz is not None else 0.0
        return Age(0.5 * (1.0 + math.sqrt(2.0)) * first + ARRIVAL[0] * period,
                   math.hypot(0.5 * (math.sqrt(2.0) - 1.0) * first, ARRIVAL[1] * period, OTHER_S))

    @property
    def lack(self) -> tuple[str, str] | None:
        """Fault of its settings, and the remedy; None without one."""
        if self.stamped == "arrival" and self.odr_hz is None:
            return 'imu.stamped is "arrival" without odr_hz: how old a reading is by then follows from it', (
                "give odr_hz, the conversions a second")
        return None
