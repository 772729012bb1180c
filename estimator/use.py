"""`Use`: what a model is good for, and how well."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Literal

ENOUGH = 0.1
"""Error up to which a use is supported, by convention: a fit of 90 %."""
Purpose = Literal["feedforward", "simulation", "parameters"]
Speed = Literal["rest", "slow", "fast"]


@dataclass(frozen=True)
class TorqueError:
    """Error of a model's torque at one joint, at one speed."""

    joint: int
    """From 1"""
    speed: Speed
    """Below a twentieth of the joint's rms rate, up to it, beyond"""
    rms: float
    unit: str
    """N m, N on a slide, V of a motor by its voltage"""
    ci95: tuple[float, float] | None
    """On one more run; None where there are too few to say"""


@dataclass(frozen=True)
class Use:
    """One use of a model, and whether the runs support it."""

    use: Purpose
    supported: bool
    """Whether the error is surely at most ENOUGH and nothing else speaks against it"""
    figure: float
    """Error as a share; of parameters, half of the interval of the leading one over its value"""
    unit: str = "1"
    horizon_s: float | None = None
    """Of a simulation"""
    ci95: tuple[float, float] | None = None
    """Of the error on one more run; None where there are too few to say"""
    measured_on: Literal["held_out", "fit"] = "held_out"
    by_speed: tuple[TorqueError, ...] = ()
    """Of a feedforward"""


def use_of_parameters(half: float, value: float, sound: bool) -> Use:
    """Use of the parameters by the leading one; `sound`: nothing speaks against them."""
    share = half / abs(value)
    return Use("parameters", sound and share <= ENOUGH, share, measured_on="fit")


def best_first(uses: Iterable[Use]) -> tuple[Use, ...]:
    """Those with a number, the supported ones first."""
    return tuple(sorted((one for one in uses if isfinite(one.figure)), key=lambda one: not one.supported))
