"""The catalogue of the blind bench: cases, and what a seed makes of one."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from evidence.blind.effects import INSIDE, LARGEST, MAKERS, NEEDS, OUTSIDE, SMALLEST, START, Hidden
from evidence.blind.excite import PATTERN, SECONDS, Torque, draw
from evidence.blind.leg import Array, Leg
from evidence.blind.measure import RATE_HZ, Sensors

CLASSES = ("none", "single", "pair", "outside", "deleted")
# range of the ratio between the nominal free run's error and its floor (ratio.py), drawn within by seed
TARGETS = {"small": (1.25, 1.6), "moderate": (2.3, 4.3), "large": (6.0, 9.0)}
TABLE_RATIO = 3.0
VARIANTS = ("plain", "weak", "coarse", "coloured", "quiet")
RUNS = len(PATTERN)
SAMPLES = round(SECONDS * RATE_HZ)
STRENGTHS = Path(__file__).with_name("strengths.json")
KNEE_LIMIT, PIVOT_LIMIT = 1.7, 0.85
# two of one kind make one effect, not two; a shaft is either wound or has play
APART = ({"joint_elasticity", "backlash"}, {"stribeck_friction", "presliding_friction"},
         {"asymmetric_friction", "torque_offset"})


@dataclass(frozen=True)
class Case:
    """What is hidden, how strongly, and the seed of everything else."""

    kind: str
    effects: tuple[str, ...] = ()
    level: str = "moderate"
    seed: int = 1

    @property
    def name(self) -> str:
        parts = [self.kind, *self.effects]
        if self.effects:
            parts.append(self.level)
        return "-".join([*parts, str(self.seed)])


@dataclass
class DrawnCase:
    """A case drawn from its seed."""

    case: Case
    variant: str
    leg: Leg
    sensors: Sensors
    torques: list[Torque]
    hidden: list[Hidden]
    noise: np.random.Generator
    session: Array
    strength: float
    """Of the last effect; what is scaled when it is the only one."""
    target: float
    """Projected ratio that a single effect is scaled to."""
    scale: float = 1.0

    @property
    def plain_key(self) -> str:
        """Equal for cases that share leg and excitation."""
        return f"{self.case.seed}-{self.leg.coulomb2:.9f}" if self.case.kind == "calibrate" else self.case.name


def strengths() -> dict[str, float]:
    """Strength of every effect at which the nominal free run errs about three times its floor (calibrated)."""
    table = dict(START)
    if STRENGTHS.exists():
        table.update(json.loads(STRENGTHS.read_text(encoding="utf-8"))["strengths"])
    return table


def draw_leg(rng: np.random.Generator) -> Leg:
    """A leg of a plausible size."""
    nominal = Leg()
    factor = rng.uniform(0.8, 1.25, len(fields(Leg)))
    return Leg(**{f.name: float(getattr(nominal, f.name) * k) for f, k in zip(fields(Leg), factor)})


def draw_case(case: Case, table: dict[str, float], strength: float | None = None) -> DrawnCase:
    # calibration compares effects on the same legs
    parts = (case.kind,) if case.kind == "calibrate" else (case.kind, "+".join(case.effects), case.level)
    key = [zlib.crc32(part.encode()) for part in parts]
    streams = np.random.SeedSequence([*key, case.seed]).spawn(4)
    plan, hide, sensor, noise = (np.random.default_rng(s) for s in streams)
    variant = VARIANTS[case.seed % len(VARIANTS)] if case.kind == "none" else "plain"
    sensors = Sensors(process=float(sensor.uniform(0.005, 0.015)), process_time=float(sensor.uniform(0.05, 0.4)))
    if variant == "coarse":
        sensors = replace(sensors, bits=11)
    elif variant == "coloured":
        sensors = replace(sensors, process=0.02, process_time=0.3, pivot=0.003)
    elif variant == "quiet":
        sensors = replace(sensors, process=0.0)
    hidden, size, target = [], 0.0, float(hide.uniform(*TARGETS[case.level]))
    for name in case.effects:
        size = physical(name, table[name] * np.sqrt((target**2 - 1.0) / (TABLE_RATIO**2 - 1.0)))
        size = size if strength is None else strength
        hidden.append(MAKERS[name](float(size), hide))
    leg = draw_leg(plan)
    for name in case.effects:
        leg = replace(leg, **{k: getattr(leg, k) * v for k, v in NEEDS.get(name, {}).items()})
    gaps = plan.uniform(10.0, 40.0, RUNS)
    session = np.arange(RUNS) * SECONDS + np.concatenate([[0.0], np.cumsum(gaps[1:])])
    return DrawnCase(case, variant, leg, sensors, [draw(plan, kind) for kind in PATTERN], hidden, noise, session,
                strength=float(size), target=target)


def physical(name: str, strength: float) -> float:
    return float(np.clip(strength, SMALLEST.get(name, 0.0), LARGEST.get(name, np.inf)))


def catalogue(kind: str, seeds: Sequence[int], *, level: str = "moderate") -> list[Case]:
    """All cases of a class for these seeds: one per seed, and per effect where the class has one.

    Cases of one effect follow each other: an integration pays for every effect that any of its lanes has.
    """
    if kind == "none":
        return [Case("none", (), "moderate", seed) for seed in seeds]
    if kind == "pair":
        return [Case("pair", draw_pair(seed), level, seed) for seed in seeds]
    return [Case(kind, (name,), level, seed) for name in (OUTSIDE if kind == "outside" else INSIDE) for seed in seeds]


def draw_pair(seed: int) -> tuple[str, str]:
    """Two effects that do not cancel each other's meaning."""
    rng = np.random.default_rng([7, seed])
    while True:
        first, second = (str(n) for n in rng.choice(INSIDE, 2, replace=False))
        if {first, second} not in APART:
            return first, second
