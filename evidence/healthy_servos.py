"""`python -m evidence healthy-servos`: legs behind position loops in three simulators, without any fault.

Gain, damping, delay and limit are drawn. Called again the study goes on where it stopped.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import legid
from daq import InputError, parse_rig
from estimator import FitError
from evidence.frame import Lines, program, share, table, tell, within
from evidence.kept import kept
from evidence.registry import Evidence
from evidence.servos import AMPLITUDE, HIGH, RIG, RUNS, SECONDS
from tests.support.mujoco_leg import random_leg
from tests.support.servo_plants import STEP_S, Loop, record, there

LEGS, SEED = 40, 91000
TRUSTED = "good", "caution"
"""Levels of trust that are not DO NOT TRUST"""


class Answer(NamedTuple):
    """What is said of one leg."""

    plant: str
    log_hz: float
    loop: Loop
    trust: str
    """Level of the first line of a fit whose rig file states no delay, or why there is no fit"""
    beta: tuple[bool, ...] = ()
    """Whether each interval holds"""
    delay: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """Value and interval by the fit [s]"""
    verdict: str = ""
    """Of a diagnosis whose rig file states the delay"""
    causes: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the delay is in its interval."""
        return self.delay[1] <= self.loop.delay_s <= self.delay[2]

    @property
    def off(self) -> float:
        """Error of the delay in samples of the log."""
        return abs(self.delay[0] - self.loop.delay_s) * self.log_hz


@kept
def healthy(seed: int, turn: int, plant: str) -> Answer:
    """A fit that is to find the delay, and a diagnosis that is to find nothing."""
    rng = np.random.default_rng([seed, turn])
    leg = replace(random_leg(rng), viscous=(0.02, 0.03), coulomb=(0.01, 0.03 * rng.uniform(0.5, 1.5)))
    loop = Loop(rng.uniform(4.0, 12.0), rng.uniform(0.05, 0.25), rng.uniform(0.8, 1.5) if turn % 2 else math.inf,
                float(rng.choice([1000.0, 500.0, 250.0])), STEP_S * round(rng.uniform(0.0, 0.02) / STEP_S))
    log_hz = float(rng.choice([50.0, 100.0, 200.0]))
    runs = [record(plant, leg, loop, rng, log_hz=log_hz, seconds=SECONDS, amplitude=AMPLITUDE[k % 4],
                   high=HIGH[k % 4], name=f"r{k + 1}") for k in range(RUNS)]
    rig = f"{RIG}gain = {loop.gain}\ndamping = {loop.damping}\nrate_hz = {loop.tick_hz}\n"
    rig += f"limit = {loop.limit}\n" if loop.limit < math.inf else ""
    answer = Answer(plant, log_hz, loop, "")
    try:
        found = legid.fit(runs, parse_rig(rig)).document
    except (FitError, InputError) as error:
        return answer._replace(trust=str(error))
    delay = next((one for one in found["loop"] if one["key"] == "delay_s"), None)
    beta = tuple(bool(p["ci95"][0] <= true <= p["ci95"][1]) for p, true in zip(found["parameters"], leg.beta()))
    said = legid.diagnose(runs, parse_rig(f"{rig}delay_s = {loop.delay_s}\n"), workers=1)
    return answer._replace(trust=found["trust"]["level"], beta=beta, verdict=said.verdict,
                           delay=answer.delay if delay is None else (delay["value"], *delay["ci95"]),
                           causes=tuple(cause.effect for cause in said.causes))


def page(minutes: float = 30.0, legs: int = LEGS, seed: int = SEED) -> Lines:
    plants, found = there(), list[Answer]()
    for turn in within(minutes, range(legs)):
        found.append(healthy(seed, turn, plants[turn % len(plants)]))
        tell(found[-1])
    sought = [one for one in found if not math.isnan(one.delay[0])]
    yield from [
        "# Healthy servos",
        f"Legs are moved by: {', '.join(plants)}; {RUNS} runs of {SECONDS:g} s each. The loop ticks at 250 to 1000 Hz "
        "and reads 12 bits a turn; its command is up to 20 ms late. Every other loop has a limit of 0.8 to 1.5 N m. "
        "The log has 50, 100 or 200 rows a second. The rig file states gain, damping, rate and limit, and for the "
        "diagnosis the delay."]
    yield table(" | measured | wanted", [
        f"fits with an answer that is not DO NOT TRUST | {share(one.trust in TRUSTED for one in found)} | all",
        f"diagnoses that end `none` | {share(one.verdict == 'none' for one in found)} | all",
        f"legs with a cause | {sum(map(bool, (one.causes for one in found)))} of {len(found)} | 0",
        f"delays within their intervals | {share(one.holds for one in sought)} | 93 to 97 %",
        f"median error of the delay | {np.median([one.off for one in sought]):.2g} samples | 0.05",
        f"parameters within their intervals | {share(held for one in found for held in one.beta)} | 93 to 97 %"])
    yield table("moved by | log [Hz] | tick [Hz] | limit [N m] | delay [ms] | fit | by the fit [ms] | verdict | causes",
                map(_row, found))


def _row(one: Answer) -> str:
    value, low, high = (1e3 * x for x in one.delay)
    loop = f"{one.loop.tick_hz:g} | {one.loop.limit:.3g} | {1e3 * one.loop.delay_s:.3g}"
    delay = f"{value:.4g} [{low:.4g}, {high:.4g}]"
    names = ", ".join(one.causes) or "-"
    return f"{one.plant} | {one.log_hz:g} | {loop} | {one.trust} | {delay} | {one.verdict} | {names}"


EVIDENCE = Evidence(
    "Are healthy legs behind position loops trusted, given no cause, and their delays found?",
    "python -m evidence healthy-servos", "healthy-servos.md", 15, "no refusal, no cause; delays 93 to 97 %, error 0.05 "
    "samples", (r"answer that is not DO NOT TRUST \| (\d+/\d+)", r"end `none` \| (\d+/\d+)",
                r"(delays) within their intervals \| (\d+/\d+)", r"error of the delay \| (\S+ samples)"))
main = program(page)
