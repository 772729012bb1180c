"""Unit and signs of a walker's angles and torques, by its equation of motion between touchdowns.

At a touchdown the rates jump. A filter smears that over a tenth of a second, so each step is filtered alone, without
its ends. The torso's noise, differentiated twice, is larger than the torques: the equation is averaged by windows that
vanish at their ends. What the row of the torso, which has no motor, still errs is taken out of the hips' rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from daq import Column, Dataset, FloatArray
from estimator import FitError
from estimator.model import Mechanism, biped3
from estimator.signals import Touchdowns, find_touchdowns, lowpass
from experiments.exchange.guess_chain import Reading, told
from experiments.exchange.guess_physics import ANGLE_UNITS, CLEAR, EXPLAINS, Found, filled

AROUND_S = 0.03
"""Samples nearer to a touchdown are left out."""
WINDOW_S = 0.4
"""Length of a window; of a shorter step all."""
SHORTEST = 12
"""Samples of a step that is used."""
HOPS = 8
"""Windows begin at so many places of one window's length."""
CUTOFF_HZ = 20.0
LEG_TURNS = 0.1, np.pi
"""How far a walking leg turns against the torso, at least and at most [rad]; other units are not tried."""
PASSES = 3
"""Of least squares, each weighted by the covariance of the last one's residuals."""
POSES = 20
"""Instants at which the inertia matrix must be positive definite."""


class _Steps(NamedTuple):
    """The equation of motion averaged by windows, in the joints torso, standing leg, swinging leg."""

    z: FloatArray
    """(m, 3, p)"""
    tau: FloatArray
    """(m, 3) [N m] as measured"""
    role: NDArray[np.intp]
    """(m, 3) the record's joint, from 0"""
    at: FloatArray
    """(m,) sample in the middle of a window"""
    poses: FloatArray
    """(m, 3) [rad]"""
    touchdowns: int
    """All that were found."""


@dataclass(frozen=True)
class _Walked(Reading):
    """A reading with its rows."""

    steps: _Steps


def find_walker(raw: Dataset, columns: Mapping[str, Column], gravity: float) -> tuple[Found, int]:
    """Unit and signs of a walker's columns, and the number of its touchdowns, zero where none stands out.

    `columns` are q1_rad of the torso, q2_rad and q3_rad of the legs, tau2_nm and tau3_nm. The angles of the legs may be
    absolute. The foremost leg carries the walker after a touchdown. That shows the direction of walking, and the map
    lets angles grow in it.
    """
    ranked = sorted(_readings(biped3(hips=True, gravity_mps2=gravity), raw, columns), key=lambda one: one.left)
    if not ranked:
        return Found(dict(columns), {}, [], ["no touchdown stands out"], (raw["q1_rad"],) * 2, left=np.inf), 0
    first, steps = ranked[0], ranked[0].steps
    third = steps.role == 2
    both = first.works[1] * steps.tau[third], (steps.z @ first.beta)[third]
    read, made = (np.interp(np.arange(len(raw)), steps.at, x) for x in both)
    return told(ranked, columns, (read, made), (0, 0, 0), "a torso whose zero is not upright"), steps.touchdowns


def _readings(mechanism: Mechanism, raw: Dataset, columns: Mapping[str, Column]) -> Iterator[_Walked]:
    """Every unit and sign under which touchdowns are found, with what it leaves."""
    names = [f"q{k + 1}_rad" for k in range(3)]
    angles = np.stack([filled(raw[name]) for name in names], axis=-1)
    torque = np.stack([np.zeros(len(raw)), filled(raw["tau2_nm"]), filled(raw["tau3_nm"])], axis=-1)
    stated = [bool(columns[name].unit) for name in names]
    variants = [(False, signs) for signs in product((1, -1), repeat=3)] + [(True, (s, -s, -s)) for s in (1, -1)]
    for (unit, scale), (absolute, signs) in product(ANGLE_UNITS.items(), variants):
        q = angles * np.where(stated, 1.0, scale)
        if absolute:
            q[:, 1:] -= q[:, :1]
        q *= signs
        turned = np.ptp(q[:, 1:], axis=0)
        if (all(stated) and unit) or turned.min() < LEG_TURNS[0] or turned.max() > LEG_TURNS[1]:
            continue
        try:
            steps = _steps(mechanism, q, torque, raw, find_touchdowns(replace(raw, columns=dict(zip(names, q.T)))))
        except FitError:
            continue
        for works in product((1, -1), repeat=2):
            left, beta = _left(mechanism, steps, steps.tau * np.array([1, *works])[steps.role])
            yield _Walked(left, unit, absolute, signs, works, q, beta, steps)


def _steps(mechanism: Mechanism, q: FloatArray, torque: FloatArray, raw: Dataset, landed: Touchdowns) -> _Steps:
    """All windows of all steps. Raises `FitError` where the steps are too short for any."""
    rate, time_s = raw.rate_hz, raw.time_s
    ends = [time_s[0] - AROUND_S, *landed.time_s, time_s[-1] + AROUND_S]
    parts = []
    for (start, end), leg in zip(pairwise(ends), [3 - landed.leg[0], *landed.leg]):
        where = np.flatnonzero((time_s >= start + AROUND_S) & (time_s <= end - AROUND_S))
        if where.size < SHORTEST:
            continue
        size = min(round(WINDOW_S * rate), where.size)
        hop = max(1, size // HOPS)
        window = np.sin(np.pi * (np.arange(size) + 0.5) / size) ** 4
        role = np.array([0, leg, 3 - leg])
        pose = lowpass(q[where][:, role], CUTOFF_HZ, rate)
        speed = np.gradient(pose, 1.0 / rate, axis=0)
        rows = mechanism.regressor(pose, speed, np.gradient(speed, 1.0 / rate, axis=0))
        z, tau = (sliding_window_view(x, size, axis=0)[::hop] @ (window / window.sum())
                  for x in (rows, torque[where][:, role]))
        middle = size // 2 + hop * np.arange(len(z))
        parts.append((z, tau, np.tile(role, (len(z), 1)), where[middle].astype(float), pose[middle]))
    if not parts:
        raise FitError(f"{raw.name}: steps are shorter than {SHORTEST} samples")
    z, tau, roles, at, poses = (np.concatenate(rows) for rows in zip(*parts))
    return _Steps(z, tau, roles, at, poses, landed.time_s.size)


def _left(mechanism: Mechanism, steps: _Steps, tau: FloatArray) -> tuple[float, FloatArray]:
    """Residual of the hips' torques less what the torso's explains of it, as a share of their standard deviation; beta.

    At least the whole torque where the inertia matrix is not positive definite.
    """
    root, beta = np.eye(3), np.zeros(mechanism.p)
    for _ in range(PASSES):
        beta = np.asarray(np.linalg.lstsq((root @ steps.z).reshape(-1, mechanism.p), (tau @ root.T).ravel())[0], float)
        error = tau - steps.z @ beta
        floor = 1e-9 * float(np.mean(tau**2)) * np.eye(3)
        root = np.linalg.inv(np.linalg.cholesky(error.T @ error / len(error) + floor))
    hips, torso = error[:, 1:], error[:, :1]
    hips = hips - torso @ np.linalg.lstsq(torso, hips, rcond=None)[0]
    left = float(np.sqrt(np.sum(hips**2) / max(float(np.sum(np.var(tau[:, 1:], axis=0))) * len(tau), 1e-30)))
    inertia = mechanism.inertia_matrix(steps.poses[:: max(1, len(tau) // POSES)], beta)
    return left if np.linalg.eigvalsh(inertia).min() > 0.0 else max(left, 1.0), beta


def walker_or_chain(walker: tuple[Found, int], chain: Found) -> Found:
    """The one that explains the torques, with the reason; the chain where both do and neither far better."""
    found, touchdowns = walker
    jumps = f"the rates of all joints jump {touchdowns} times, as at touchdowns"
    shares = (f"between them a walker's equation of motion leaves {100 * found.left:.0f} % of the torques, an open "
              f"chain's {100 * chain.left:.0f} % at all times")
    if found.left <= EXPLAINS and CLEAR * found.left < chain.left:
        why = f"a walker's torso: {jumps}; {shares}"
        direction = "signs let it walk towards growing angles; which leg is the left one does not show"
        notes = {name: f"{why if name == 'q1_rad' else direction}\n{text}" if name[0] == "q" else text
                 for name, text in found.notes.items()}
        return found._replace(notes=notes)
    if chain.unexplained:
        why = "".join(found.unexplained) or f"{jumps}; {shares}, which is too little for a walker"
        return chain._replace(unexplained=[*chain.unexplained, f"no walker either: {why}"])
    if found.left <= EXPLAINS:
        chain.warnings.append(f"taken for a chain, but it may be a walker: {jumps}; {shares}")
    return chain
