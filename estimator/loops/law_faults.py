"""`LAW_FAULTS`: what readings and loops do wrong that a loop's own law shows, each as a correction of what was read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.loops.law_run import LawRun

LATEST_S = 0.2
"""Longest delay that is looked for."""


@dataclass(frozen=True)
class LawFault:
    """One fault, by the name of its effect."""

    effect: str
    column: str
    """What of a run it changes; what is wrong with the loop is in its command."""
    law: Callable[[LawRun, FloatArray], Any]
    """(N,) that column without the fault of sizes (k,)"""
    starts: tuple[tuple[float, ...], ...]
    """Sizes from which they are sought"""
    low: float = -np.inf
    """Least that a size may be"""
    most: float = 1.0
    """Largest that one may be"""
    by_input: bool = False
    """Whether the size is one over the square of an input: these numbers are for inputs up to one"""
    of_law: bool = False
    """Whether it is a term of the law that nobody states, and no fault"""
    in_readings: bool = True
    """Whether a reading is wrong, not the loop"""

    def correct(self, run: LawRun, size: FloatArray) -> LawRun:
        """The run without the fault of these sizes."""
        return replace(run, **{self.column: self.law(run, size)})


def _shifted(x: FloatArray, late_s: float, run: LawRun) -> FloatArray:
    """x(t - late) (N,), linear between samples, the ends held."""
    at = np.arange(len(x), dtype=np.float64)
    return np.interp(at - late_s * run.rate_hz, at, x)


LAW_FAULTS = (
    LawFault("torque_delay", "input", lambda run, size: _shifted(run.input, -float(size[0]), run),
             ((0.005,), (0.03,), (0.1,), (-0.01,)), -LATEST_S, LATEST_S),
    LawFault("torque_saturation", "input", lambda run, size: run.input / np.sqrt(1.0 + 2.0 * size[0] * run.input**2),
             ((0.1,), (1.0,)), 0.0, 20.0, by_input=True),
    LawFault("encoder_scale", "angle", lambda run, size: run.angle / (1.0 + size[0]), ((0.02,), (-0.02,)), -0.5),
    LawFault("encoder_eccentricity", "angle",
             lambda run, size: run.angle - size[0] * np.sin(run.angle) - size[1] * np.cos(run.angle),
             ((0.02, 0.02), (-0.02, 0.02), (0.02, -0.02), (-0.02, -0.02)), -1.0),
    LawFault("command_delay", "command", lambda run, size: _shifted(run.command, float(size[0]), run),
             ((0.005,), (0.03,), (0.1,)), 0.0, LATEST_S),
    LawFault("command_dead_band", "command",
             lambda run, size: run.command - np.clip(run.error, -size[0], size[0]),
             ((0.005,), (0.02,)), 0.0, in_readings=False),
    LawFault("missing_integral", "command",
             lambda run, size: run.command + size[0] * np.cumsum(run.error) / run.rate_hz,
             ((0.1,), (1.0,)), 0.0, 20.0, in_readings=False),
    LawFault("damping", "command",
             lambda run, size: run.command - size[0] * np.gradient(run.angle, 1.0 / run.rate_hz),
             ((0.01,), (0.05,)), 0.0, of_law=True, in_readings=False),
    LawFault("damping of the error", "command",
             lambda run, size: run.command + size[0] * np.gradient(run.error, 1.0 / run.rate_hz),
             ((0.01,), (0.05,)), 0.0, of_law=True, in_readings=False))
"""Without an `encoder_offset`, which is a constant that every run has of its own."""
