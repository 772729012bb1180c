"""Cases of the blind bench, each made again from its class, effects and seed: runs and rig file, and next to the folder
the truth.
"""

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evidence.blind.cases import KNEE_LIMIT, PIVOT_LIMIT, RUNS, SAMPLES, Case, DrawnCase, draw_case, physical, strengths
from evidence.blind.effects import OUTSIDE
from evidence.blind.excite import SECONDS
from evidence.blind.leg import Array, Leg, stack
from evidence.blind.measure import RATE_HZ, coloured, disturb, read, write_rig, write_run
from evidence.blind.physics import Motion, integrate
from evidence.blind.ratio import error_ratio, sensitivities

SHARES = np.array([0.2, 0.35, 0.5, 0.7, 0.9, 1.15])
"""Peak torques tried, in units of the torque that holds link 2 level."""


def _scale(rigs: list[DrawnCase], grid: Array) -> None:
    """Give every case the largest torque that keeps its plain leg within moderate angles."""
    tried = [(rig.leg, run.at(grid, share * (9.81 * float(rig.leg.beta()[4]))))
             for rig in rigs for share in SHARES for run in rig.torques]
    legs, torque = zip(*tried)
    motion = integrate(stack(list(legs)), np.array(torque).T, step=5e-3)
    knee, pivot = (np.abs(q).max(axis=0).reshape(len(rigs), SHARES.size, RUNS).max(axis=2)
                   for q in (motion.q2, motion.q1))
    for rig, k, p in zip(rigs, knee, pivot):
        allowed = (k < KNEE_LIMIT) & (p < PIVOT_LIMIT)
        share = SHARES[np.flatnonzero(allowed)[-1]] if allowed.any() else SHARES[0]
        rig.scale = float(share * 9.81 * rig.leg.beta()[4]) * (0.25 if rig.variant == "weak" else 1.0)


def _acting(rig: DrawnCase, run: int, shown: Array, grid: Array) -> Array:
    """Torque that acts on the knee while the shunt shows `shown`."""
    drive = defaultdict(float, {key: value for effect in rig.hidden for key, value in effect.drive.items()})
    torque = shown
    if drive["delay"]:
        torque = rig.torques[run].at(grid + drive["delay"], rig.scale)
    if drive["saturation"]:
        torque = drive["saturation"] * np.tanh(torque / drive["saturation"])
    if drive["dead_band"]:
        torque = torque - drive["dead_band"] * np.tanh(torque / drive["dead_band"])
    if drive["gain_drift"]:
        torque = torque * (1.0 - drive["gain_drift"] * (rig.session[run] + grid) / (rig.session[-1] + SECONDS))
    return torque + drive["offset"]


@dataclass
class _Reference:
    """The plain leg of a case: on the measured torque, with process torque but no effect, and its slopes."""

    plain: Motion
    bare: Motion
    slopes: Array
    """(13, runs, 4, N)"""


class _Signals(NamedTuple):
    """Torques of every lane, (L, N) each: all runs of the first case, then of the next."""

    shown: Array
    noise: Array
    process: Array
    pivot: Array


def generate(cases: Sequence[Case], root: Path, *, with_ratio: bool = True, step: float = 5e-4,
             samples: int = SAMPLES) -> list[dict[str, Any]]:
    """Make all cases in one integration, write their files to `root` and give their truths.

    A single effect is first scaled on a coarse step until its ratio meets the target of its level.
    """
    grid = np.arange(samples) / RATE_HZ
    rigs = [draw_case(case, strengths()) for case in cases]
    _scale(rigs, grid)
    lanes = [(torque.at(grid, rig.scale), rig.sensors.torque * rig.noise.normal(size=samples),
              *(coloured(rig.noise, samples, rms, rig.sensors.process_time)
                for rms in (rig.sensors.process, rig.sensors.pivot))) for rig in rigs for torque in rig.torques]
    signals = _Signals(*np.array(lanes).transpose(1, 0, 2))
    references = _refer(rigs, signals) if with_ratio else []
    if with_ratio:
        _size(rigs, signals, grid, references)
    motion = _truly(rigs, range(len(rigs)), signals, grid, step)
    truths = []
    for i, rig in enumerate(rigs):
        measured, ratio = _seen(rig, i, i, motion, signals, *references[i:i + 1])
        truths.append(_written(rig, i, motion, signals, measured, ratio, root))
    return truths


def _truly(rigs: list[DrawnCase], chosen: Sequence[int], signals: _Signals, grid: Array, step: float) -> Motion:
    """Integrate the runs of the chosen cases with what is hidden in them."""
    lanes = [(i, run) for i in chosen for run in range(RUNS)]
    source = [i * RUNS + run for i, run in lanes]
    legs, torque, extra = list[Leg](), list[Array](), dict[str, Array]()
    for lane, (i, run) in enumerate(lanes):
        rig = rigs[i]
        factor = {k: v for h in rig.hidden for k, v in h.leg.items()} if run >= RUNS // 2 else {}
        legs.append(replace(rig.leg, **{k: getattr(rig.leg, k) * v for k, v in factor.items()}))
        torque.append(_acting(rig, run, signals.shown[source[lane]], grid) + signals.process[source[lane]])
        for key, value in (one for h in rig.hidden for one in h.plant.items()):
            extra.setdefault(key, np.zeros(len(lanes)))[lane] = value
    late = [lane for lane, (i, _) in enumerate(lanes) if any("skew" in h.sense for h in rigs[i].hidden)]
    return integrate(stack(legs), np.array(torque).T, pivot=signals.pivot[source].T, step=step, extra=extra,
                     session=np.array([rigs[i].session[run] for i, run in lanes]), fast=np.array(late, int))


def _size(rigs: list[DrawnCase], signals: _Signals, grid: Array, references: list[_Reference]) -> None:
    """Scale single effects to their target ratio: log-log secant steps on sqrt(ratio^2 - 1)."""
    value = {i: rig.strength for i, rig in enumerate(rigs) if len(rig.hidden) == 1}
    last: dict[int, tuple[float, float]] = {}
    open_ = list(value)
    for _ in range(3):
        if not open_:
            return
        # a light motor on its shaft needs the finer step
        shaft = any("shaft" in h.plant for i in open_ for h in rigs[i].hidden)
        motion = _truly(rigs, open_, signals, grid, 1e-3 if shaft else 2e-3)
        left = []
        for k, i in enumerate(open_):
            rig = rigs[i]
            name, target = rig.case.effects[0], rig.target
            _, got = _seen(rig, i, k, motion, signals, references[i])
            assert got is not None
            if abs(np.log(got / target)) < 0.15:
                continue
            now = (float(np.log(value[i])), _log_excess(got))
            slope = 1.0
            if i in last and abs(now[0] - last[i][0]) > 1e-3:
                slope = float(np.clip((now[1] - last[i][1]) / (now[0] - last[i][0]), 0.4, 2.5))
            last[i] = now
            value[i] = physical(name, value[i] * np.exp(np.clip((_log_excess(target) - now[1]) / slope, -1.2, 1.2)))
            rig.hidden = draw_case(rig.case, strengths(), value[i]).hidden
            left.append(i)
        open_ = left


def _log_excess(ratio: float) -> float:
    return float(np.log(max(ratio**2 - 1.0, 1e-2)) / 2)


def _refer(rigs: list[DrawnCase], signals: _Signals) -> list[_Reference]:
    """The plain reference of each case. Only a ratio hangs on them: a coarser step will do."""
    count = len(rigs) * RUNS
    shown, noise, process, pivot = signals
    legs = [rig.leg for rig in rigs for _ in range(RUNS)]
    motion = integrate(stack(legs * 2), np.concatenate([shown + noise, shown + process]).T,
                       pivot=np.concatenate([np.zeros_like(shown), pivot]).T, step=1e-3)
    slopes = sensitivities(stack(legs), shown.T)
    lanes = (np.arange(k * RUNS, (k + 1) * RUNS) for k in range(len(rigs)))
    return [_Reference(motion.pick(mine), motion.pick(mine + count), slopes[:, mine]) for mine in lanes]


def _seen(rig: DrawnCase, index: int, slot: int, motion: Motion, signals: _Signals, reference: _Reference | None = None
          ) -> tuple[list[dict[str, Array]], float | None]:
    """Readings of case `index`, which is the `slot`-th of `motion`, without noise, and the ratio of its error."""
    faults = {key: value for effect in rig.hidden for key, value in effect.sense.items()}
    shown = signals.shown[index * RUNS:(index + 1) * RUNS]
    measured = [read(motion, slot * RUNS + run, shown[run], faults, rig.sensors) for run in range(RUNS)]
    if reference is None:
        return measured, None
    seen = [[read(m, run, shown[run], {}, rig.sensors) for run in range(RUNS)]
            for m in (reference.plain, reference.bare)]
    return measured, error_ratio(measured, seen[0], seen[1], reference.slopes, rig.sensors)


def _written(rig: DrawnCase, index: int, motion: Motion, signals: _Signals, measured: list[dict[str, Array]],
             ratio: float | None, root: Path) -> dict[str, Any]:
    """Write the files of a case; its truth."""
    lanes = slice(index * RUNS, (index + 1) * RUNS)
    truth: dict[str, Any] = {
        "name": rig.case.name, "variant": rig.variant, "seed": rig.case.seed, "ratio": ratio,
        "effects": [{"effect": name, "joint": h.joint, "outside": name in OUTSIDE,
                     "size": [asdict(s) for s in h.sizes], "also": [{"effect": e, "joint": j} for e, j in h.also]}
                    for name, h in zip(rig.case.effects, rig.hidden)],
        "parameters": dict(zip([f"beta{k}" for k in range(1, 10)], map(float, rig.leg.beta()))),
        "sensors": asdict(rig.sensors),
        "largest": {f"q{j}_rad": float(np.abs(q[:, lanes]).max()) for j, q in ((1, motion.q1), (2, motion.q2))}}
    folder = root / rig.case.name
    folder.mkdir(parents=True, exist_ok=True)
    write_rig(folder / "rig.toml", rig.sensors)
    for run, (columns, noise) in enumerate(zip(measured, signals.noise[lanes]), 1):
        write_run(folder / f"r{run}.csv", disturb(columns, noise, rig.sensors, rig.noise))
    (root / f"{rig.case.name}.truth.json").write_text(json.dumps(truth, indent=1))
    return truth
