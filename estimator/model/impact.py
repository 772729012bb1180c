"""`land`: the impact map of a walker of equal legs, from beta alone.

A foot lands without slip or rebound and the other one leaves the ground in the same instant (Grizzle, Abba and Plestan
2001, section II-C). The impulse acts at the landing foot, so three angular momenta pass over unchanged: of the whole
walker about that foot, and of the leg that stood and of the torso about the hip, to which no impulse but the hip's own
reaches. All three are beta's: D theta' holds, row by row, what a body and all that it carries have about its joint, and
of the leg that stood, its inertia less what its foot's fixture took, p_22 - p_12. So no mass is needed, and nothing of
the extended inertia matrix of that paper, to which tests hold it.
"""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.model.mechanism import Mechanism

STANCE, SWING, TORSO = range(3)
"""Links of a `biped3`."""


def land(mechanism: Mechanism, beta: FloatArray, q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles and rates (3,) just after the swing foot of a `biped3` has landed at q, qd (3,) [rad, rad/s].

    Joints are by role before and after: legs have changed places. Raises numpy.linalg.LinAlgError for a beta (8,) that
    is no walker's.
    """
    turn = np.asarray(np.linalg.inv(mechanism.transform), dtype=np.float64)
    angle, rate = mechanism.from_zero(mechanism.transform @ q), mechanism.transform @ qd
    momentum = _in_links(mechanism, turn, beta, q) @ rate
    up, along = np.stack([np.cos(angle), np.sin(angle)])
    moments = _moments(mechanism, beta)
    push_along, push_up = np.sum(moments * rate * up), -np.sum(moments * rate * along)
    length = leg_length(mechanism, beta)
    foot_along, foot_up = (length * (x[STANCE] + x[SWING]) for x in (along, up))
    leg = (_inertia(mechanism, beta, SWING, SWING) - _inertia(mechanism, beta, STANCE, SWING)) * rate[STANCE]
    whole = momentum.sum() - (foot_up * push_along - foot_along * push_up)
    after = np.array([whole - leg - momentum[TORSO], leg, momentum[TORSO]])
    swapped = angle[[SWING, STANCE, TORSO]] + np.array([-np.pi, np.pi, 0.0])
    new_q: FloatArray = turn @ (swapped - mechanism.from_zero(np.zeros(3)))
    return new_q, turn @ np.asarray(np.linalg.solve(_in_links(mechanism, turn, beta, new_q), after), dtype=np.float64)


def leg_length(mechanism: Mechanism, beta: FloatArray) -> float:
    """Leg length [m]: least squares of p_12 and p_13 over the first moments of swing leg and torso."""
    moments = _moments(mechanism, beta)[[SWING, TORSO]]
    inertias = np.array([_inertia(mechanism, beta, STANCE, k) for k in (SWING, TORSO)])
    return float(moments @ inertias / (moments @ moments))


def _in_links(mechanism: Mechanism, turn: FloatArray, beta: FloatArray, q: FloatArray) -> FloatArray:
    """Inertia matrix by absolute angles."""
    return np.asarray(turn.T @ mechanism.inertia_matrix(q, beta) @ turn, dtype=np.float64)


def _inertia(mechanism: Mechanism, beta: FloatArray, i: int, j: int) -> float:
    return float(sum(b for b, p in zip(beta, mechanism.parameters) if (p.term, p.at) == ("inertia", (i, j))))


def _moments(mechanism: Mechanism, beta: FloatArray) -> FloatArray:
    """(3,) first moments of the links, g taken out [kg m]."""
    out = np.zeros(3)
    for value, p in zip(beta, mechanism.parameters):
        if p.term == "gravity":
            out[p.at[0]] += value / mechanism.gravity_mps2
    return out
