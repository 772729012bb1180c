"""`make tuning`: rate, hold and delay that `legid tune` finds on legs whose controller and log keep times of their own.

The plant and the draw of its times are those of `make timing`. The rig file states half the rate of the record and a
hold that none of the records has.
"""

from collections.abc import Iterator
from itertools import count, islice
from typing import NamedTuple

import numpy as np

from daq import parse_rig
from daq.runs import write_csv
from estimator.model import lag
from evidence.frame import Lines, new_folder, program, share, table, within
from evidence.kept import kept
from evidence.registry import Evidence
from evidence.timing import TIMES, cells, drawn, late, row_s
from experiments.session import with_choices
from experiments.workflows import tune_runs
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record

RUNS, SECONDS = 4, 6.0
SLOWEST_HZ, FASTEST_HZ = 50.0, 250.0
STATED = "average"
NEAR = 0.1
"""Samples within which a torque acts as late as it does: half a sample is the difference between two holds."""


class Tuned(NamedTuple):
    """What was chosen for one leg."""

    timing: Timing
    rate_hz: float
    hold: str
    late_s: float
    """How long after its stamp the torque acts in the mean, by hold and delay"""
    errors: tuple[float, float]
    """Of the knee on held-out runs, before and after [rad]"""
    gains: tuple[float, ...]
    """Of rate, hold and delay"""


def timings(seed: int) -> Iterator[tuple[int, Timing]]:
    """Those of `make timing` whose records have a usual rate, and so that half of it holds the motion."""
    for turn in count():
        timing = drawn(seed, turn)
        if SLOWEST_HZ <= 1.0 / row_s(timing) <= FASTEST_HZ:
            yield turn, timing


@kept
def tuned(seed: int, turn: int) -> Tuned:
    timing = drawn(seed, turn)
    rng = np.random.default_rng([seed, turn, 3])
    leg = random_leg(rng)
    rig = parse_rig(f'[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {leg.lever}\n'
                    f'[sampling]\nrate_hz = {timing.tick_hz / timing.log_every / 2}\nhold = "{STATED}"\n')
    with new_folder() as folder:
        files = [folder / f"run{k}.csv" for k in range(RUNS)]
        for file in files:
            write_csv(record(leg, rng, timing, seconds=SECONDS, name=file.stem), file)
        found = tune_runs(files, rig)
    chosen = with_choices(rig, found.choices)
    rate_hz, stated = chosen.sampling.rate_hz, chosen.timing
    assert rate_hz is not None and found.before is not None and found.after is not None
    hold: str = chosen.sampling.hold
    if stated.control_period_s is not None:
        hold = f"zero/{round(1.0 / (rate_hz * stated.control_period_s))}"
    late_s = (stated.torque_delay_s or (0.0, 0.0))[0] + lag(hold) / rate_hz
    return Tuned(timing, rate_hz, hold, late_s, (float(found.before.rmse[-1]), float(found.after.rmse[-1])),
                 tuple(gain.share for gain in found.gains))


def right_rate(one: Tuned) -> bool:
    """Whether the rate is that of the record."""
    return abs(one.rate_hz * row_s(one.timing) - 1.0) < 1e-3


def right_time(one: Tuned) -> bool:
    """Whether the torque acts when it does, by hold and delay together."""
    return abs(one.late_s - late(one.timing)) < NEAR * row_s(one.timing)


def page(minutes: float = 20.0, legs: int = 20, seed: int = 6100) -> Lines:
    found = [tuned(seed, turn) for turn, _ in within(minutes, islice(timings(seed), legs))]
    yield from [
        "# Rate, hold and delay by `legid tune`",
        f"Legs of [holds and delays](timing.md) whose logs have {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, {RUNS} runs of "
        f"{SECONDS:g} s each. The rig file states half the rate of the record and the hold `{STATED}`, which acts half "
        "a sample earlier than a controller. Hold and delay count together: how long after its stamp the torque acts.",
        f"- Rate, and hold with delay to {NEAR:g} samples: "
        f"{share(right_rate(one) and right_time(one) for one in found)} (18 of 20 wanted).",
        f"- Rate alone: {share(map(right_rate, found))}. Hold with delay alone: {share(map(right_time, found))}.",
        "- Median error of the knee, after over before: "
        f"{np.median([one.errors[1] / one.errors[0] for one in found]):.2f}."]
    yield table(f"{TIMES} | acts after [ms] | rate | hold | acts after, found [ms] | knee before, after [mrad] | "
                "gains of rate, hold, delay [%]", map(_row, found))


def _row(one: Tuned) -> str:
    gains = ", ".join(f"{100 * gain:.0f}" for gain in one.gains)
    return (f"{cells(one.timing)} | {1e3 * late(one.timing):.2f} | {one.rate_hz:g} | {one.hold} | "
            f"{1e3 * one.late_s:.2f} | {1e3 * one.errors[0]:.1f}, {1e3 * one.errors[1]:.1f} | {gains}")


EVIDENCE = Evidence(
    "Does `legid tune` find rate, hold and delay of a record from a rig file with others?",
    "make tuning", "tuning.md", 20, "rate and hold of 18 of 20 records",
    (r"Rate, and hold with delay to 0.1 samples: ([^(]* %)", r"after over before: (\S+)\."))
main = program(page)
