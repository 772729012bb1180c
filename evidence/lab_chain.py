"""`make lab-chain`: a lab's signal chain, all small faults at once, with and without a spring at the pivot.

The plant is `tests/support/timed_leg`: torque held at 1 kHz, a log of 200 Hz, an IMU behind a low pass that is stamped
late. Faults of sensors are drawn with the standard deviations in FAULTS; `legid fit` and `legid diagnose` read the runs
as files, by a rig file that knows none of it.
"""

from dataclasses import replace
from itertools import count
from typing import NamedTuple

import numpy as np

from evidence.frame import Lines, program, share, table, within
from evidence.kept import kept
from evidence.known_legs import NAMES, answered
from evidence.registry import Evidence
from experiments.documents import finite
from tests.support.lab_readings import read_with
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record

RUNS, SECONDS = 4, 8.0
FAULTS = {"gyro_scale": 0.01, "accelerometer_bias.x": 0.1, "accelerometer_bias.y": 0.1, "imu_misalignment": 0.0087,
          "imu_lever_arm": 0.002, "torque_offset": 0.005}
"""1 sigma [SI]; in addition a torque constant 5 % off, and zeros of the encoder 3 mrad off."""
GAIN, ZERO_RAD = 0.05, 0.003
SPRING = 0.3
"""[N m/rad] at the pivot of every other leg."""
FAULTY = 2.0
"""Standard deviations beyond which a fault that is named is one."""
RESTS = ("none", "named", "one_of")
"""Verdicts whose model a user takes parameters from."""
IMUS = ((0.0, 0.0), (0.001, 100.0), (0.001, 50.0))
"""Age [s] and low pass [Hz] of the IMU, in turn."""


class Answer(NamedTuple):
    """One leg."""

    turn: int
    spring: float
    late: bool
    """Whether its IMU is."""
    within: tuple[bool, ...]
    """Whether each of beta1..9 is in the fit's interval."""
    diagnosed: tuple[bool, ...]
    """Likewise of the diagnosis' model, with the causes that it names."""
    worst: float
    """Largest error of beta1..5, the torque's scale apart [%]."""
    trust: str
    verdict: str
    causes: tuple[str, ...]
    true: tuple[bool, ...]
    """Whether each named cause is there beyond twice its standard deviation."""
    stiffness: tuple[float, float] | None
    """95 % interval of a named spring at the pivot."""
    error: tuple[float, float]


@kept
def answer(seed: int, turn: int) -> Answer:
    rng = np.random.default_rng([seed, turn])
    leg, (age_s, cutoff_hz) = random_leg(rng), IMUS[turn // 2 % len(IMUS)]
    spring = SPRING * (turn % 2)
    faults = {name: float(sigma * rng.normal()) for name, sigma in FAULTS.items()}
    gain, zero = 1.0 + GAIN * float(rng.normal()), ZERO_RAD * float(rng.normal())
    timing = Timing(1000.0, 5, imu_age_s=age_s, imu_cutoff_hz=cutoff_hz)
    runs = []
    for k in range(RUNS):
        run = read_with(record(leg, rng, timing, seconds=SECONDS, spring=spring, name=f"run{k}"), faults)
        columns = {name: values for name, values in run.columns.items() if name != "q1_rad"}
        columns |= {"tau2_nm": gain * run["tau2_nm"], "q2_rad": run["q2_rad"] + zero}
        runs.append(replace(run, columns=columns))
    fit, inside, trust, found, _ = answered(leg, runs)
    there = {name.partition(".")[0] for name, sigma in FAULTS.items() if abs(faults[name]) > FAULTY * sigma}
    there |= {name for name, is_there in (("encoder_offset", abs(zero) > FAULTY * ZERO_RAD),
                                          ("joint_stiffness", spring), ("sensor_time_skew", cutoff_hz)) if is_there}
    stiffness = next((s.ci95 for c in found.details.causes if (c.effect, c.joint) == ("joint_stiffness", 1)
                      for s in c.size if s.name == "stiffness"), None)
    values = dict(zip(fit.mechanism.names, fit.beta, strict=True))
    at = found.parameters.extended_ci95 or found.parameters.nominal_ci95
    diagnosed = tuple(finite(at[name][0]) <= b <= finite(at[name][1]) for name, b in zip(NAMES, leg.beta()))
    return Answer(turn, spring, cutoff_hz > 0.0, inside, diagnosed,
                  100.0 * max(abs(float(values[n] / (gain * b)) - 1.0) for n, b in zip(NAMES[:5], leg.beta()[:5])),
                  trust, found.verdict, tuple(c.effect for c in found.causes),
                  tuple(c.effect in there for c in found.causes), stiffness,
                  found.details.error or (np.nan, np.nan))


def page(minutes: float = 20.0, seed: int = 6500) -> Lines:
    found = [answer(seed, turn) for turn in within(minutes, count())]
    # of a set that runs do not tell apart one true cause is enough
    wrong = (not any(a.true) if a.verdict == "one_of" else not all(a.true) for a in found)
    trusted = [a for a in found if a.trust == "TRUST"]
    yield from [
        "# A lab's signal chain",
        "Legs of random parameters, integrated by Runge-Kutta at 8 kHz. All faults at once are drawn. Their standard "
        "deviations: torque constant 5 %, gyro scale 1 %, accelerometer 0.1 m/s², tilt 0.5 degrees, lever arm 2 mm, "
        "zero 3 mrad, shunt 5 mN m. Two of three IMUs are behind a low pass and stamped late. Every other leg has a "
        "spring of 0.3 N m/rad at its "
        f"pivot. `legid fit` and `legid diagnose` read {RUNS} runs of {SECONDS:g} s as CSV. The rig file states "
        "nothing of it.",
        f"- Answers with a name that is not there: {share(wrong)} (none wanted).",
        f"- Fits that say TRUST: {share(a.trust == 'TRUST' for a in found)}.",
        f"- Parameters of trusted fits within their intervals: {share(w for a in trusted for w in a.within)}, "
        f"beta1 to beta5 {share(w for a in trusted for w in a.within[:5])} (93 % wanted).",
        "- Parameters of the diagnosis' model within their intervals, where a verdict rests on it: "
        f"{share(w for a in found if a.verdict in RESTS for w in a.diagnosed)} (93 to 97 % wanted).",
        f"- Median of the largest error of beta1 to beta5, the torque's scale apart: "
        f"{float(np.median([a.worst for a in found])):.2g} %.",
        f"- Trusted fits more than 10 % off: {share(a.worst > 10.0 for a in trusted)} (none wanted).",
        "- Named springs within their intervals: "
        f"{share(a.stiffness[0] <= a.spring <= a.stiffness[1] for a in found if a.stiffness is not None)}.",
        "A name counts as there if the fault exceeds two standard deviations. A spring at a pivot that swings little "
        "is nearly the function of its gravity term; the error before says whether it is material."]
    yield table("leg | spring | IMU late | fit | within | largest error [%] | verdict | causes | error over noise",
                map(_row, found))


def _row(a: Answer) -> str:
    return (f"{a.turn} | {a.spring:g} | {'yes' if a.late else 'no'} | {a.trust} | {sum(a.within)} of {len(a.within)} | "
            f"{a.worst:.2g} | {a.verdict} | {', '.join(a.causes) or '-'} | {a.error[0]:.2f} to {a.error[1]:.2f}")


EVIDENCE = Evidence(
    "A lab's small faults all at once, with and without a spring: wrong names, and intervals that hold?",
    "make lab-chain", "lab-chain.md", 20, "no wrong name, 93 % of beta1 to beta5 within",
    (r"not (there: [^(]* %)", r"(TRUST: [^(]* %)", r"within their (intervals: [^(]* %)"))
main = program(page)
