"""`Loop`: the law by which a position loop makes a joint's input of command, angle and rate."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Value = float | FloatArray
"""One number, or an array with one for each instant."""


@dataclass(frozen=True)
class Loop:
    """The position loop of one driven joint, or what it is at each instant of several runs.

        w = clip(gain (c - q) + damping (feedforward c' - r) + integral Int (c - q) dt, +-limit)
        u = clip(per_volt supply w - braking q', +-most)

    Command c and its rate are those of `delay_s` before, behind a low pass of first order with the time constant
    `command_filter_s`. r is q' behind one with `velocity_filter_s`. All is held for `period_s`, so that on average it
    acts half a period late. A drive that makes torque has per_volt = supply = 1. A motor on voltage has w for duty,
    per_volt = k / R and braking = k^2 / R, with torque constant k and resistance R.
    """

    gain: Value
    """[N m/rad], of duty [1/rad]"""
    damping: Value = 0.0
    """[N m s/rad], of duty [s/rad]"""
    integral: Value = 0.0
    """[N m/(rad s)], of duty [1/(rad s)]"""
    feedforward: Value = 0.0
    """Share of the commanded rate in what the damping acts on"""
    limit: Value = np.inf
    """Of w [N m], of duty"""
    delay_s: Value = 0.0
    period_s: Value = 0.0
    supply: Value = 1.0
    """[V]; NaN where a column of the run has it"""
    per_volt: Value = 1.0
    """[N m/V]"""
    braking: Value = 0.0
    """[N m s/rad]"""
    velocity_filter_s: Value = 0.0
    command_filter_s: Value = 0.0
    most: Value = np.inf
    """Torque at the drive's largest current [N m]"""

    def wanted(self, error: Value, rate_error: Value, integral: Value = 0.0) -> FloatArray:
        """w by the error c - q [rad], the error of the rate [rad/s] and the integral of the error [rad s]."""
        wanted = self.gain * error + self.damping * rate_error
        if self._uses["integral"]:
            wanted = wanted + self.integral * integral
        return np.asarray(np.minimum(np.maximum(wanted, -self.limit), self.limit) if self._uses["limit"] else wanted)

    def acting(self, wanted: Value, rate: Value, supply: Value) -> FloatArray:
        """u [N m] by w, the joint's rate [rad/s] and the supply [V]."""
        free = supply * wanted
        if self._uses["per_volt"]:
            free = self.per_volt * free
        if self._uses["braking"]:
            free = free - self.braking * rate
        return np.asarray(np.minimum(np.maximum(free, -self.most), self.most) if self._uses["most"] else free)

    @cached_property
    def _uses(self) -> dict[str, bool]:
        """Whether each value differs from the one that does nothing, at any instant: simulations ask a loop often."""
        idle = {"integral": 0.0, "limit": np.inf, "per_volt": 1.0, "braking": 0.0, "most": np.inf}
        values = {name: np.asarray(getattr(self, name)) for name in idle}  # NaN at joints without a loop
        return {name: bool(np.any((x != idle[name]) & ~np.isnan(x))) for name, x in values.items()}

    def at(self, index: Any) -> Self:
        """The loop at some of its instants, where it has arrays."""
        found = replace(self, **{f.name: v[index] for f in fields(self)
                                 if isinstance(v := getattr(self, f.name), np.ndarray)})
        vars(found)["_uses"] = self._uses  # what does nothing at all instants does nothing at some
        return found

    @classmethod
    def along(cls, loops: list[list[Self | None]], lengths: list[int]) -> Self:
        """The loops of segments (S) and joints (n) as arrays (n, N); NaN where a joint has none."""
        def values(name: str) -> FloatArray:
            rows = [[np.nan if loop is None else getattr(loop, name) for loop in own] for own in loops]
            return np.repeat(np.array(rows, dtype=np.float64), lengths, axis=0).T

        return cls(**{f.name: values(f.name) for f in fields(cls)})
