"""Cases of the blind bench, each made again from its class, effects, level and seed.

    python -m evidence blind.bench none --seed 1 --out cases
    python -m evidence blind.bench single --effect stribeck_friction --level moderate --seed 1 --out cases

writes cases/NAME/r1.csv .. r8.csv and rig.toml, and the truth beside the folder, cases/NAME.truth.json.
Seeds 1 to 99 are for tuning, 1000 and up for the claim.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence.blind.cases import (
    CLASSES,
    KNEE_LIMIT,
    PIVOT_LIMIT,
    RUNS,
    SAMPLES,
    STRENGTHS,
    TABLE_RATIO,
    TARGETS,
    Case,
    DrawnCase,
    catalogue,
    draw_case,
    physical,
    strengths,
)
from evidence.blind.effects import INSIDE, MAKERS, OUTSIDE, START
from evidence.blind.excite import SECONDS
from evidence.blind.leg import Array, Leg, stack
from evidence.blind.measure import RATE_HZ, coloured, disturb, read, write_rig, write_run
from evidence.blind.physics import Motion, integrate
from evidence.blind.ratio import error_ratio, sensitivities

SHARES = np.array([0.2, 0.35, 0.5, 0.7, 0.9, 1.15])
"""Peak torques tried, in units of the torque that holds link 2 level."""


def _scale(rigs: list[DrawnCase], grid: Array) -> None:
    """Give every case the largest torque that keeps its plain leg within moderate angles."""
    unique = {rig.plain_key: rig for rig in rigs}
    _scale_unique(list(unique.values()), grid)
    for rig in rigs:
        rig.scale = unique[rig.plain_key].scale


def _scale_unique(rigs: list[DrawnCase], grid: Array) -> None:
    legs: list[Leg] = []
    torque: list[Array] = []
    for rig in rigs:
        weight = 9.81 * float(rig.leg.beta()[4])
        for share in SHARES:
            for run in rig.torques:
                legs.append(rig.leg)
                torque.append(run.at(grid, share * weight))
    motion = integrate(stack(legs), np.array(torque).T, step=5e-3)
    shape = (len(rigs), SHARES.size, RUNS)
    knee = np.abs(motion.q2).max(axis=0).reshape(shape).max(axis=2)
    pivot = np.abs(motion.q1).max(axis=0).reshape(shape).max(axis=2)
    for rig, k, p in zip(rigs, knee, pivot):
        allowed = (k < KNEE_LIMIT) & (p < PIVOT_LIMIT)
        share = SHARES[np.flatnonzero(allowed)[-1]] if allowed.any() else SHARES[0]
        rig.scale = float(share * 9.81 * rig.leg.beta()[4]) * (0.25 if rig.variant == "weak" else 1.0)


def _acting(rig: DrawnCase, run: int, shown: Array, grid: Array) -> Array:
    """Torque that acts on the knee while the shunt shows `shown`."""
    drive: dict[str, float] = {}
    for effect in rig.hidden:
        drive.update(effect.drive)
    torque = shown
    if drive.get("delay"):
        torque = rig.torques[run].at(grid + drive["delay"], rig.scale)
    if drive.get("saturation"):
        torque = drive["saturation"] * np.tanh(torque / drive["saturation"])
    if drive.get("dead_band"):
        torque = torque - drive["dead_band"] * np.tanh(torque / drive["dead_band"])
    if drive.get("gain_drift"):
        torque = torque * (1.0 - drive["gain_drift"] * (rig.session[run] + grid) / (rig.session[-1] + SECONDS))
    return torque + drive.get("offset", 0.0)


@dataclass
class _Reference:
    """The plain leg of a case: on the measured torque, with process torque but no effect, and its slopes."""

    plain: Motion
    bare: Motion
    slopes: Array
    """(13, runs, 4, N)"""


@dataclass
class _Signals:
    """Torques of every lane, (N,) each: all runs of the first case, then of the next."""

    shown: list[Array]
    noise: list[Array]
    process: list[Array]
    pivot: list[Array]


def generate(cases: Sequence[Case], root: Path, *, table: dict[str, float] | None = None,
             write: bool = True, strength: Sequence[float] | None = None, with_ratio: bool = True,
             step: float = 5e-4, kept: dict[str, _Reference] | None = None,
             samples: int = SAMPLES) -> list[dict[str, Any]]:
    """Make all cases in one integration and give their truths; files go under `root` when `write`.

    A single effect is first scaled on a coarse step until its ratio meets the target of its level,
    unless `strength` is given. `kept` carries plain references from call to call (calibration asks for the same
    legs again and again).
    """
    table = strengths() if table is None else table
    grid = np.arange(samples) / RATE_HZ
    rigs = [draw_case(case, table, None if strength is None else strength[i]) for i, case in enumerate(cases)]
    _scale(rigs, grid)
    signals = _Signals([], [], [], [])
    for rig in rigs:
        for run in range(RUNS):
            signals.shown.append(rig.torques[run].at(grid, rig.scale))
            signals.noise.append(rig.sensors.torque * rig.noise.normal(size=samples))
            signals.process.append(coloured(rig.noise, samples, rig.sensors.process, rig.sensors.process_time))
            signals.pivot.append(coloured(rig.noise, samples, rig.sensors.pivot, rig.sensors.process_time))
    references = {} if kept is None else kept
    if with_ratio:
        _refer(rigs, signals, references)
        if strength is None:
            _size(rigs, signals, grid, table, references)
    motion = _truly(rigs, range(len(rigs)), signals, grid, step)
    return [_finish(rig, i, i, motion, signals, references.get(rig.plain_key), root if write else None)
            for i, rig in enumerate(rigs)]


def _truly(rigs: list[DrawnCase], chosen: Sequence[int], signals: _Signals, grid: Array, step: float) -> Motion:
    """Integrate the runs of the chosen cases with what is hidden in them."""
    legs: list[Leg] = []
    torque: list[Array] = []
    pivot: list[Array] = []
    session: list[float] = []
    fast: list[int] = []
    extra: dict[str, list[float]] = {}
    for i in chosen:
        rig = rigs[i]
        plant = {key: value for effect in rig.hidden for key, value in effect.plant.items()}
        for run in range(RUNS):
            lane = len(legs)
            factor = {k: v for h in rig.hidden for k, v in h.leg.items()} if run >= RUNS // 2 else {}
            legs.append(replace(rig.leg, **{k: getattr(rig.leg, k) * v for k, v in factor.items()}))
            source = i * RUNS + run
            torque.append(_acting(rig, run, signals.shown[source], grid) + signals.process[source])
            pivot.append(signals.pivot[source])
            session.append(float(rig.session[run]))
            if any("skew" in h.sense for h in rig.hidden):
                fast.append(lane)
            for key, value in plant.items():
                extra.setdefault(key, [0.0] * (RUNS * len(chosen)))[lane] = value
    return integrate(stack(legs), np.array(torque).T, pivot=np.array(pivot).T, step=step,
                     extra={k: np.array(v) for k, v in extra.items()}, session=np.array(session),
                     fast=np.array(fast, int))


def _size(rigs: list[DrawnCase], signals: _Signals, grid: Array, table: dict[str, float],
          references: dict[str, _Reference], rounds: int = 3) -> None:
    """Scale single effects to their target ratio: log-log secant steps on sqrt(ratio^2 - 1)."""
    value = {i: rig.strength for i, rig in enumerate(rigs) if len(rig.hidden) == 1}
    last: dict[int, tuple[float, float]] = {}
    open_ = list(value)
    for _ in range(rounds):
        if not open_:
            return
        # a light motor on its shaft needs the finer step
        shaft = any("shaft" in h.plant for i in open_ for h in rigs[i].hidden)
        motion = _truly(rigs, open_, signals, grid, 1e-3 if shaft else 2e-3)
        left = []
        for k, i in enumerate(open_):
            rig = rigs[i]
            name, target = rig.case.effects[0], rig.target
            got = _finish(rig, i, k, motion, signals, references[rig.plain_key], None)["ratio"]["projected"]
            if abs(np.log(got / target)) < 0.15:
                continue
            now = (float(np.log(value[i])), _log_excess(got))
            slope = 1.0
            if i in last and abs(now[0] - last[i][0]) > 1e-3:
                slope = float(np.clip((now[1] - last[i][1]) / (now[0] - last[i][0]), 0.4, 2.5))
            last[i] = now
            value[i] = physical(name, value[i] * np.exp(np.clip((_log_excess(target) - now[1]) / slope, -1.2, 1.2)))
            rig.hidden = draw_case(rig.case, table, value[i]).hidden
            left.append(i)
        open_ = left


def _log_excess(ratio: float) -> float:
    return float(np.log(max(ratio**2 - 1.0, 1e-2)) / 2)


def _refer(rigs: list[DrawnCase], signals: _Signals, kept: dict[str, _Reference]) -> None:
    """Add the plain references that `kept` lacks. Only a ratio hangs on them: a coarser step will do."""
    first = {rig.plain_key: i for i, rig in reversed(list(enumerate(rigs))) if rig.plain_key not in kept}
    if not first:
        return
    lanes = [i * RUNS + run for i in first.values() for run in range(RUNS)]
    count = len(lanes)
    shown, noise, process, pivot = signals.shown, signals.noise, signals.process, signals.pivot
    legs = [rigs[lane // RUNS].leg for lane in lanes]
    still = np.zeros_like(shown[0])
    motion = integrate(stack(legs * 2), np.array([shown[k] + noise[k] for k in lanes]
                                                 + [shown[k] + process[k] for k in lanes]).T,
                       pivot=np.array([still] * count + [pivot[k] for k in lanes]).T, step=1e-3)
    slopes = sensitivities(stack(legs), np.array([shown[k] for k in lanes]).T)
    for k, key in enumerate(first):
        mine = np.arange(k * RUNS, (k + 1) * RUNS)
        kept[key] = _Reference(motion.pick(mine), motion.pick(mine + count), slopes[:, mine])


def _finish(rig: DrawnCase, index: int, slot: int, motion: Motion, signals: _Signals,
            reference: _Reference | None, root: Path | None) -> dict[str, Any]:
    """Read the sensors of case `index`, which is the `slot`-th of `motion`; write its files and give its truth."""
    faults = {key: value for effect in rig.hidden for key, value in effect.sense.items()}
    lanes = list(range(slot * RUNS, (slot + 1) * RUNS))
    shown, noise = (x[index * RUNS:(index + 1) * RUNS] for x in (signals.shown, signals.noise))
    measured = [read(motion, lane, u, faults, rig.sensors) for lane, u in zip(lanes, shown)]
    truth: dict[str, Any] = {
        "schema": "legid.blind/1", "name": rig.case.name, "class": rig.case.kind, "variant": rig.variant,
        "level": rig.case.level if rig.hidden else None, "seed": rig.case.seed,
        "effects": [{"effect": h.effect, "joint": h.joint, "outside": h.outside,
                     "size": [asdict(s) for s in h.sizes],
                     "also": [{"effect": e, "joint": j} for e, j in h.also]} for h in rig.hidden],
        "deleted": rig.case.effects[0] if rig.case.kind == "deleted" else None,
        "parameters": dict(zip([f"beta{k}" for k in range(1, 10)], map(float, rig.leg.beta()))),
        "sensors": asdict(rig.sensors), "peak_torque_nm": rig.scale,
        "largest": {"q1_rad": float(np.abs(motion.q1[:, lanes]).max()),
                    "q2_rad": float(np.abs(motion.q2[:, lanes]).max())}}
    if reference is not None:
        plain, bare = reference.plain, reference.bare
        truth["free_run_rmse"] = {
            name: {"before": _rms(getattr(motion, q)[:, lanes] - getattr(plain, q)),
                   "floor": _rms(getattr(bare, q) - getattr(plain, q))}
            for name, q in (("q1_rad", "q1"), ("q2_rad", "q2"))}
        seen = [[read(m, run, shown[run], {}, rig.sensors) for run in range(RUNS)] for m in (plain, bare)]
        truth["ratio"] = error_ratio(measured, seen[0], seen[1], reference.slopes, rig.sensors)
    if root is not None:
        folder = root / rig.case.name
        folder.mkdir(parents=True, exist_ok=True)
        write_rig(folder / "rig.toml", rig.sensors)
        for run in range(RUNS):
            write_run(folder / f"r{run + 1}.csv", disturb(measured[run], noise[run], rig.sensors, rig.noise))
        (root / f"{rig.case.name}.truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
    return truth


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def calibrate(seeds: Sequence[int] = (1, 2, 3), target: float = TABLE_RATIO, rounds: int = 4,
              names: Sequence[str] = (*INSIDE, *OUTSIDE)) -> None:
    """Find every effect's strength for a projected ratio of `target` (median over seeds) and keep the table."""
    known = json.loads(STRENGTHS.read_text(encoding="utf-8")) if STRENGTHS.exists() else {"strengths": {}, "ratio": {}}
    value = {name: known["strengths"].get(name, START[name]) for name in names}
    last: dict[str, tuple[float, float]] = {}
    kept: dict[str, _Reference] = {}
    for _ in range(rounds):
        cases = [Case("calibrate", (name,), "moderate", seed) for name in names for seed in seeds]
        truths = generate(cases, Path("."), write=False, strength=[value[c.effects[0]] for c in cases],
                          step=1e-3, kept=kept)
        for k, name in enumerate(names):
            mine = truths[k * len(seeds):(k + 1) * len(seeds)]
            got = float(np.median([t["ratio"]["projected"] for t in mine]))
            print(f"{name:28s} {value[name]:.5g} -> {got:.2f}", flush=True)
            known["strengths"][name], known["ratio"][name] = value[name], got
            now = (float(np.log(value[name])), _log_excess(got))
            aim = _log_excess(target)
            slope = 1.0
            if name in last and abs(now[0] - last[name][0]) > 1e-3:
                slope = float(np.clip((now[1] - last[name][1]) / (now[0] - last[name][0]), 0.4, 2.5))
            last[name] = now
            step = float(np.clip((aim - now[1]) / slope, -1.2, 1.2))
            if 2.7 < got < 3.3:
                step = 0.0
            value[name] = physical(name, np.exp(now[0] + step))
        known["seeds"], known["target"] = list(seeds), target
        STRENGTHS.write_text(json.dumps(known, indent=1), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=(*CLASSES, "calibrate"))
    parser.add_argument("--effect", help="NAME, or NAME+NAME for a pair; without it every effect of the class")
    parser.add_argument("--level", choices=tuple(TARGETS), default="moderate")
    parser.add_argument("--seed", default="1", help="N or A-B")
    parser.add_argument("--out", type=Path, default=Path("blind-cases"))
    parser.add_argument("--batch", type=int, default=32, help="cases in one integration")
    options = parser.parse_args(arguments)
    low, _, high = options.seed.partition("-")
    seeds = range(int(low), int(high or low) + 1)
    names = tuple(options.effect.split("+")) if options.effect else ()
    unknown = [name for name in names if name not in MAKERS]
    if unknown:
        parser.error(f"no effect is called {unknown[0]}; there are {', '.join(MAKERS)}")
    if options.kind == "calibrate":
        calibrate(names=names or (*INSIDE, *OUTSIDE))
        return 0
    if options.kind == "none" and names:
        parser.error("class none hides nothing: leave --effect out")
    cases = [Case(options.kind, names, options.level, s) for s in seeds] if names \
        else catalogue(options.kind, seeds, level=options.level)
    start = time.perf_counter()
    for k in range(0, len(cases), options.batch):
        for truth in generate(cases[k:k + options.batch], options.out):
            print(f"{truth['name']}  ratio {truth['ratio']['projected']:.2f} (raw {truth['ratio']['raw']:.2f})",
                  flush=True)
    print(f"{len(cases)} cases in {time.perf_counter() - start:.1f} s")
    return 0
