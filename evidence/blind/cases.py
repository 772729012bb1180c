"""The catalogue of the blind bench: cases, and what a seed makes of one."""

import json
import zlib
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng

from evidence.blind.effects import INSIDE, LARGEST, MAKERS, NEEDS, SMALLEST, Hidden
from evidence.blind.excite import PATTERN, SECONDS, Torque, draw
from evidence.blind.leg import Array, Leg
from evidence.blind.measure import RATE_HZ, Sensors

# range of the ratio between the nominal free run's error and its floor (ratio.py), drawn within by seed
TARGETS = {"moderate": (2.3, 4.3), "large": (6.0, 9.0)}
TABLE_RATIO = 3.0
VARIANTS = ("plain", "weak", "coarse", "coloured", "quiet")
RUNS = len(PATTERN)
SAMPLES = round(SECONDS * RATE_HZ)
KNEE_LIMIT, PIVOT_LIMIT = 1.7, 0.85
# two of one kind make one effect, not two; a shaft is either wound or has play
APART = ({"joint_elasticity", "backlash"}, {"stribeck_friction", "presliding_friction"},
         {"asymmetric_friction", "torque_offset"})


class Case(NamedTuple):
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
    noise: Generator
    session: Array
    strength: float
    """Of the last effect; what is scaled when it is the only one."""
    target: float
    """Projected ratio that a single effect is scaled to."""
    scale: float = 1.0


@cache
def strengths() -> dict[str, float]:
    """Strength of every effect at which the nominal free run errs about three times its floor (calibrated)."""
    found: dict[str, float] = json.loads(Path(__file__).with_name("strengths.json").read_text())["strengths"]
    return found


def draw_leg(rng: Generator) -> Leg:
    """A leg of a plausible size."""
    nominal = Leg()
    factor = rng.uniform(0.8, 1.25, len(fields(Leg)))
    return Leg(**{f.name: float(getattr(nominal, f.name) * k) for f, k in zip(fields(Leg), factor)})


def draw_case(case: Case, table: dict[str, float], strength: float | None = None) -> DrawnCase:
    parts = (case.kind, "+".join(case.effects), case.level)
    key = [zlib.crc32(part.encode()) for part in parts]
    streams = np.random.SeedSequence([*key, case.seed]).spawn(4)
    plan, hide, sensor, noise = (default_rng(s) for s in streams)
    variant = VARIANTS[case.seed % len(VARIANTS)] if case.kind == "none" else "plain"
    sensors = Sensors(process=sensor.uniform(0.005, 0.015), process_time=sensor.uniform(0.05, 0.4))
    if variant == "coarse":
        sensors = replace(sensors, bits=11)
    elif variant == "coloured":
        sensors = replace(sensors, process=0.02, process_time=0.3, pivot=0.003)
    elif variant == "quiet":
        sensors = replace(sensors, process=0.0)
    hidden, size, target = [], 0.0, hide.uniform(*TARGETS[case.level])
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


def draw_pair(seed: int) -> tuple[str, str]:
    """Two effects that do not cancel each other's meaning."""
    rng = default_rng([7, seed])
    while True:
        first, second = (str(n) for n in rng.choice(INSIDE, 2, replace=False))
        if {first, second} not in APART:
            return first, second
