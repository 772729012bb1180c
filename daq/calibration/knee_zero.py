"""The knee encoder's reading with a straight knee: from a leg held straight, or hanging free at rest.

Hanging free with the motor off, the knee carries `beta5 g sin(q1 + q2)`, which its friction holds: the shank stops
anywhere in a cone about the vertical. With the IMU's angle of link 1 every stop k gives

    reading_k + q1_k = zero + phi_k,    sin |phi_k| <= F / (beta5 g).

Noise can be averaged away, the cone cannot: a longer record does not help, other stops do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.errors import WorkError
from daq.runs import Mean, mean_interval

FEWEST_STOPS = 4
"""Without a known friction."""
WIDEST_RAD = 0.1
"""Half interval beyond which a zero says nothing."""


@dataclass(frozen=True)
class Stop:
    """One record at rest."""

    name: str
    knee: Mean
    """Encoder's reading, zero not taken off [rad]."""
    q1: Mean | None = None
    """Angle of link 1 by gravity [rad]; None where the leg is held straight."""

    @property
    def value(self) -> float:
        """Knee's zero, were there no friction [rad]."""
        return self.knee.value + (self.q1.value if self.q1 else 0.0)

    @property
    def half(self) -> float:
        """Half of its 95 % interval, by noise [rad]."""
        return float(np.hypot(self.knee.half, self.q1.half if self.q1 else 0.0))


@dataclass(frozen=True)
class KneeZero:
    """The encoder's reading at a straight knee."""

    value: float
    half: float
    """Half of the 95 % interval, friction included where `cone` is known or learned [rad]."""
    noise_half: float
    """The share of noise in it [rad]."""
    how: str
    """What the interval rests on."""


def straight_zero(stops: Sequence[Stop], step_rad: float = 0.0) -> KneeZero:
    """Zero of a leg held straight: the mean reading. Three and more records show how well it can be held.

    `step_rad`: 95 % of the encoder's own error, which a reading that never changes does not show.
    """
    values = np.array([stop.value for stop in stops])
    noise = float(np.hypot(max(stop.half for stop in stops) / np.sqrt(values.size), step_rad))
    if values.size < 3:
        return KneeZero(float(values.mean()), noise, noise, "noise alone, without the error of the straight pose; "
                        "to include it give three or more records, each with the leg straightened anew")
    value, half = mean_interval(values)
    return KneeZero(value, float(np.hypot(half, step_rad)), noise, f"{values.size} records, the leg taken up anew")


def hanging_zero(stops: Sequence[Stop], cone_rad: float | None, step_rad: float = 0.0) -> KneeZero:
    """Zero from stops of a leg that hangs free; `cone_rad`: half angle of friction's cone, None: unknown.

    The zero is the middle of the stops. For n >= `FEWEST_STOPS` evenly spread stops of range R half of its 95 %
    interval is R (20^(1 / (n - 1)) - 1) / 2. With a known cone the zero lies within the cone about every stop. Raises
    `WorkError` when stops contradict the cone, are too few, or leave too wide an interval.
    """
    values = np.array([stop.value for stop in stops])
    noise = float(np.hypot(max(stop.half for stop in stops), step_rad))
    spread, count = float(np.ptp(values)), values.size
    halves: dict[str, float] = {}
    if cone_rad is not None:
        halves[f"{count} stops, each within the model's friction of +- {cone_rad:.3f} rad"] = cone_rad - 0.5 * spread
        if spread > 2.0 * (cone_rad + noise):
            raise WorkError(f"the knee stopped {spread:.3f} rad apart, the model's friction allows {2 * cone_rad:.3f} "
                            "rad: it sticks more than it slides, or the leg touched something; leave the model out and "
                            "give more stops, or hold the leg straight (--straight)")
    if count >= FEWEST_STOPS:
        halves[f"{count} stops spread over {spread:.4f} rad, taken as even about the zero"] = \
            0.5 * (20.0 ** (1.0 / (count - 1)) - 1.0) * spread
    if not halves:
        raise WorkError(f"{count} {'stop' if count == 1 else 'stops'} and no known friction: the knee rests anywhere "
                        f"in its friction's cone; give at least {FEWEST_STOPS} stops reached from either side, a model "
                        "(--model), or hold the leg straight (--straight)")
    how = min(halves, key=halves.__getitem__)
    value, half = 0.5 * float(values.min() + values.max()), max(halves[how], 0.0) + noise
    if half > WIDEST_RAD:
        raise WorkError(f"the knee's zero is {value:+.3f} +- {half:.2f} rad, too uncertain to use: friction holds the "
                        "shank; give more stops, or hold the leg straight (--straight)")
    return KneeZero(value, half, noise, how)


def friction_cone(coulomb_nm: float, moment_kgm: float, gravity_mps2: float) -> float:
    """Half angle [rad] within which friction holds a link of this first moment. Raises `WorkError` where it is all."""
    share = coulomb_nm / max(moment_kgm * gravity_mps2, 1e-12)
    if not 0.0 <= share < 1.0:
        raise WorkError(f"friction of {coulomb_nm:.3g} N m holds the shank, whose weight turns it by at most "
                        f"{moment_kgm * gravity_mps2:.3g} N m, at any angle; hold the leg straight (--straight)")
    return float(np.arcsin(share))
