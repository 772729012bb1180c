"""`make servos`: legs behind position loops, whose torque nobody measures: intervals, hidden causes, and a real servo.

MuJoCo moves the legs; the loop ticks at its own rate, reads an encoder of 12 bits, and its command, gain, delay and
limit are drawn. Called again the study goes on where it stopped.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from numpy.random import default_rng

import legid
from daq import Dataset, InputError, Rig, parse_rig
from estimator import FitError
from evidence import what_changed
from evidence.blind.records import UNTOUCHED
from evidence.blind.servo import Change, changed
from evidence.frame import Lines, program, share, table, tell, within
from evidence.kept import kept
from evidence.processor_time import within_processor_time
from evidence.registry import Evidence
from tests.support.mujoco_leg import GRAVITY, Leg, random_leg
from tests.support.paths import REAL
from tests.support.servo_leg import ServoFaults, follow

SEED, RUNS, SECONDS = 7000, 8, 8.0
HIDDEN = "hidden"
MOST_S, LATE = 300.0, "no answer in time"
"""Processor time of one diagnosis, and the verdict of one that takes longer"""
HIGH, AMPLITUDE = (2.2, 1.0, 1.6, 0.6), (0.9, 0.7, 0.5, 0.8)
RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\n'
Law = Callable[..., tuple[float, float]]


@dataclass(frozen=True)
class Hidden:
    """One cause, of a strength s near 1."""

    effect: str
    loop: Callable[[float], ServoFaults] = lambda s: ServoFaults()
    law: Callable[[float, Leg], Law | None] = lambda s, leg: None
    logged: Callable[[float], Change] = lambda s: lambda columns: None
    also: tuple[str, ...] = ()
    """Other effects that are the same function of these records"""


def _directional(s: float, leg: Leg) -> Law:
    """BAM's M5 in motion at the knee, by the motor's torque and by what gravity and rates do."""
    coupling, moment = float(leg.beta()[2]), float(leg.beta()[4])

    def law(q1: float, q2: float, v1: float, v2: float, u: float) -> tuple[float, float]:
        load = -(coupling * math.sin(q2) * v1**2 + moment * GRAVITY * math.sin(q1 + q2))
        return 0.0, -0.3 * s * abs(0.7 * u - 0.3 * load) * math.tanh(v2 / 0.01)

    return law


CAUSES = (
    Hidden("none"),
    Hidden("input_limit", lambda s: ServoFaults(limit=0.9 / s), also=("torque_saturation", "supply_sag")),
    Hidden("joint_stiffness", law=lambda s, leg: lambda q1, q2, v1, v2, u: (0.0, -0.4 * s * (q2 - 0.2))),
    Hidden("none"),
    Hidden("command_dead_band", lambda s: ServoFaults(dead_band=0.03 * s)),
    Hidden("stribeck_friction", law=lambda s, leg: lambda q1, q2, v1, v2, u: (
        0.0, -0.12 * s * math.tanh(v2 / 0.01) / (1.0 + (v2 / 0.15) ** 2)), also=("presliding_friction",)),
    Hidden("missing_integral", lambda s: ServoFaults(integral=3.0 * s)),
    # by the torque of the motor alone: to the directional law a share of zero of the load
    Hidden("load_dependent_friction", law=lambda s, leg: lambda q1, q2, v1, v2, u: (
        0.0, -0.2 * s * abs(u) * math.tanh(v2 / 0.01)), also=("load_stribeck_friction", "quadratic_load_friction",
                                                       "directional_load_friction")),
    Hidden("supply_sag", lambda s: ServoFaults(sag=0.25 * s), also=("torque_saturation", "input_limit")),
    Hidden("encoder_scale", logged=lambda s: changed("q2_rad", lambda q: q * (1.0 + 0.05 * s))),
    Hidden("encoder_scale", lambda s: ServoFaults(encoder_scale=0.15 * s)),
    Hidden("command_steps", lambda s: ServoFaults(step=math.radians(2.0))),
    Hidden("directional_load_friction", law=_directional),
    Hidden("command_delay", lambda s: ServoFaults(delay_s=0.02 * s)))
"""In the order of a round, the slowest to diagnose last"""


class Drawn(NamedTuple):
    """A leg with its loop."""

    leg: Leg
    gain: float
    damping: float
    loop_hz: float
    delay_s: float

    @property
    def late_s(self) -> float:
        """The delay in whole ticks, as the loop has it."""
        return round(self.delay_s * self.loop_hz) / self.loop_hz


def draw(seed: int) -> Drawn:
    """Leg and loop of a seed."""
    rng = default_rng([seed, 1])
    leg = replace(random_leg(rng), viscous=(0.02, 0.03), coulomb=(0.01, 0.03 * rng.uniform(0.5, 1.5)))
    return Drawn(leg, rng.uniform(4.0, 12.0), rng.uniform(0.05, 0.25), float(rng.choice([1000.0, 500.0, 250.0])),
                 rng.uniform(0.0, 0.02))


def record(drawn: Drawn, seed: int, cause: Hidden = CAUSES[0], delay_s: float = 0.0) -> list[Dataset]:
    """Runs of the leg as its servo logs them."""
    strength = float(default_rng([seed, 2]).uniform(0.8, 1.2))
    faults = cause.loop(strength)
    found = []
    for k in range(RUNS):
        run = follow(drawn.leg, default_rng([seed, 3, k]), gain=drawn.gain, damping=drawn.damping,
                     loop_hz=drawn.loop_hz, seconds=SECONDS, amplitude=AMPLITUDE[k % 4], high=HIGH[k % 4],
                     faults=replace(faults, delay_s=faults.delay_s + delay_s), law=cause.law(strength, drawn.leg),
                     name=f"r{k + 1}")
        columns = dict(run.columns)
        cause.logged(strength)(columns)
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
    return Fit(inside, low <= drawn.gain <= high, late - drawn.late_s - 0.5 / drawn.loop_hz)


class Value(NamedTuple):
    """One value of a loop, as it is and as a fit has it."""

    key: str
    true: float
    sought: bool
    """Whether the fit gives an interval"""
    found: bool
    """Whether it says that the runs show it"""
    low: float = 0.0
    high: float = 0.0


LOOPS = ("limit", "integral", "neither")
"""What the loop has beyond gain, damping and delay, in the order of a round"""


@kept
def values(which: int, seed: int) -> tuple[Value, ...] | None:
    """Values that a fit finds if the rig file states gain and rate alone; None without an answer."""
    drawn, rng = draw(seed), default_rng([seed, 4])
    limit, integral = rng.uniform(0.6, 1.2), rng.uniform(1.0, 4.0)
    faults = (ServoFaults(limit=limit), ServoFaults(integral=integral), ServoFaults())[which]
    rig = parse_rig(f"{RIG}gain = {drawn.gain}\nrate_hz = {drawn.loop_hz}\n")
    try:
        found = legid.fit(record(drawn, seed, Hidden("none", lambda s: faults), drawn.delay_s), rig)
    except (FitError, InputError):
        return None
    told = {one["key"]: one for one in found.document["loop"]}
    true = {"delay_s": drawn.late_s, "limit": faults.limit, "integral": faults.integral, "damping": drawn.damping}
    return tuple(Value(key, value, True, told[key]["found"], *told[key]["ci95"]) if key in told else
                 Value(key, value, False, False) for key, value in true.items())


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
    runs, rig = record(drawn, seed, CAUSES[which]), rig_of(drawn)
    found = within_processor_time(lambda: legid.diagnose(runs, rig, workers=1), MOST_S)
    if found is None:
        return Said(LATE, (), None, MOST_S)
    return Said(found.verdict, tuple(c.effect for c in found.causes), found.details.error, found.wall_s)


def rounds(seed: int, fits: bool) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """With `fits` a fit with the gain or with other values unknown, then a diagnosis, and so on, each with a seed of
    its own."""
    for turn in count():
        if fits and turn % 2:
            yield "values", (turn // 2 % len(LOOPS), seed + 2 * turn)
        elif fits:
            yield "fit", (seed + 2 * turn,)
        yield "diagnosis", (turn % len(CAUSES), seed + 2 * turn + 1)


def page(minutes: float = 9.0, records: float = 6.0, seed: int = SEED, only: str = "") -> Lines:
    gains, loops, answers = list[Fit](), list[tuple[Value, ...] | None](), list[tuple[Hidden, int, Said]]()
    for kind, given in within(minutes, rounds(seed, only != HIDDEN)):
        if kind == "fit":
            gains.append(fit(*given))
        elif kind == "values":
            loops.append(values(*given))
        else:
            answers.append((CAUSES[given[0]], given[1], diagnose(*given)))
        tell(kind, given, (gains if kind == "fit" else loops if kind == "values" else answers)[-1:])
    yield from [
        "# Servos: legs that follow a command",
        f"MuJoCo moves the legs. The loop ticks at 250 to 1000 Hz and reads 12 bits a turn. {RUNS} runs of {SECONDS:g} "
        "s hold command and both angles. Intervals are Wilson's, 95 %."]
    if only != HIDDEN:
        yield from intervals(gains)
        yield from of_loops(loops)
    yield from hidden(answers)
    yield "A real servo by its command is in [servo-laws](servo-laws.md)."
    if REAL.is_dir():
        yield from real(records)
    else:
        yield "The records of a real servo are left out: ../shared/realdata is not next to the checkout."


def intervals(fits: Sequence[Fit]) -> Iterator[str]:
    """Do the intervals hold, gain and delay unknown?"""
    good = [one for one in fits if not one.failed]
    late = [abs(one.delay_s) for one in good]
    yield from ["## Gain and delay unknown",
                "The rig file states nothing of the servo, and `--fix` gives beta5. Gains are 4 to 12 N m/rad, delays "
                "0 to 20 ms. The viscous friction of the knee has the servo's damping in it."]
    yield table(" | measured", [
        f"95 % intervals of parameters that hold | {share(value for one in good for value in one.held)}",
        f"of the gain | {share(one.gain for one in good)}",
        f"median error of the delay | {1e3 * float(np.median(late)) if late else math.nan:.2g} ms",
        f"fits that end without an answer | {len(fits) - len(good)} of {len(fits)}"])


def of_loops(loops: Sequence[tuple[Value, ...] | None]) -> Iterator[str]:
    """Do the intervals of a loop's own values hold, and are the values found?"""
    limited = [one for one in loops if one is not None and any(v.key == "limit" and v.true < math.inf for v in one)]
    every = [v for one in loops if one is not None for v in one if v.key != "damping" or one in limited]
    yield from ["## Values of the loop unknown",
                "The rig file states gain and rate. The loop damps by 0.05 to 0.25 N m s/rad and is 0 to 20 ms late. "
                "One in three has a limit of 0.6 to 1.2 N m, one an integral of 1 to 4 N m/(rad s). Damping counts for "
                "loops with a limit: below it, and without feedforward, damping is viscous friction."]
    rows = []
    for key, absent in (("delay_s", math.nan), ("limit", math.inf), ("integral", 0.0), ("damping", math.nan)):
        own = [value for value in every if value.key == key]
        there = [value.found for value in own if value.true != absent]
        missing = [not value.found for value in own if value.true == absent]
        held = [value.low <= value.true <= value.high for value in own if value.sought and value.true != math.inf]
        rows.append(f"{key} | {share(there)} | {share(missing)} | {share(held)}")
    yield table("value | present and found | absent and not found | 95 % intervals that hold", rows)
    yield f"{sum(one is None for one in loops)} of {len(loops)} fits end without an answer."


def hidden(answers: Sequence[tuple[Hidden, int, Said]]) -> Iterator[str]:
    """What is said of hidden causes and of healthy legs?"""
    ill = [(cause, said) for cause, _, said in answers if cause.effect != "none"]
    well = (said.verdict == "none" for cause, _, said in answers if cause.effect == "none")
    names = [({cause.effect}, {cause.effect, *cause.also}, set(said.causes)) for cause, said in ill]
    yield from ["## Hidden causes", "The rig file states gain, damping and rate. A diagnosis that takes "
                f"{MOST_S:.0f} s of processor time ends as `{LATE}`, and counts as one that names nothing."]
    yield table(" | measured", [
        f"hidden cause in the answer | {share(own & said for own, _, said in names)}",
        f"or one that is the same function here | {share(near & said for _, near, said in names)}",
        f"wrong names alone | {share(said and not near & said for _, near, said in names)}",
        f"healthy legs `none` | {share(well)}"])
    yield table("hidden | seed | verdict | causes | error over noise: before, after | s", (
        f"{cause.effect} | {seed} | {said.verdict} | {', '.join(said.causes) or '-'} | "
        f"{'-' if said.error is None else '{:.3g}, {:.3g}'.format(*said.error)} | {said.wall_s:.0f}"
        for cause, seed, said in answers))


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
        tell(case, answer)
    yield from ["## A real servo against its earlier runs",
                "Faults are put into the readings of the XL330 of `what-changed.md`, with its command as `q1_cmd_rad`. "
                "Their sizes raise the free-run error of the reference's model by the ratio."]
    yield table("fault | ratio | in the answer", [
        *(f"{fault} | {ratio:g} | {share(values)}" for (fault, ratio), values in sorted(found.items())),
        f"all | | {share(value for values in found.values() for value in values)}",
        f"untouched `no_change` | | {share(quiet)}"])


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


EVIDENCE = Evidence(
    "Legs behind position loops, without a torque: do intervals hold, are hidden causes found, and a real servo's?",
    "make servos", "servos.md", 15, "intervals 93 to 97 %; in the answer 90 %, wrong 3 %, healthy 98 %; the servo's "
    "faults 70 %", _result)
main = program(page)
