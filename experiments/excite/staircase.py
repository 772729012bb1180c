"""A torque plan that brings the leg to rest at several angles, each from either side."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from daq.recording import Plan

RAMP_S, HOLD_S = 3.0, 2.0
RATE_HZ = 100.0


def staircase(peak_nm: float, levels: int, ramp_s: float = RAMP_S, hold_s: float = HOLD_S) -> Plan:
    """Up and down in `levels` steps to `peak_nm` [N m] on both sides of zero, a smooth ramp and a hold each.

    Slow ramps keep the joint from swinging past its rest, where friction would stop it at random.
    """
    up = np.linspace(0.0, peak_nm, levels + 1)
    side = np.concatenate([up, up[-2::-1]])
    targets = np.concatenate([side, -side[1:]])
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(round(ramp_s * RATE_HZ)) / round(ramp_s * RATE_HZ))
    parts = [np.zeros(round(hold_s * RATE_HZ))]
    for before, after in pairwise(targets):
        parts += [before + (after - before) * ramp, np.full(round(hold_s * RATE_HZ), after)]
    torque = np.concatenate(parts)
    return Plan(np.arange(torque.size) / RATE_HZ, torque)
