"""Legs whose parameters are known: one effect hidden in them or none, seven families, eight runs each."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng
from scipy.interpolate import CubicSpline

import legid
from daq import Dataset, FloatArray, Rig, load_rig, parse_rig
from daq.runs import write_csv
from estimator.model import leg2
from evidence.blind import bench, geared, outside, servo, several_faults, stickslip
from evidence.blind.cases import Case
from evidence.blind.effects import INSIDE, OUTSIDE
from evidence.coverage import SHUNT_NM, TIME_CONSTANTS_S, WANDER
from evidence.emulated_legs import leg_of, rig_in
from evidence.frame import new_folder
from experiments.emulation import EFFECTS, NOTHING, record_emulated
from experiments.excite import random_multisine
from experiments.session import as_datasets
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.ornstein_uhlenbeck import disturbed_record

RUNS, HEALTHY = 8, "none"
EMULATED_S, EMULATED_NM = 5.0, 0.7
NAMES = tuple(f"beta{k}" for k in range(1, 10))
FRICTION = NAMES[5:]
LAWS = ("drag", "friction", "worm", "eddy", "damping")
"""A hidden effect with one of these words in its name is friction by another law."""


class KnownLeg(NamedTuple):
    """Runs of one leg, its rig, and its true parameters by name, as far as the nominal model has them."""

    runs: Sequence[Dataset]
    rig: Rig
    truth: Mapping[str, float]


class Family(NamedTuple):
    """One make of legs."""

    legs: str
    hidden: tuple[str, ...]
    """Effects, one of which may be hidden."""
    make: Callable[[str, Generator, Path], KnownLeg]
    """(effect or HEALTHY, random numbers, empty folder) -> a leg with its runs."""


def servo_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    return _servo((servo.MAKERS | outside.MAKERS)[hidden](rng.uniform(0.85, 1.15)), rng, folder)


def small_faults_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    small = [servo.MAKERS[n](share * rng.uniform(0.7, 1.3)) for n, share in several_faults.TEN.items() if n != hidden]
    return _servo(several_faults.together([servo.MAKERS[hidden](rng.uniform(0.85, 1.15)), *small]), rng, folder)


def _servo(plant: servo.Plant, rng: Generator, folder: Path) -> KnownLeg:
    leg = servo.write_plant("leg", 0, folder, plant, [], *servo.draw(rng), rng)
    return read_leg(folder / "leg-0", truth_of(leg.beta()))


def geared_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    leg, dry, runs = geared.record([geared.MAKERS[hidden](rng.uniform(0.85, 1.15))] * RUNS, rng)
    moved = list(runs)
    truth = truth_of(leg.beta() + _lumped(moved, geared.ROTOR))
    servo.write_case("leg", 0, folder, moved, rng, leg, servo.RIG, [], dry)
    return read_leg(folder / "leg-0", {name: truth[name] for name in NAMES if name not in FRICTION})


def _lumped(runs: Sequence[Mapping[str, FloatArray]], rotor: float) -> FloatArray:
    """(9,) change of the parameters whose torque over the motion is nearest to that of the knee's rotor."""
    mechanism, rows, lacking = leg2(), list[FloatArray](), list[FloatArray]()
    for run in runs:
        t = run["time_s"]
        motion = [CubicSpline(t, run[name]) for name in ("q1_rad", "q2_rad")]
        q, v, a = (np.column_stack([joint(t, k) for joint in motion]) for k in range(3))
        rows.append(mechanism.regressor(q, v, a).reshape(-1, 9))
        lacking.append((a * [0.0, rotor]).ravel())
    found: FloatArray = np.linalg.lstsq(np.concatenate(rows), np.concatenate(lacking))[0]
    return found


def stickslip_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    leg, dry, runs = stickslip.record([stickslip.MAKERS[hidden][0](rng.uniform(0.85, 1.15))] * RUNS, rng)
    servo.write_case("leg", 0, folder, runs, rng, leg, "", [], dry)
    return read_leg(folder / "leg-0", truth_of(leg.beta()))


def bench_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    kind = HEALTHY if hidden == HEALTHY else "outside" if hidden in OUTSIDE else "single"
    case = Case(kind, () if hidden == HEALTHY else (hidden,), seed=int(rng.integers(2**31)))
    bench.generate([case], folder, with_ratio=False)
    truth = json.loads((folder / f"{case.name}.truth.json").read_text())
    return read_leg(folder / case.name, truth["parameters"])


def wandering_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    leg = random_leg(rng)
    level, constant_s = SHUNT_NM * rng.uniform(*WANDER), float(rng.choice(TIME_CONSTANTS_S))
    runs = [disturbed_record(leg, rng, level, constant_s, f"run{k}") for k in range(RUNS)]
    return KnownLeg(runs, parse_rig(_rig_of(leg)), truth_of(leg.beta()))


def emulated_leg(hidden: str, rng: Generator, folder: Path) -> KnownLeg:
    number = int(rng.integers(2**31))
    body, (rig, text) = leg_of(0, number), rig_in(folder)
    files = [folder / f"run{k}.mcap" for k in range(RUNS)]
    for k, file in enumerate(files):
        record_emulated(file, rig, text, random_multisine(number + k, EMULATED_S, EMULATED_NM), number + k, body,
                        EFFECTS.get(hidden, NOTHING))
    return KnownLeg(as_datasets(files, rig, False), rig, truth_of(body.beta()))


def _rig_of(leg: Leg) -> str:
    return f'[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {leg.lever}\n'


class Answered(NamedTuple):
    """What `legid fit` and `legid diagnose` say of runs of a leg."""

    fit: legid.FitResult
    within: tuple[bool, ...]
    """Whether each of beta1..9 is in the fit's interval."""
    trust: str
    """TRUST, TRUST WITH CARE or DO NOT TRUST"""
    found: legid.Diagnosis
    runs: Sequence[Dataset]


def answered(leg: Leg, runs: Sequence[Dataset], more: str = "") -> Answered:
    """The answers from CSV files; the rig file states the mechanism, the IMU's lever arm, and `more`."""
    rig = parse_rig(_rig_of(leg) + more)
    with new_folder() as folder:
        files = [folder / f"{run.name}.csv" for run in runs]
        for run, file in zip(runs, files):
            write_csv(run, file)
        read = as_datasets(files, rig, False)
        fit, found = legid.fit(read, rig), legid.diagnose(read, rig)
    at = dict(zip(fit.mechanism.names, fit.ci95()))  # a fit may have chosen further terms
    inside = tuple(bool(at[name][0] <= b <= at[name][1]) for name, b in zip(NAMES, leg.beta()))
    return Answered(fit, inside, str(fit.trust).split("; ")[-1].split(" the ")[0], found, read)


def short(sentence: str) -> str:
    """A first line without what follows the colon."""
    return sentence.split("; ")[-1].split(":")[0].split(". ")[0].rstrip(".")


def truth_of(beta: Sequence[float] | FloatArray) -> dict[str, float]:
    return dict(zip(NAMES, map(float, beta), strict=True))


def read_leg(folder: Path, truth: Mapping[str, float]) -> KnownLeg:
    rig = load_rig(folder / "rig.toml")
    return KnownLeg(as_datasets([folder / f"r{k}.csv" for k in range(1, RUNS + 1)], rig, False), rig, truth)


def _effects(names: Sequence[str] | Mapping[str, object]) -> tuple[str, ...]:
    return tuple(name for name in names if not name.startswith(HEALTHY))


FAMILIES: dict[str, Family] = {
    "servo": Family("MuJoCo under a position servo", _effects(servo.MAKERS | outside.MAKERS), servo_leg),
    "small faults": Family("the same with ten small faults", _effects(several_faults.NAMES), small_faults_leg),
    "geared": Family("a soft gear with play, LuGre friction, a dozen small faults", _effects(geared.MAKERS),
                     geared_leg),
    "stick-slip": Family("event-driven stick-slip, faults in the readings", _effects(stickslip.MAKERS), stickslip_leg),
    "bench": Family("own integration, disturbed joints, open-loop torque", (*INSIDE, *OUTSIDE), bench_leg),
    "wander": Family("MuJoCo, a coloured torque at the knee", (), wandering_leg),
    "emulated": Family("the emulated rig through the drivers", _effects(EFFECTS), emulated_leg)}


def hidden_at(family: str, turn: int) -> str:
    """What is hidden at this turn of a family: nothing at even turns, at odd ones the next of a shuffled list."""
    effects = FAMILIES[family].hidden
    if turn % 2 == 0 or not effects:
        return HEALTHY
    order = default_rng(list(FAMILIES).index(family)).permutation(len(effects))
    return effects[order[turn // 2 % len(effects)]]


def make(family: str, turn: int, seed: int, folder: Path) -> KnownLeg:
    """The leg of this turn. Its truth lacks friction that follows another law than the nominal model's."""
    hidden = hidden_at(family, turn)
    rng = default_rng([seed, list(FAMILIES).index(family), turn])
    found = FAMILIES[family].make(hidden, rng, folder)
    changed = FRICTION if any(word in hidden for word in LAWS) else ()
    return found._replace(truth={name: value for name, value in found.truth.items() if name not in changed})
