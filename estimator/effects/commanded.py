"""`Commanded`: what the position loops of all joints are told at a set of instants, and the input that they make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from daq import BoolArray, FloatArray, IndexArray, Loop
from estimator.signals import monotone


@dataclass(frozen=True)
class Told:
    """Commands of all joints at all samples of the record."""

    angle: FloatArray
    """(n, N) [rad]"""
    rate: FloatArray
    """(n, N) [rad/s]"""
    first: IndexArray
    """(N,) first sample of each sample's segment"""
    dt_s: float

    def at(self, place: FloatArray, late_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Commanded angle and rate (n, ...) at the places (...) in samples, each joint `late_s` (n, ...) before, as
        `monotone` has them between samples; the first of a segment before it."""
        whole = np.minimum(np.floor(place + 1e-9).astype(np.intp), len(self.first) - 1)
        begin = self.first[whole].astype(np.float64)
        at = np.clip(place - np.nan_to_num(late_s) / self.dt_s, begin, whole + 1.0)
        k = np.minimum(np.floor(at).astype(np.intp), np.broadcast_to(whole, at.shape))
        share = np.clip(at - k, 0.0, 1.0)
        joints = np.arange(len(self.angle)).reshape(-1, *(1,) * (place.ndim))
        after = np.minimum(k + 1, len(self.first) - 1)
        after = np.where(self.first[after] == self.first[k], after, k)  # not into the next segment
        left = 1.0 - share
        from_, to = left**2 * (1.0 + 2.0 * share), share**2 * (1.0 + 2.0 * left)
        rise, fall = left**2 * share, share**2 * left
        angle, rate = (from_ * x[joints, k] + to * x[joints, after] + rise * d[joints, k] - fall * d[joints, after]
                       for x, d in zip((self.angle, self.rate), self._slopes))
        return angle, rate

    @cached_property
    def _slopes(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives of angle and rate (n, N) by the sample."""
        ends = np.flatnonzero(np.diff(self.first)) + 1
        found = [np.concatenate([_slopes_of(part) for part in np.split(x, ends, axis=1)], axis=1)
                 for x in (self.angle, self.rate)]
        return found[0], found[1]


def _slopes_of(x: FloatArray) -> FloatArray:
    """Derivatives (n, N) of one segment's commands by the sample."""
    at = np.arange(x.shape[1], dtype=np.float64)
    return np.zeros_like(x) if len(at) < 2 else np.array([monotone(row).derivative()(at) for row in x])


@dataclass(frozen=True)
class Commanded:
    """Arrays (n, ...), NaN at a joint without a loop."""

    loop: Loop
    supply: FloatArray
    """[V]"""
    summed: FloatArray
    """Integral of command less angle as recorded [rad s]"""
    place: FloatArray
    """(...) in samples of the record"""
    told: Told
    heard: tuple[FloatArray, FloatArray]
    """Commanded angle and rate (n, ...) as the loops have them, late as stated"""
    closed: bool = False
    """Whether the loops act on the motion; else their input is that of the recorded angle"""

    @classmethod
    def of(cls, loop: Loop, supply: FloatArray, summed: FloatArray, place: FloatArray, told: Told) -> Self:
        """The commands with what the loops hear."""
        late = 0.5 * np.asarray(loop.period_s) + loop.delay_s
        return cls(loop, supply, summed, place, told, told.at(place, late))

    @cached_property
    def follows(self) -> BoolArray:
        """(n,) joints that have a loop."""
        gain = np.asarray(self.loop.gain)
        return np.asarray(np.isfinite(gain).reshape(len(gain), -1).any(axis=1))

    def cut(self, index: Any) -> Self:
        """The instants `index`, as an index of arrays (n, ...)."""
        angle, rate = self.heard
        return replace(self, loop=self.loop.at(index), supply=self.supply[index], summed=self.summed[index],
                       place=self.place[index], heard=(angle[index], rate[index]))

    def of_joint(self, joint: int) -> Self:
        """The commands of one joint, arrays (1, ...)."""
        if joint not in self._joints:
            self._joints[joint] = self._of_joint(joint)
        return self._joints[joint]

    @cached_property
    def _joints(self) -> dict[int, Self]:
        return {}

    def _of_joint(self, joint: int) -> Self:
        own, (angle, rate) = slice(joint, joint + 1), self.heard
        told = replace(self.told, angle=self.told.angle[own], rate=self.told.rate[own])
        return replace(self, loop=self.loop.at(own), supply=self.supply[own], summed=self.summed[own], told=told,
                       heard=(angle[own], rate[own]))

    def error(self, q: FloatArray, v: FloatArray, a: FloatArray, late_s: float = 0.0
              ) -> tuple[FloatArray, FloatArray]:
        """(n, ...) errors of angle and rate that the loops see at a motion (n, ...), their commands `late_s` later than
        stated.

        A loop that holds for a period T sees the motion T / 2 before, q - v T/2 + a T^2/8, to which order its torque is
        that of the ticks on average. A low pass of the rate with the time constant F adds F to its T / 2.
        """
        held, squared, rate_late = self._lags
        angle, rate = self._heard(late_s) if late_s else self.heard
        told = self.loop.feedforward * rate if self._feeds else 0.0
        return angle - (q - held * v + squared * a), told - (v - rate_late * a)

    @cached_property
    def _lags(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n, ...) by which the motion that the loops see is late [s], half its square, and by which its rate is."""
        held = 0.5 * np.asarray(self.loop.period_s)
        return held, 0.5 * held**2, held + self.loop.velocity_filter_s

    @cached_property
    def _feeds(self) -> bool:
        return bool(np.nan_to_num(np.asarray(self.loop.feedforward)).any())

    def _heard(self, late_s: float) -> tuple[FloatArray, FloatArray]:
        """`heard` with commands that are later than stated; the last one is kept."""
        if late_s not in self._later:
            self._later.clear()
            self._later[late_s] = self.told.at(self.place, self._lags[0] + self.loop.delay_s + late_s)
        return self._later[late_s]

    @cached_property
    def _later(self) -> dict[float, tuple[FloatArray, FloatArray]]:
        return {}

    def input(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """(n, ...) input [N m] that the loops make at a motion (n, ...); zero at a joint without one."""
        found = self.loop.acting(self.loop.wanted(*self.error(q, v, a), self.summed), v, self.supply)
        return np.where(np.isnan(found), 0.0, found)
