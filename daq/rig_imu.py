"""The IMU of a rig: where it sits, how noisy it is and how late its readings are; [imu] of rig.toml."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import msgspec

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
    cutoff_hz: Positive | tuple[Positive, ...] | None = None
    """-3 dB point of its own low pass, or those of gyro and accelerometer."""
    stamped: Literal["sample", "arrival"] | None = None
    """What the times of its readings are: those of the conversions, or of their arrival at who reads them."""

    @property
    def ages(self) -> tuple[Age, Age] | None:
        """Nominal ages of gyro and accelerometer [s]; None where nothing is stated of them.

        A low pass of first order delays slow motion by 1 / (2 pi f), a Butterworth of second order by
        sqrt(2) / (2 pi f) (-d phase / d omega at omega = 0; Oppenheim and Schafer, Discrete-time signal processing,
        5.1). Data sheets seldom state the order: their mean is taken, and half their difference as standard deviation.
        """
        if self.cutoff_hz is None and self.stamped is None:
            return None
        both = self.cutoff_hz if isinstance(self.cutoff_hz, tuple) else (self.cutoff_hz, self.cutoff_hz)
        gyro, accel = (0.0 if cutoff is None else 1.0 / (2.0 * math.pi * cutoff) for cutoff in both)
        period = 1.0 / self.odr_hz if self.stamped == "arrival" and self.odr_hz is not None else 0.0
        return _age(gyro, period), _age(accel, period)

    @property
    def age_std_s(self) -> float:
        """Standard deviation of the less certain of both ages [s]; 0 where nothing is stated of them."""
        return max((age.std_s for age in self.ages or ()), default=0.0)

    def told_by(self, device: Imu | None) -> Imu:
        """Settings with what `device` says of the age, where these say nothing of it."""
        if device is None or self.ages is not None:
            return self
        return msgspec.structs.replace(self, odr_hz=device.odr_hz, cutoff_hz=device.cutoff_hz, stamped=device.stamped)

    @property
    def lack(self) -> tuple[str, str] | None:
        """Fault of its settings, and the remedy; None without one."""
        if self.stamped == "arrival" and self.odr_hz is None:
            return 'imu.stamped is "arrival" without odr_hz: how old a reading is by then follows from it', (
                "give odr_hz, the conversions a second")
        if isinstance(self.cutoff_hz, tuple) and len(self.cutoff_hz) != 2:
            return f"imu.cutoff_hz has {len(self.cutoff_hz)} numbers", (
                "give one for both sensors, or that of the gyro and that of the accelerometer")
        return None


def _age(filter_s: float, period_s: float) -> Age:
    """Age behind a low pass of this time constant, after the conversion's part of a period."""
    return Age(0.5 * (1.0 + math.sqrt(2.0)) * filter_s + ARRIVAL[0] * period_s,
               math.hypot(0.5 * (math.sqrt(2.0) - 1.0) * filter_s, ARRIVAL[1] * period_s, OTHER_S))
