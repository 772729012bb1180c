"""`make servos`: legs behind position loops, whose torque nobody measures: intervals, hidden causes, and a real servo.

MuJoCo moves the legs; the loop ticks at its own rate, reads an encoder of 12 bits, and its command, gain, delay and
limit are drawn. Called again the study goes on where it stopped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

import legid
from daq import Dataset, InputError, Rig, parse_rig
from estimator import FitError
from studies import machine
from tests.evidence import what_changed
from tests.evidence.blind.records import UNTOUCHED
from tests.evidence.blind.score import Rate
from tests.evidence.kept import kept
from tests.evidence.page_file import within, write_page
from tests.evidence.registry import Evidence
from tests.evidence.servo_bam import section
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.paths import REAL
from tests.support.servo_leg import ServoFaults, follow

SEED, RUNS, SECONDS = 7000, 8, 8.0
HIGH, AMPLITUDE = (2.2, 1.0, 1.6, 0.6), (0.9, 0.7, 0.5, 0.8)
RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\n'
Law = Callable[..., tuple[float, float]]


@dataclass(frozen=True)
class Hidden:
    """One cause, of a strength s near 1."""

    effect: str
    loop: Callable[[float], ServoFaults] = lambda s: ServoFaults()
    law: Callable[[float], Law | None] = lambda s: None
    logged: Callable[[dict[str, np.ndarray], float], None] = lambda columns, s: None
    also: tuple[str, ...] = ()
    """Other effects that are the same function of these records"""


def _scale_angle(columns: dict[str, np.ndarray], s: float) -> None:
    columns["q2_rad"] = columns["q2_rad"] * (1.0 + 0.05 * s)


CAUSES = (
    Hidden("none"), Hidden("command_delay", lambda s: ServoFaults(delay_s=0.02 * s)),
    Hidden("input_limit", lambda s: ServoFaults(limit=0.9 / s), also=("torque_saturation", "supply_sag")),
    Hidden("joint_stiffness", law=lambda s: lambda q1, q2, v1, v2, u: (0.0, -0.4 * s * (q2 - 0.2))), Hidden("none"),
    Hidden("command_dead_band", lambda s: ServoFaults(dead_band=0.03 * s)),
    Hidden("stribeck_friction", law=lambda s: lambda q1, q2, v1, v2, u: (
        0.0, -0.12 * s * math.tanh(v2 / 0.01) / (1.0 + (v2 / 0.15) ** 2)), also=("presliding_friction",)),
    Hidden("missing_integral", lambda s: ServoFaults(integral=3.0 * s)),
    Hidden("load_dependent_friction", law=lambda s: lambda q1, q2, v1, v2, u: (
        0.0, -0.2 * s * abs(u) * math.tanh(v2 / 0.01)), also=("load_stribeck_friction", "quadratic_load_friction")),
    Hidden("supply_sag", lambda s: ServoFaults(sag=0.25 * s), also=("torque_saturation", "input_limit")),
    Hidden("encoder_scale", logged=_scale_angle), Hidden("command_steps", lambda s: ServoFaults(
        step=math.radians(2.0))))
"""In the order of a round"""


class Drawn(NamedTuple):
    """A leg with its loop."""

    leg: Leg
    gain: float
    damping: float
    loop_hz: float
    delay_s: float


def draw(seed: int) -> Drawn:
    """Leg and loop of a seed."""
    rng = np.random.default_rng([seed, 1])
    leg = replace(random_leg(rng), viscous=(0.02, 0.03), coulomb=(0.01, 0.03 * rng.uniform(0.5, 1.5)))
    return Drawn(leg, rng.uniform(4.0, 12.0), rng.uniform(0.05, 0.25), float(rng.choice([1000.0, 500.0, 250.0])),
                 rng.uniform(0.0, 0.02))


def record(drawn: Drawn, seed: int, cause: Hidden = CAUSES[0], delay_s: float = 0.0) -> list[Dataset]:
    """Runs of the leg as its servo logs them."""
    strength = float(np.random.default_rng([seed, 2]).uniform(0.8, 1.2))
    faults = cause.loop(strength)
    found = []
    for k in range(RUNS):
        run = follow(drawn.leg, np.random.default_rng([seed, 3, k]), gain=drawn.gain, damping=drawn.damping,
                     loop_hz=drawn.loop_hz, seconds=SECONDS, amplitude=AMPLITUDE[k % 4], high=HIGH[k % 4],
                     faults=replace(faults, delay_s=faults.delay_s + delay_s), law=cause.law(strength),
                     name=f"r{k + 1}")
        columns = dict(run.columns)
        cause.logged(columns, strength)
        found.append(replace(run, columns=columns))
    return found


class Fit(NamedTuple):
    """Which of the nine intervals hold, the gain's with them, and the error of the delay [s]."""

    held: tuple[bool, ...]
    gain: bool
    delay_s: float
    failed: str = ""


@kept
def fit(seed: int) -> Fit:
    """A fit whose rig file says nothing of its servo, beta5 being given."""
    drawn = draw(seed)
    truth = drawn.leg.beta()
    truth[6] += drawn.damping  # a servo that damps is a joint with more viscous friction
    try:
        found = legid.fit(record(drawn, seed, delay_s=drawn.delay_s), parse_rig(RIG), fixed={"beta5": truth[4]})
    except (FitError, InputError) as error:
        return Fit((), False, 0.0, str(error))
    inside = tuple(bool(p["ci95"][0] <= value <= p["ci95"][1]) for p, value in zip(found.document["parameters"], truth)
                   if not p["fixed"])
    late = next((c["value"] for c in found.document["chosen"] if c["key"] == "delay_s"), 0.0)
    low, high = found.document["servo_gain"]["ci95"]
    return Fit(inside, low <= drawn.gain <= high, late - drawn.delay_s - 0.5 / drawn.loop_hz)


class Said(NamedTuple):
    """The answer of a diagnosis."""

    verdict: str
    causes: tuple[str, ...]
    error: tuple[float, float] | None
    wall_s: float


def rig_of(drawn: Drawn) -> Rig:
    """A rig file that states gain, damping and rate as they are."""
    return parse_rig(f"{RIG}gain = {drawn.gain}\ndamping = {drawn.damping}\nrate_hz = {drawn.loop_hz}\n")


@kept
def diagnose(which: int, seed: int) -> Said:
    """The diagnosis of one leg with one cause."""
    drawn = draw(seed)
    found = legid.diagnose(record(drawn, seed, CAUSES[which]), rig_of(drawn), workers=1)
    return Said(found.verdict, tuple(c.effect for c in found.causes), found.details.error, found.wall_s)


def rounds(seed: int) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Two fits, a diagnosis, and so on, each with a seed of its own."""
    turn = 0
    while True:
        yield "fit", (seed + 3 * turn,)
        yield "fit", (seed + 3 * turn + 1,)
        yield "diagnosis", (turn % len(CAUSES), seed + 3 * turn + 2)
        turn += 1


def page(minutes: float, records: float, seed: int) -> Iterator[str]:
    """The page, line by line."""
    fits: list[Fit] = []
    answers: list[tuple[Hidden, int, Said]] = []
    for kind, given in within(minutes, rounds(int(seed))):
        if kind == "fit":
            fits.append(fit(*given))
        else:
            answers.append((CAUSES[given[0]], given[1], diagnose(*given)))
        print(kind, given, fits[-1] if kind == "fit" else answers[-1], flush=True)
    yield from [
        "# Servos: legs that follow a command", "",
        f"Made by `make servos MINUTES={minutes:g} RECORDS={records:g} SEED={int(seed)}`, "
        f"{datetime.now(UTC):%Y-%m-%d}, {machine()}. Seeds from {int(seed)}.", "",
        f"MuJoCo moves the legs. The loop ticks at 250 to 1000 Hz and reads 12 bits a turn. {RUNS} runs of {SECONDS:g} "
        "s hold command and both angles. Intervals are Wilson's, 95 %.", "", *intervals(fits), "", *hidden(answers), "",
        *(chain(section(), [""], real(records)) if REAL.is_dir() else [
            "The records of a real servo are left out: ../shared/realdata is not next to the checkout."]), ""]


def intervals(fits: Sequence[Fit]) -> Iterator[str]:
    """Do the intervals hold, gain and delay unknown?"""
    good = [one for one in fits if not one.failed]
    held = [value for one in good for value in one.held]
    late = [abs(one.delay_s) for one in good]
    yield from ["## Gain and delay unknown", "",
                "The rig file states nothing of the servo, and `--fix` gives beta5. Gains are 4 to 12 N m/rad, delays "
                "0 to 20 ms. The viscous friction of the knee has the servo's damping in it.", "",
                "| | measured |", "| --- | --- |", f"| 95 % intervals of parameters that hold | {_rate(held)} |",
                f"| of the gain | {_rate([one.gain for one in good])} |",
                f"| median error of the delay | {1e3 * float(np.median(late)) if late else math.nan:.2g} ms |",
                f"| fits that end without an answer | {len(fits) - len(good)} of {len(fits)} |"]


def hidden(answers: Sequence[tuple[Hidden, int, Said]]) -> Iterator[str]:
    """What is said of hidden causes and of healthy legs?"""
    ill = [(cause, said) for cause, _, said in answers if cause.effect != "none"]
    well = [said.verdict == "none" for cause, _, said in answers if cause.effect == "none"]
    right = [cause.effect in said.causes for cause, said in ill]
    near = [bool({cause.effect, *cause.also} & set(said.causes)) for cause, said in ill]
    wrong = [bool(said.causes) and not {cause.effect, *cause.also} & set(said.causes) for cause, said in ill]
    yield from ["## Hidden causes", "", "The rig file states gain, damping and rate.", "", "| | measured |",
                "| --- | --- |", f"| hidden cause in the answer | {_rate(right)} |",
                f"| or one that is the same function here | {_rate(near)} |", f"| wrong names alone | {_rate(wrong)} |",
                f"| healthy legs `none` | {_rate(well)} |", "",
                "| hidden | seed | verdict | causes | error over noise: before, after | s |",
                "| --- | --- | --- | --- | --- | --- |"]
    for cause, seed, said in answers:
        error = "-" if said.error is None else ", ".join(f"{value:.3g}" for value in said.error)
        yield (f"| {cause.effect} | {seed} | {said.verdict} | {', '.join(said.causes) or '-'} | {error} "
               f"| {said.wall_s:.0f} |")


def real(minutes: float) -> Iterator[str]:
    """Faults put into the records of a real servo, against earlier runs, by fault and ratio."""
    found: dict[tuple[str, float], list[bool]] = {}
    quiet: list[bool] = []
    for case in within(minutes, (c for c in what_changed.cases() if c.record == "servo")):
        answer = what_changed.one(*case)
        if case.fault == UNTOUCHED:
            quiet.append(answer.verdict == "no_change")
        elif answer.verdict != "out of reach":
            found.setdefault((case.fault, case.ratio), []).append(case.fault in answer.causes)
        print(case, answer, flush=True)
    every = [value for values in found.values() for value in values]
    yield from ["## A real servo against its earlier runs", "",
                "Faults are put into the readings of the XL330 of `what-changed.md`, with its command as `q1_cmd_rad`. "
                "Their sizes raise the free-run error of the reference's model by the ratio.", "",
                "| fault | ratio | in the answer |", "| --- | ---: | --- |",
                *(f"| {fault} | {ratio:g} | {_rate(values)} |" for (fault, ratio), values in sorted(found.items())),
                f"| all | | {_rate(every)} |", f"| untouched `no_change` | | {_rate(quiet)} |"]


def _rate(values: Sequence[bool]) -> str:
    return str(Rate(sum(values), len(values))) if values else "-"


def _result(text: str) -> str:
    """Counts for the index."""
    rows = dict(line.strip("| ").rsplit(" | ", 1) for line in text.splitlines() if line.startswith("| ") and " = " in
                line)
    wanted = ("95 % intervals of parameters that hold", "hidden cause in the answer", "wrong names alone",
              "healthy legs `none`", "all |")
    found = [f"{name.rstrip(' |')} {rows[name].split(' (')[0]}" for name in wanted if name in rows]
    if len(found) < 4:
        raise ValueError("the page lacks its rates")
    return "; ".join(found)


EVIDENCE = (Evidence(
    "Legs behind position loops, without a torque: do intervals hold, are hidden causes found, and a real servo's?",
    "make servos", "servos.md", 15, "intervals 93 to 97 %; in the answer 90 %, wrong 3 %, healthy 98 %; the servo's "
    "faults 70 %", _result),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, minutes=(9.0, "of legs"), records=(6.0, "minutes of the real servo's records"),
               seed=(float(SEED), "first seed"))
