"""`make watch`: how often an unchanged leg alarms whose friction drifts with temperature, and how soon a change alarms.

Legs of an event-driven engine with set-valued friction. Coulomb and viscous friction of the knee follow a temperature
that rises and falls once an hour; the reference runs hold its range. Each change is as large as raises the free-run
error of the reference model by half. Called again it goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from daq import Dataset
from estimator import FitOptions
from estimator.change import Reference, Watch, learn_reference, start_watch
from estimator.model import leg2
from estimator.prediction import predict
from evidence.blind.stickslip import MAKERS
from evidence.kept import kept
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from studies import machine
from tests.support.mujoco_leg import random_leg
from tests.support.stick_slip_leg import PEAK_NM, move, sample

SEED, LEGS, REFERENCE = 4040, 4, 8
SECONDS, RATE_HZ = 20.0, 100.0
RUNS_AN_HOUR, PIECES = round(3600.0 / SECONDS), 3
"""An hour is measured in pieces."""
MOST_HOURS = 100
DRIFT = 0.15
"""Largest change of the knee's friction by temperature."""
FALSE_ALARMS = 0.01
"""Per hour."""
CHANGES = ("torque_delay", "torque_saturation", "torque_offset", "sensor_time_skew", "gyro_bias", "gyro_scale",
           "accelerometer_bias", "imu_misalignment", "encoder_offset", "encoder_scale", "encoder_eccentricity")
RAISE, HORIZON_S, HALVINGS = 1.5, 1.0, 6
MOST_RUNS = 6
"""Runs that a change is waited for."""


class Delay(NamedTuple):
    """One change of one leg."""

    strength: float
    seconds: float | None
    """Motion until the alarm; None without one."""
    raised: float
    """Free-run error over that without the change"""


def record(leg_number: int, run: int) -> Dataset:
    """Run of a leg: the reference from -REFERENCE on over the whole range of temperatures, others by the time."""
    rng = np.random.default_rng([SEED, leg_number])
    leg = replace(random_leg(rng), coulomb=(0.01, float(rng.uniform(0.02, 0.06)) * PEAK_NM))
    own = np.random.default_rng([SEED, leg_number, run + REFERENCE])
    part = run / REFERENCE if run < 0 else run / RUNS_AN_HOUR
    factor = 1.0 + DRIFT * np.sin(2.0 * np.pi * part)
    warm = replace(leg, coulomb=(leg.coulomb[0], leg.coulomb[1] * factor),
                   viscous=(leg.viscous[0], leg.viscous[1] * factor))
    motion = move(warm, own, seconds=SECONDS, closed=run % 2 == 1, high=(3.0, 2.0, 1.2, 2.5)[run // 2 % 4])
    return sample(motion, own, RATE_HZ, name=f"run{run}")


@cache
def reference_of(leg_number: int) -> tuple[Reference, Watch]:
    """A leg's reference and its test."""
    rng = np.random.default_rng([SEED, leg_number])
    runs = [without_pivot(record(leg_number, k)) for k in range(-REFERENCE, 0)]
    found = learn_reference(runs, leg2(lever_arm=random_leg(rng).lever), FitOptions(sensors="imu"))
    return found, start_watch(found, FALSE_ALARMS, runs)


def without_pivot(run: Dataset) -> Dataset:
    """The run as a leg without an encoder at its pivot reads it."""
    return replace(run, columns={k: v for k, v in run.columns.items() if k != "q1_rad"})


@kept
def unchanged(leg_number: int, piece: int) -> list[float]:
    """False alarms per hour that each run's strongest block reaches, over a third of an hour without a change."""
    test, count = replace(reference_of(leg_number)[1], recent=[]), RUNS_AN_HOUR // PIECES
    found = [test.test(without_pivot(record(leg_number, piece * count + k))) for k in range(count)]
    return [one.worst.per_hour if one.worst else 0.0 for one in found]


@kept
def delay(leg_number: int, name: str, first: int) -> Delay:
    """How long a change of the readings from run `first` on is there before its alarm."""
    found, test = reference_of(leg_number)
    test = replace(test, recent=[])
    plain = [without_pivot(record(leg_number, first + k)) for k in range(MOST_RUNS)]
    maker = MAKERS[name][0]

    def error(strength: float) -> float:
        model = found.fit.model
        table = predict([model], [spoilt(run, maker(strength)) for run in plain[:2]], found.fit.options, (HORIZON_S,))
        return float(np.mean([np.log(table.rms(0, c, HORIZON_S)) for c in table.judged]))

    begin, low, high = error(0.0), 0.0, 8.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if error(middle) - begin > np.log(RAISE) else (middle, high)
    past = 0.0
    for run in plain:
        alarm = test.test(spoilt(run, maker(high))).alarm
        if alarm is not None:
            return Delay(high, past + alarm.end_s, float(np.exp(error(high) - begin)))
        past += SECONDS
    return Delay(high, None, float(np.exp(error(high) - begin)))


def spoilt(run: Dataset, change: Callable[[dict[str, np.ndarray]], None]) -> Dataset:
    """The run with the change in its readings."""
    columns = {"time_s": run.time_s.copy(), **{k: v.copy() for k, v in run.columns.items()}}
    change(columns)
    del columns["time_s"]
    return replace(run, columns=columns)


def page(legs: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    rows = [(name, k, delay(k, name, 40 * RUNS_AN_HOUR + 23 * k)) for name in CHANGES for k in range(legs)]
    level = np.concatenate([unchanged(k % LEGS, k // LEGS) for k in within(minutes, range(PIECES * MOST_HOURS))])
    hours = level.size / RUNS_AN_HOUR
    known = [row for row in rows if row[2].raised > 1.3]
    soon = sum(row[2].seconds is not None and row[2].seconds <= 20.5 for row in known)
    yield from [
        "# Watching a rig", "",
        f"Made by `make watch MINUTES={minutes:g} LEGS={legs}` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, "
        f"{machine()}.",
        "", f"Legs of another engine, {REFERENCE} reference runs of {SECONDS:g} s. The knee's friction drifts by "
        f"{100 * DRIFT:g} % with temperature, once up and down an hour, in the reference, too.",
        f"The threshold allows {FALSE_ALARMS:g} false alarms an hour. Each change raises the free-run error over "
        f"{HORIZON_S:g} s by {RAISE:g} or a little more.", "",
        "| | measured | wanted |", "| --- | --- | --- |",
        f"| false alarms of unchanged legs | {an_hour((level < FALSE_ALARMS).sum(), hours)} | at most 0.01 an hour |",
        f"| runs beyond a threshold of 1 an hour | {an_hour((level < 1.0).sum(), hours)} | at most 1 an hour |",
        f"| runs beyond a threshold of 10 an hour | {an_hour((level < 10.0).sum(), hours)} | at most 10 an hour |",
        f"| changes found within 20 s of motion | {soon} of {len(known)} | 90 % |", "",
        "| change | found within 20 s | later | never | seconds, median | error raised by, median | size, median |",
        "| --- | --- | --- | --- | --- | --- | --- |"]
    for name in CHANGES:
        own = [d for other, _, d in known if other == name]
        if not own:
            yield f"| {name} | - | - | - | - | not raised by half at any size tried | - |"
            continue
        times = [d.seconds for d in own if d.seconds is not None]
        early = sum(t <= 20.5 for t in times)
        yield (f"| {name} | {early} of {len(own)} | {len(times) - early} | {len(own) - len(times)} | "
               f"{f'{np.median(times):.0f}' if times else '-'} | {np.median([d.raised for d in own]):.2f} | "
               f"{np.median([d.strength for d in own]):.3g} |")
    yield from ["", "A size of 1 is that of `evidence/blind/stickslip.py`: 10 ms of delay, 0.06 N m of torque "
                "offset.", ""]


def an_hour(count: int, hours: float) -> str:
    """`count` in so many hours, and the rate with its exact 95 % interval for a Poisson number."""
    low, high = (chi2.ppf(p, 2 * n) / 2 / hours if n else 0.0 for p, n in ((0.025, count), (0.975, count + 1)))
    return f"{count} in {hours:.1f} h ({count / hours:.2g} an hour, {low:.2g} to {high:.2g})"


EVIDENCE = (
    Evidence("Watching a rig: false alarms under drift, and delay until a change alarms", "make watch",
             "watch.md", 25, "at most 1 false alarm in 100 h, 90 % of changes within 20 s",
             (r"false alarms of unchanged legs \| ([^|]*\))",
              r"changes (found within 20 s) of motion \| (\d+ of \d+)")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, legs=(2, "on which each change is tried"),
               minutes=(20.0, "after which no other twenty minutes of motion without a change are begun"))
