"""Three plain ways to name a cause, on the same CSVs and with the same scorer as the diagnosis.

    python -m tests.evidence blind.baselines OUT

answers OUT/cases into OUT/baselines/{bic,stlsq,heldout}/NAME.json. All three are regressions on the torque that the
measured motion needs: zero-phase filtered signals, the nine parameters by least squares, and for every effect of
the contract the columns it adds to the two rows (pivot, knee). A torque effect's column is its law; a sensor's or
a clock's is the change of the rows when that reading is corrected by a little. None can say 'unexplained'.
"""

from __future__ import annotations

import argparse
import json
import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tests.evidence.blind.cases import RUNS
from tests.evidence.blind.leg import GRAVITY, Array
from tests.evidence.blind.measure import COLUMNS, RATE_HZ

METHODS = ("bic", "stlsq", "heldout")
CUTOFF_HZ = 8.0
EVERY = 5
HELD_OUT = 2
SIGN_RADPS = 0.02
MOVING_RADPS = 0.1
THRESHOLDS = (0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8, 1.1)
"""Of STLSQ, from pysindy's default up; columns are scaled so that a coefficient is a share of the residual."""
_LOW = butter(4, CUTOFF_HZ, fs=RATE_HZ, output="sos")


@dataclass(frozen=True)
class Record:
    """One run as recorded, (N,) each."""

    q2: Array
    tau: Array
    gyro: Array
    ax: Array
    ay: Array
    lever: float
    gear: float
    number: int


@dataclass(frozen=True)
class Motion:
    """Filtered motion (N,): angles, rates, accelerations of pivot and knee, and the torque."""

    q: tuple[Array, Array]
    v: tuple[Array, Array]
    a: tuple[Array, Array]
    tau: Array


Key = tuple[str, int | None, float]
"""Effect, joint, shape."""


def read_case(folder: Path) -> list[Record]:
    rig = tomllib.loads((folder / "rig.toml").read_text(encoding="utf-8"))
    records = []
    for k in range(RUNS):
        table = np.loadtxt(folder / f"r{k + 1}.csv", delimiter=",", skiprows=1)
        q2, tau, gyro, ax, ay = (table[:, COLUMNS.index(name)] for name in COLUMNS[1:])
        records.append(Record(q2, tau, gyro, ax, ay, rig["imu"]["lever_arm_m"], rig["motor"]["gear_ratio"], k))
    return records


def _low(x: Array) -> Array:
    return np.asarray(sosfiltfilt(_LOW, x, axis=-1))


def _slope(x: Array) -> Array:
    """Central differences of fourth order: those of second would err by a percent at 3 Hz, more than some effects."""
    out = np.gradient(x, 1.0 / RATE_HZ)
    out[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) * (RATE_HZ / 12.0)
    return np.asarray(out)


def move(record: Record) -> Motion:
    """Filtered motion; the pivot's angle is the gyro's integral, its start and drift taken from gravity's direction."""
    q2, w1 = _low(record.q2), _low(record.gyro)
    w2, a1 = _slope(q2), _slope(w1)
    seen = np.unwrap(np.arctan2(_low(record.ax) - record.lever * a1, -_low(record.ay) - record.lever * w1**2))
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (record.gyro[1:] + record.gyro[:-1]) / RATE_HZ)])
    time = np.arange(turned.size) / RATE_HZ
    q1 = _low(turned + np.polyval(np.polyfit(time, seen - turned, 1), time))
    return Motion((q1, q2), (w1, w2), (a1, _slope(w2)), _low(record.tau))


def _sign(v: Array) -> Array:
    return np.tanh(v / SIGN_RADPS)


def regressor(m: Motion) -> Array:
    """(2, 9, N) of the leg's equations: row pivot, row knee; columns as the contract's beta1 .. beta9."""
    (q1, q2), (w1, w2), (a1, a2) = m.q, m.v, m.a
    c, s, g = np.cos(q2), np.sin(q2), GRAVITY
    nil = np.zeros_like(q1)
    lower = g * np.sin(q1 + q2)
    return np.array([
        [a1, a1 + a2, c * (2 * a1 + a2) - s * (2 * w1 * w2 + w2**2), g * np.sin(q1), lower, w1, nil, _sign(w1), nil],
        [nil, a1 + a2, c * a1 + s * w1**2, nil, lower, nil, w2, nil, _sign(w2)]])


def need(record: Record, beta: Array) -> Array:
    """(2, N) torque that the record's motion needs beyond what its motor gave."""
    m = move(record)
    rows = np.einsum("rkn,k->rn", regressor(m), beta)
    rows[1] -= m.tau
    return rows


def _bristle(q: Array, width: float) -> Array:
    """Deflection of Dahl's bristle over its full one, (N,)."""
    step = np.diff(q, prepend=q[0])
    side, kept = np.sign(step), np.exp(-np.abs(step) / width)
    z = np.zeros_like(q)
    for i in range(1, q.size):
        z[i] = side[i] + (z[i - 1] - side[i]) * kept[i]
    return z


def torque_terms(record: Record, m: Motion, reach: Array) -> dict[Key, list[Array]]:
    """Laws of torque effects, each (2, N). `reach` (2,) is the largest angle of each joint over all runs."""
    out: dict[Key, list[Array]] = {}

    def add(effect: str, row: int, joint: int | None, *laws: Array, shape: float = 0.0) -> None:
        out[effect, joint, shape] = [np.stack([law if r == row else np.zeros_like(law) for r in (0, 1)])
                                     for law in laws]

    hours = record.number + np.arange(m.tau.size) / m.tau.size
    for j in (0, 1):
        q, v, s = m.q[j], m.v[j], _sign(m.v[j])
        for speed in (0.1, 0.2, 0.4):
            add("stribeck_friction", j, j + 1, np.exp(-(v / speed) ** 2) * s, shape=speed)
        add("asymmetric_friction", j, j + 1, np.maximum(s, 0.0))
        for width in (0.005, 0.02, 0.05):
            add("presliding_friction", j, j + 1, _bristle(q, width), shape=width)
        add("quadratic_drag", j, j + 1, v * np.abs(v))
        add("friction_drift", j, j + 1, hours * s)
        add("joint_stiffness", j, j + 1, q, np.ones_like(q))
        for side in (-1.0, 1.0):
            for share in (0.6, 0.8):
                add("end_stop_contact", j, j + 1, np.maximum(side * q - share * reach[j], 0.0), shape=side * share)
    angle = record.gear * m.q[1]
    for order in (1.0, 2.0, 3.0, 4.0, 6.0):
        add("torque_ripple", 1, 2, np.sin(order * angle), np.cos(order * angle), shape=order)
    add("load_dependent_friction", 1, 2, np.abs(m.tau) * _sign(m.v[1]))
    add("rotor_inertia", 1, None, m.a[1])
    add("torque_offset", 1, None, np.ones_like(m.tau))
    add("torque_saturation", 1, None, m.tau**3)
    return out


def _later(x: Array, seconds: float) -> Array:
    """What a late reading would have been on time."""
    grid = np.arange(x.size) / RATE_HZ
    return np.interp(grid + seconds, grid, x)


def sensor_terms(record: Record, m: Motion, beta: Array) -> dict[Key, list[Array]]:
    """Changes of the rows when a reading is corrected for a small fault, each (2, N)."""
    plain = need(record, beta)

    def change(step: float, **corrected: Any) -> Array:
        return (need(replace(record, **corrected), beta) - plain) / step

    r, e = record, 1e-3
    (q1, q2), (w1, w2) = m.q, m.v
    # a base on a stiff spring moves by the leg's reaction; its acceleration shakes the leg and the accelerometer
    push = beta[3] * np.cos(q1) * w1 + beta[4] * np.cos(q1 + q2) * (w1 + w2)
    shake = -_slope(_slope(_slope(push)))
    base = change(1e-5, ax=r.ax - 1e-5 * shake * np.cos(q1), ay=r.ay - 1e-5 * shake * np.sin(q1))
    knee = beta[4] * np.cos(q1 + q2) * shake
    base = base + np.stack([beta[3] * np.cos(q1) * shake + knee, knee])
    return {
        ("torque_delay", None, 0.0): [change(e, tau=_later(r.tau, e))],
        ("sensor_time_skew", None, 0.0): [
            change(e, gyro=_later(r.gyro, e), ax=_later(r.ax, e), ay=_later(r.ay, e))],
        ("gyro_bias", None, 0.0): [change(e, gyro=r.gyro - e)],
        ("gyro_scale", None, 0.0): [change(e, gyro=r.gyro * (1 - e))],
        ("accelerometer_bias", None, 0.0): [change(e, ax=r.ax - e), change(e, ay=r.ay - e)],
        ("imu_misalignment", None, 0.0): [change(e, ax=r.ax - e * r.ay, ay=r.ay + e * r.ax)],
        ("imu_lever_arm", None, 0.0): [change(e, lever=r.lever + e)],
        ("encoder_offset", 2, 0.0): [change(e, q2=r.q2 - e)],
        ("encoder_scale", 2, 0.0): [change(e, q2=r.q2 * (1 - e))],
        ("encoder_eccentricity", 2, 0.0): [change(e, q2=r.q2 - e * np.sin(r.q2)),
                                           change(e, q2=r.q2 - e * np.cos(r.q2))],
        ("joint_elasticity", 2, 0.0): [change(e, q2=r.q2 - e * m.tau)],
        ("backlash", 2, 0.0): [change(e, q2=r.q2 - e * np.tanh(m.tau / 0.05))],
        ("base_compliance", None, 0.0): [base],
    }


@dataclass(frozen=True)
class Problem:
    """Whitened regression of one case: rows over runs, samples and the two equations."""

    nominal: Array
    """(M, 9)"""
    torque: Array
    """(M,)"""
    terms: dict[Key, Array]
    """(M, k) each"""
    run: Array
    """(M,) number of the run"""


def build(records: Sequence[Record], without: str | None = None) -> Problem:
    """Regression of a case, without an effect that the library is to lack."""
    motions = [move(record) for record in records]
    # a joint that sticks is held by any torque up to its friction, which no linear term says: such rows are left out
    moving = np.abs(np.concatenate([_thin(np.stack(m.v)) for m in motions], axis=-1)) > MOVING_RADPS
    run = np.repeat([r.number for r in records], [_thin(m.tau).size for m in motions])
    z = np.concatenate([_thin(regressor(m)) for m in motions], axis=-1).transpose(0, 2, 1)[moving]
    y = np.concatenate([_thin(np.stack([np.zeros_like(m.tau), m.tau])) for m in motions], axis=-1)[moving]
    row = np.broadcast_to(np.arange(2)[:, None], moving.shape)[moving]
    sigma = np.ones(y.size)
    beta = np.zeros(9)
    for _ in range(4):  # the two rows weigh by what the fit leaves of each
        beta = _fit(z / sigma[:, None], y / sigma)
        left = y - z @ beta
        sigma = np.array([np.std(left[row == r]) for r in (0, 1)])[row]
    reach = np.array([max(float(np.abs(m.q[j]).max()) for m in motions) for j in (0, 1)])
    parts = [torque_terms(r, m, reach) | sensor_terms(r, m, beta) for r, m in zip(records, motions)]
    terms = {}
    for key in parts[0]:
        if key[0] != without:
            columns = np.concatenate([_thin(np.stack(part[key], axis=-2)) for part in parts], axis=-1)
            terms[key] = columns.transpose(0, 2, 1)[moving] / sigma[:, None]
    return Problem(z / sigma[:, None], y / sigma, terms, np.broadcast_to(run, moving.shape)[moving])


def _thin(x: Array) -> Array:
    """Low-passed once more (both sides of an equation alike) and thinned; ends, where filters err, left out."""
    return _low(x)[..., 50:-50:EVERY]


def _fit(x: Array, y: Array) -> Array:
    scale = np.linalg.norm(x, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(x / scale, y)[0] / scale)


def choose_bic(problem: Problem) -> list[Key]:
    """The one effect, or none, of the least Bayesian information criterion; a shape that was searched counts."""
    n = problem.torque.size

    def criterion(x: Array, count: int) -> float:
        rest = problem.torque - x @ _fit(x, problem.torque)
        return float(n * np.log(rest @ rest / n) + count * np.log(n))

    found: dict[Key | None, float] = {None: criterion(problem.nominal, 9)}
    for key, columns in problem.terms.items():
        found[key] = criterion(np.hstack([problem.nominal, columns]), 9 + columns.shape[1] + (key[2] != 0.0))
    best = min(found, key=lambda key: found[key])
    return [] if best is None else [best]


def choose_heldout(problem: Problem) -> list[Key]:
    """The one effect, or none, whose fit to the first runs predicts the torque of the last runs best."""
    test = problem.run >= RUNS - HELD_OUT

    def error(x: Array) -> float:
        rest = problem.torque[test] - x[test] @ _fit(x[~test], problem.torque[~test])
        return float(rest @ rest)

    found: dict[Key | None, float] = {None: error(problem.nominal)}
    found |= {key: error(np.hstack([problem.nominal, columns])) for key, columns in problem.terms.items()}
    best = min(found, key=lambda key: found[key])
    return [] if best is None else [best]


def choose_stlsq(problem: Problem) -> list[Key]:
    """All effects of which a term survives sequentially thresholded least squares; nominal terms are never cut.

    Brunton, Proctor and Kutz 2016, as pysindy's STLSQ does it; of the thresholds, the one with the least Bayesian
    information criterion. The nominal columns are projected out of everything.
    """
    from pysindy.optimizers import STLSQ

    basis, _ = np.linalg.qr(problem.nominal / np.linalg.norm(problem.nominal, axis=0))
    rest = problem.torque - basis @ (basis.T @ problem.torque)
    keys, columns = [], []
    for key, terms in problem.terms.items():
        for term in terms.T:
            left = term - basis @ (basis.T @ term)
            size = np.linalg.norm(left)
            if size > 1e-3 * np.linalg.norm(term):
                keys.append(key)
                columns.append(left * (np.sqrt(rest.size) / size))
    x, y = np.array(columns).T, rest / np.std(rest)
    best, kept = y.size * np.log(y @ y / y.size), np.array([], int)
    for threshold in THRESHOLDS:
        with warnings.catch_warnings(action="ignore"):  # that a threshold left nothing is an answer
            coefficients = np.asarray(STLSQ(threshold=threshold).fit(x, y[:, None]).coef_).reshape(-1)
        chosen = np.flatnonzero(coefficients)
        left = y - x @ coefficients
        criterion = y.size * np.log(left @ left / y.size) + chosen.size * np.log(y.size)
        if criterion < best:
            best, kept = criterion, chosen
    return [keys[k] for k in kept]


CHOOSE: dict[str, Callable[[Problem], list[Key]]] = {
    "bic": choose_bic, "stlsq": choose_stlsq, "heldout": choose_heldout}


def answer(keys: Sequence[Key]) -> dict[str, Any]:
    """The scorer's JSON: each effect and joint once."""
    named = dict.fromkeys((effect, joint) for effect, joint, _ in keys)
    return {"schema": "legid.blind-baseline/1", "verdict": "named" if named else "none",
            "causes": [{"effect": effect, "joint": joint, "size": []} for effect, joint in named]}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder that tests.evidence.blind.run wrote")
    options = parser.parse_args(arguments)
    for method in METHODS:
        (options.out / "baselines" / method).mkdir(parents=True, exist_ok=True)
    truths = sorted((options.out / "cases").glob("*.truth.json"))
    for count, path in enumerate(truths, 1):
        name = path.name.removesuffix(".truth.json")
        files = {method: options.out / "baselines" / method / f"{name}.json" for method in METHODS}
        if all(file.exists() for file in files.values()):
            continue
        # of the truth only what the library is to lack, which the diagnosis is told as well
        without = json.loads(path.read_text(encoding="utf-8"))["deleted"]
        problem = build(read_case(path.with_name(name)), without)
        for method, file in files.items():
            file.write_text(json.dumps(answer(CHOOSE[method](problem))), encoding="utf-8")
        print(f"baselines: {count}/{len(truths)} {name}", flush=True)
    return 0
