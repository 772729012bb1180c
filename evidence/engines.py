"""`make engines`: healthy legs of two other engines, and healthy records under a stated rate that is not theirs.

Pinocchio and PyBullet come with `pip install "legid[engines]"`; what is not installed is left out, and the page says
so.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import count, product
from typing import NamedTuple

import numpy as np

from daq import Dataset
from evidence.frame import Lines, program, share, table, within
from evidence.kept import kept
from evidence.known_legs import answered
from evidence.registry import Evidence
from evidence.timing import drawn
from tests.support.engine_leg import MODULES, missing
from tests.support.engine_leg import record as simulated
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.timed_leg import Timing, record

RUNS, SECONDS = 4, 8.0
TICK_HZ = 500.0
CASES = tuple(product(("pd", "open"), (200.0, 100.0, 250.0), (4096, 16384)))
"""Loop, rate of the log [Hz] and encoder counts, in turn."""
FACTORS = (0.5, 2.0)
TORQUE_NM = 0.01
"""Noise of the measured torque, 1 sigma."""


class Healthy(NamedTuple):
    """The answers on one leg without a fault."""

    engine: str
    loop: str
    log_hz: float
    counts: int
    stated_hz: float
    """0: the rig file states no rate"""
    verdict: str
    trust: str
    within: tuple[bool, ...]
    """Whether each of beta1..9 is in its interval"""
    torque_nm: float
    """Noise of the torque that the fit finds"""
    said: str
    """What the run's flag on its grid says; empty without one"""


def healthy(engine: str, timing: Timing, log_hz: float, counts: int, leg: Leg, runs: Sequence[Dataset],
            stated_hz: float = 0.0) -> Healthy:
    """The answers, and the run's flag on its grid."""
    fit, inside, trust, found, read = answered(leg, runs, f"[sampling]\nrate_hz = {stated_hz}\n" * (stated_hz > 0.0))
    said = next((flag.text for flag in read[0].flags if flag.kind == "grid"), "")
    return Healthy(engine, timing.loop, log_hz, counts, stated_hz, found.verdict, trust, inside,
                   fit.levels.get("torque_nm", np.nan), said)


@kept
def of_engine(seed: int, turn: int, engine: str) -> Healthy:
    """A leg in an engine."""
    loop, log_hz, counts = CASES[turn % len(CASES)]
    rng = np.random.default_rng([seed, turn, 4])
    leg, timing = random_leg(rng), Timing(TICK_HZ, loop=loop)
    runs = [simulated(engine, leg, rng, timing, log_hz=log_hz, seconds=SECONDS, counts=counts, run=f"run{k}")
            for k in range(RUNS)]
    return healthy(engine, timing, log_hz, counts, leg, runs)


@kept
def of_rate(seed: int, turn: int, factor: float) -> Healthy:
    """A leg of `make timing` without a delay, and a rig file that states `factor` times the rate of its log."""
    timing = replace(drawn(seed, turn), delay_s=0.0)
    rng = np.random.default_rng([seed, turn, 5])
    leg, log_hz = random_leg(rng), timing.tick_hz / timing.log_every
    runs = [record(leg, rng, timing, seconds=SECONDS, name=f"run{k}") for k in range(RUNS)]
    return healthy(timing.between, timing, log_hz, 16384, leg, runs, factor * log_hz)


def page(minutes: float = 60.0, seed: int = 6200) -> Lines:
    there = [engine for engine in MODULES if engine not in missing()]
    kinds: list[str | float] = [*there, *FACTORS]
    cases = ((turn, kind) for turn in count() for kind in kinds)
    found = [of_engine(seed, turn, kind) if isinstance(kind, str) else of_rate(seed, turn, kind)
             for turn, kind in within(minutes, cases)]
    legs, rated = [one for one in found if not one.stated_hz], [one for one in found if one.stated_hz]
    yield from [
        "# Other engines and stated rates",
        f"Healthy legs of random parameters, {RUNS} runs of {SECONDS:g} s as CSV, answered by `legid fit` and `legid "
        "diagnose`. The rig file states no hold.",
        f"- Engines: {', '.join(there) or 'none is installed'}. A controller of {TICK_HZ:g} Hz holds its torque, open "
        "loop or by PD on the encoder."
        + "".join(f" {name} is not installed: its legs are left out." for name in missing()),
        f"- Legs of other engines that end `none`: {share(one.verdict == 'none' for one in legs)} (98 % wanted).",
        f"- Their fits say TRUST: {share(one.trust == 'TRUST' for one in legs)} (90 % wanted).",
        "- Their beta1 to beta5 within the intervals: "
        f"{share(w for one in legs for w in one.within[:5])} (93 to 97 % wanted).",
        f"- Their noise of torque within a factor of two of {TORQUE_NM:g} N m: "
        f"{share(0.5 <= one.torque_nm / TORQUE_NM <= 2.0 for one in legs)}.",
        f"- Legs under a stated rate that end `none`: {share(one.verdict == 'none' for one in rated)} (95 % wanted).",
        f"- Runs under a stated rate that say what it costs: {share(one.said for one in rated)}."]
    yield table("engine, or hold of `make timing` | loop | log [Hz] | counts | stated [Hz] | verdict | fit | "
                "of beta1 to 5 within | torque noise [N m]", map(_row, (*legs, *rated)))
    for factor in FACTORS:
        said = [one.said for one in rated if one.said and one.stated_hz == factor * one.log_hz]
        yield from (f'- At {factor:g} times the rate of the log, a run says: "{text}".' for text in said[:1])


def _row(one: Healthy) -> str:
    stated = f"{one.stated_hz:g}" if one.stated_hz else "-"
    return (f"{one.engine} | {one.loop} | {one.log_hz:g} | {one.counts} | {stated} | {one.verdict} | {one.trust} | "
            f"{sum(one.within[:5])} | {one.torque_nm:.4f}")


EVIDENCE = Evidence(
    "Are healthy legs of Pinocchio and PyBullet, and of records under another rate, left alone?",
    "make engines", "engines.md", 60, "98 % of other engines' legs none, 90 % TRUST; 95 % none at other rates",
    (r"other engines that end (`none`: [^(]* %)", r"fits say (TRUST: [^(]* %)",
              r"stated rate that end (`none`: [^(]* %)"))
main = program(page)
