"""Dry friction with a smoothed sign, F v / sqrt(v^2 + s^2), as MuJoCo's `frictionloss`.

A `frictionloss` acts as -clip(D (a + b v), -loss, loss) at its joint: an inertia D and a damping D b while it is within
its loss (MuJoCo, "Computation", constraint solver). D follows from `solimp` d, D = d / ((1 - d) A), A the joint's
inverse inertia, and b from the second number of a negative `solreffriction`, -b d.

- A sum of such clips, each with a share of F and a width in units of s, approximates the smoothed sign. `ONE` is best
  with one, `TWO` with two: largest errors 0.17 F and 0.08 F, least squares weighted by speed.
- D is small, so that it adds no inertia: `SHARE` of the joint's own. Only where the friction is so stiff that a step
  of `STEP_S` would not be stable, D makes up for it: then it is the implicit Euler step of the damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from experiments.simulators.parts import JointParts

STEP_S = 1e-3
"""Longest step for which the friction is stable."""
SHARE = 0.005
BROAD_RADPS = 0.02
"""Smoothing velocities above this take two clips. (Measured: one clip is 1.3 mrad off in 5 s at 0.1 rad/s.)"""
ONE: tuple[tuple[float, float], ...] = ((1.0, 1.4659),)
TWO: tuple[tuple[float, float], ...] = ((0.7, 0.9707), (0.3, 3.5914))
"""(share of F, width over s)"""


class Clip(NamedTuple):
    """One `frictionloss`."""

    share: float
    """Of the joint's dry friction."""
    impedance: float
    """d"""
    damping: float
    """b d by N m of the joint's dry friction: the softness moves with the level."""


def clips_of(joint: JointParts, inverse_inertia: float) -> list[Clip]:
    """The clips of a joint's friction, whatever its level. Empty where it has none."""
    level = joint.coulomb + joint.further_level
    if level <= 0.0:
        return []
    shares = TWO if joint.smoothing > BROAD_RADPS else ONE
    inverse_inertia = float(inverse_inertia)
    own = 1.0 / inverse_inertia
    slopes = [share / (width * joint.smoothing) for share, width in shares]
    lacking = max(0.0, 0.5 * STEP_S - own / (level * sum(slopes)))
    clips = []
    for (share, _), slope in zip(shares, slopes):
        added = max(SHARE * own * share, level * slope * lacking)
        d = added * inverse_inertia / (1.0 + added * inverse_inertia)
        clips.append(Clip(share, d, slope / added * d))
    return clips


def solver_numbers(clip: Clip, level: float) -> tuple[str, str]:
    """`solref` and `solimp` of a clip at a level of dry friction [N m]."""
    return f"-1 {-clip.damping * level!r}", numbers([clip.impedance, clip.impedance, 0.001, 0.5, 2.0])


def numbers(values: Sequence[float]) -> str:
    """Numbers of an attribute, to the last bit."""
    return " ".join(f"{value:g}" if value == float(f"{value:g}") else repr(float(value)) for value in values)
