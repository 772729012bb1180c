"""Unit and signs of the angles and torques of a chain of joints with encoders, by its equation of motion."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from msgspec import structs
from scipy.optimize import linear_sum_assignment

from daq import Column, Dataset, FloatArray
from estimator.calibration import TRIED
from estimator.model import Mechanism, chain
from experiments.exchange.guess_physics import (
    EXPLAINS,
    NOT_SURE,
    SIGNS,
    SMOOTHING_RADPS,
    Found,
    Sign,
    Way,
    close_call,
    inside,
    ranked,
    scale_warnings,
    share_left,
    smooth,
)

MOST_ROWS = 1500
"""Instants, evenly taken, at which the equation of motion is put up."""
POSES = 20
"""Instants at which the inertia matrix must be positive definite."""
HANGS_RAD = 0.1
"""A zero of joint 1 further from hanging than this is reported."""


@dataclass(frozen=True)
class _Reading(Way):
    """The angles in one unit, relative or absolute, with signs of angles and torques."""

    absolute: bool
    signs: tuple[Sign, ...]
    works: tuple[Sign, ...]
    q: FloatArray
    """(N, n) [rad]"""
    beta: FloatArray
    """(p,) by least squares"""

    def __str__(self) -> str:
        signs = [f"of {what} {' '.join(f'{s:+d}' for s in some)}"
                 for what, some in (("angles", self.signs), ("torques", self.works)) if some]
        return f"{self.unit or 'rad'}{', absolute' * self.absolute}, signs {', '.join(signs)}"


def of_joints(angles: Sequence[str], others: Sequence[str]) -> dict[int, str]:
    """Joint from 0 -> its torque or command, by the words and numbers that a name shares with that of an angle."""
    if not others:
        return {}
    shared = _shared(angles, others)
    order = -1e-3 * np.abs(np.subtract.outer(np.arange(len(others)), np.arange(len(angles))))
    rows, columns = linear_sum_assignment(-(shared + order))
    return {int(column): others[int(row)] for row, column in zip(rows, columns)}


def same_joint(angles: Sequence[str], torques: Sequence[str]) -> bool:
    """Whether two torque columns name one and the same joint: two readings of one torque."""
    shared = _shared(angles, torques)
    named = [int(np.argmax(row)) for row in shared if np.sum(row == row.max()) == 1 and row.max() > 0.0]
    return len(set(named)) < len(named)


def _shared(angles: Sequence[str], torques: Sequence[str]) -> FloatArray:
    """(torques, angles) words and numbers that two names share, and not all angles have."""
    words = [[set(re.findall(r"[a-z]+|\d+", name.lower())) for name in names] for names in (angles, torques)]
    common = set.intersection(*words[0]) if len(angles) > 1 else set()
    return np.array([[len((torque & angle) - common) for angle in words[0]] for torque in words[1]], dtype=float)


def find_chain(raw: Dataset, columns: Mapping[str, Column], gravity: float) -> Found:
    """Unit of the angles and signs of angles and torques of a chain of joints, each with an encoder.

    `columns` are q1_rad, q2_rad, ... and the torque of each driven joint; a chain without one swings freely, and the
    other terms must explain what the first inertia needs. The equation of motion of the open chain
    must leave little of the torques under the right unit and signs, with a positive definite inertia matrix. Absolute
    angles are tried, too. Columns that nothing explains are left as they stand in the file. Whether the chain is seen
    from its left or its right does not show: joint 1's angle keeps its sign.
    """
    n = sum(name.startswith("q") for name in columns)
    driven = [j for j in range(n) if f"tau{j + 1}_nm" in columns]
    mechanism = chain(n, gravity_mps2=gravity, velocity_scale=SMOOTHING_RADPS)

    ways = ranked(_readings(mechanism, raw, columns, driven), "")
    first = ways[0]
    z = regressor(mechanism, first.q, raw.rate_hz)[:, driven[-1] if driven else 0]
    if driven:
        read = first.works[-1] * smooth(raw[f"tau{driven[-1] + 1}_nm"], raw.rate_hz)
        made = z @ first.beta
    else:
        read, made = z[:, 0], z[:, 0] - z @ first.beta
    found = _found(ways, columns, (read, made))
    tilt = _hangs_at(mechanism, first.beta)
    if not found.unexplained and abs(tilt) > HANGS_RAD:
        found.warnings.append(f"joint 1 hangs at {tilt:.2f} rad, not at 0: set offset = {-tilt:.2f} under "
                              "[columns.q1_rad]")
    return found


def _found(ways: Sequence[_Reading], columns: Mapping[str, Column], check: tuple[FloatArray, FloatArray]) -> Found:
    """The map by the first of `ways`, with reasons and warnings."""
    first = ways[0]
    second = min((way for way in ways if way.left != first.left), key=lambda way: way.left, default=first)
    angles, torques = ([name for name in sorted(columns) if name.startswith(kind)] for kind in ("q", "tau"))
    what = "the torques" if torques else "the accelerations"
    warnings = [text for name in torques for text in scale_warnings(name, columns[name])]
    if not torques:
        warnings.append("no torque: the joints swing freely. Write actuated = [] under [mechanism], and give legid fit "
                        "one parameter with --fix: without a torque only ratios show")
    if first.left > EXPLAINS:
        named = ", ".join(repr(columns[name].name) for name in angles)
        why = (f"no unit and signs of {named} explain {what} (the best leave {100 * first.left:.0f} %): too "
               "little motion, a motor's angle before its gear, another order of the joints, or a mechanism that is no "
               "open chain")
        notes = {name: f"NOT KNOWN: no unit and signs explain {what}" for name in angles}
        notes |= {name: "NOT KNOWN: its sign does not show" for name in torques}
        return Found(dict(columns), notes, warnings, [why], check, left=first.left)
    close = close_call("unit and signs", what, first, second)
    warnings += close
    prefix = NOT_SURE * bool(close)
    found, notes = {}, {}
    for k, (column, sign) in enumerate(zip(angles, first.signs)):
        angle, less = columns[column], columns[angles[k - 1]].name if first.absolute and k else ""
        unit = angle.unit or first.unit
        found[column] = structs.replace(angle, unit=unit, minus=less, sign=sign)
        notes[column] = (f"{prefix}in {unit or 'rad'}, sign {sign:+d}, {less and f'less {less!r}, '}the equation of "
                         f"motion leaves {100 * first.left:.1f} % of {what} (next best: {100 * second.left:.0f} %)")
    for column, sign in zip(torques, first.works):
        found[column] = structs.replace(columns[column], sign=sign)
        notes[column] = f"{prefix}with sign {sign:+d} the inertia matrix is positive definite"
    return Found(found, notes, warnings, [], check, left=first.left)


def _readings(mechanism: Mechanism, raw: Dataset, columns: Mapping[str, Column], driven: Sequence[int]
              ) -> Iterator[_Reading]:
    """Every unit and sign with what it leaves; an angle whose name states a unit keeps it."""
    n = mechanism.n
    names = [f"q{k + 1}_rad" for k in range(n)]
    angles = np.stack([smooth(raw[name], raw.rate_hz) for name in names], axis=-1)
    torque = np.zeros((len(raw), n))
    for j in driven:
        torque[:, j] = smooth(raw[f"tau{j + 1}_nm"], raw.rate_hz)
    use = inside(raw, [*names, *(f"tau{j + 1}_nm" for j in driven)])
    rows = np.flatnonzero(use)[:: max(1, int(use.sum()) // MOST_ROWS)]
    stated = [bool(columns[name].unit) for name in names]
    variants = [(False, (*SIGNS[:1], *signs)) for signs in product(SIGNS, repeat=n - 1)] + [(True, SIGNS[:1] * n)]
    for (unit, scale), (absolute, signs) in product(TRIED["rad"].items(), variants):
        if all(stated) and unit:
            continue
        q = angles * np.where(stated, 1.0, scale) * np.array(signs)
        if absolute:
            q = np.diff(q, axis=-1, prepend=0.0)
        z = regressor(mechanism, q, raw.rate_hz)[rows]
        for works, left, beta in _fits(z, torque[rows], driven):
            inertia = mechanism.inertia_matrix(q[rows[:: max(1, rows.size // POSES)]], beta[: mechanism.p])
            possible = np.linalg.eigvalsh(inertia).min() > 0.0
            yield _Reading(left if possible else max(left, 1.0), unit, absolute, signs, works, q, beta)


def _fits(z: FloatArray, torque: FloatArray, driven: Sequence[int]
          ) -> Iterator[tuple[tuple[Sign, ...], float, FloatArray]]:
    """Signs of the torques (m, n), what least squares of the equation of motion leaves of them, and its parameters.

    The normal equations are put up once: the signs enter their right-hand side alone. Without a motor Z beta = 0 is
    solved in units of the first inertia.
    """
    flat = z.reshape(-1, z.shape[-1])
    if not driven:
        rest = np.linalg.lstsq(flat[:, 1:], -flat[:, 0], rcond=None)[0]
        yield (), share_left(-flat[:, 0], flat[:, 1:] @ rest), np.append(1.0, rest)
        return
    inverse = np.linalg.pinv(flat.T @ flat, hermitian=True)
    parts = np.einsum("njk,nj->jk", z, torque)
    power = float(np.sum(torque**2))
    spread = max(float(np.sum(np.var(torque, axis=0))) * len(torque), 1e-30)
    for works in product(SIGNS, repeat=len(driven)):
        right = np.array(works, dtype=float) @ parts[list(driven)]
        beta = inverse @ right
        yield works, float(np.sqrt(max(power - right @ beta, 0.0) / spread)), beta


def regressor(mechanism: Mechanism, q: FloatArray, rate_hz: float) -> FloatArray:
    """(N, n, p + links) of tau = Z beta + Z_g beta_g: the mechanism, then gravity with joint 1 a quarter turn ahead."""
    v = np.gradient(q, 1.0 / rate_hz, axis=0)
    z = mechanism.regressor(q, v, np.gradient(v, 1.0 / rate_hz, axis=0))
    ahead, still = q.copy(), np.zeros_like(q)
    ahead[:, 0] += 0.5 * np.pi
    return np.concatenate([z, mechanism.regressor(ahead, still, still)[..., _gravity(mechanism)]], axis=-1)


def _hangs_at(mechanism: Mechanism, beta: FloatArray) -> float:
    """Joint 1's angle when the chain hangs [rad], by the first moment that is largest."""
    along, ahead = beta[_gravity(mechanism)], beta[mechanism.p :]
    heavy = int(np.argmax(np.hypot(along, ahead)))
    return -float(np.arctan2(ahead[heavy], along[heavy]))


def _gravity(mechanism: Mechanism) -> list[int]:
    return [k for k, p in enumerate(mechanism.parameters) if p.term == "gravity"]
