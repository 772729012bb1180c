"""Grid, times and low pass of a rig's records: [sampling], [timing] and [filter] of rig.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from daq.rig_types import Positive, Table


class Sampling(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    rate_hz: Positive | None = None
    """Of the grid; None: each record's own."""
    hold: Literal["auto", "zero", "past", "linear", "average", "smooth"] = "auto"
    """How the measured torque acts between samples; auto: as the motion makes likeliest."""
    as_read: bool = False
    """No reading is altered or left out; what is wrong with them is told all the same."""

    @property
    def planned_hz(self) -> float:
        """Rate that a plan counts on before there is a record."""
        return 100.0 if self.rate_hz is None else self.rate_hz


class Timing(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Times between a stamp and what it stamps, as far as they are known."""

    torque_delay_s: tuple[float, float] | None = None
    """How long after its stamp, beyond its hold, a torque acts, and the standard deviation of that."""
    control_period_s: Positive | None = None
    """From one tick of the controller to the next: its torque is held between ticks, of which a log may keep some."""


class Filter(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Zero-phase Butterworth low pass of `wls` and of every starting value."""

    cutoff_hz: Positive | None = None
    """-6 dB point of the forward-backward filter; absent: a tenth of the rate, at most 10 Hz."""
    order: Annotated[int, Meta(ge=1, le=8)] = 4
