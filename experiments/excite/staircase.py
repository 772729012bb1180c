"""A torque plan that brings the leg to rest at several angles, each from either side."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from daq.recording import Plan

RATE_HZ = 100.0
RAMP, HOLD = 300, 200
"""Samples of a ramp and of a hold: 3 s and 2 s."""


def staircase(peak_nm: float, levels: int) -> Plan:
    """Up and down in `levels` steps to `peak_nm` [N m] on both sides of zero, a smooth ramp and a hold each.

    Slow ramps keep the joint from swinging past its rest, where friction would stop it at random.
    """
    up = np.linspace(0.0, peak_nm, levels + 1)
    side = np.concatenate([up, up[-2::-1]])
    targets = np.concatenate([side, -side[1:]])
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(RAMP) / RAMP)
    parts = [np.zeros(HOLD)]
    for before, after in pairwise(targets):
        parts += [before + (after - before) * ramp, np.full(HOLD, after)]
    torque = np.concatenate(parts)
    return Plan(np.arange(torque.size) / RATE_HZ, torque)
