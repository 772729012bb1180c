"""`make timing`: holds, delays and ages on legs whose controller, log and drive keep times of their own.

The plant is `tests/support/timed_leg`. Each leg is answered by `legid fit` and `legid diagnose` from files, by a rig
file that states no rate, no hold and no delay.
"""

from itertools import count
from typing import NamedTuple

import numpy as np

from estimator.model import lag
from evidence.frame import Lines, program, share, table, within
from evidence.kept import kept
from evidence.known_legs import answered
from evidence.registry import Evidence
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record

RUNS, SECONDS = 4, 10.0
TICKS_HZ = (50.0, 100.0, 200.0, 500.0, 1000.0)
LOGGED = (1, 2, 5)
SLOWEST_LOG_HZ, FASTEST_LOG_HZ = 40.0, 500.0
DELAYS_S = (0.0005, 0.02)
WORTH = 1.5
"""Errors of a free run over its noise from which on a delay is material."""


class Answer(NamedTuple):
    """One leg."""

    timing: Timing
    hold: str
    """Of the diagnosis, beyond which a delay is named."""
    within: tuple[bool, ...]
    """Whether each of beta1..9 is in the fit's interval."""
    trust: str
    verdict: str
    causes: tuple[str, ...]
    error: float
    """Of the nominal model's free runs, over their noise."""
    delay: tuple[float, float, float] | None
    """How long the torque acts after its hold says, with its interval [s]; None where no delay is named."""

    @property
    def unexplained_s(self) -> float:
        """How long after its hold says the torque acts."""
        return late(self.timing) - row_s(self.timing) * lag(self.hold)


def drawn(seed: int, turn: int) -> Timing:
    """The timing of a leg; every other one is healthy."""
    rng = np.random.default_rng([seed, turn, 1])
    while True:
        tick, every = float(rng.choice(TICKS_HZ)), int(rng.choice(LOGGED))
        if SLOWEST_LOG_HZ <= tick / every <= FASTEST_LOG_HZ:
            break
    delay = round(rng.uniform(*DELAYS_S), 4) if turn % 2 else 0.0
    loop = str(rng.choice(["open", "pd"]))
    between = "zero" if loop == "pd" else str(rng.choice(["zero", "ramp", "average"]))
    return Timing(tick, every, delay, between, loop)


def row_s(timing: Timing) -> float:
    """Time between two rows of the log [s]."""
    return timing.log_every / timing.tick_hz


def late(timing: Timing) -> float:
    """How long after its stamp the torque acts in the mean [s]."""
    tick, row = 1.0 / timing.tick_hz, row_s(timing)
    own = {"zero": 0.5 * tick, "ramp": 0.0, "average": 0.5 * tick - 0.5 * (row + tick)}[timing.between]
    return timing.delay_s + own


def cells(timing: Timing) -> str:
    """Of a row, for the titles TIMES."""
    return (f"{timing.tick_hz:g} | {1.0 / row_s(timing):g} | {timing.loop} | {timing.between} | "
            f"{1e3 * timing.delay_s:g}")


TIMES = "tick [Hz] | log [Hz] | loop | between ticks | delay [ms]"


@kept
def answer(seed: int, turn: int) -> Answer:
    timing = drawn(seed, turn)
    rng = np.random.default_rng([seed, turn, 2])
    leg = random_leg(rng)
    _, inside, trust, found, _ = answered(leg, [record(leg, rng, timing, seconds=SECONDS, name=f"run{k}")
                                                for k in range(RUNS)])
    delay = None
    for cause in found.details.causes:
        if cause.effect == "torque_delay":
            (size,) = (s for s in cause.size if s.name == "delay")
            delay = (-size.value, -size.ci95[1], -size.ci95[0])
    return Answer(timing, found.details.hold, inside, trust, found.verdict, tuple(c.effect for c in found.causes),
                  found.details.error[0] if found.details.error else np.nan, delay)


def page(minutes: float = 60.0, seed: int = 6000) -> Lines:
    found = [answer(seed, turn) for turn in within(minutes, count())]
    healthy = [a for a in found if a.timing.delay_s == 0.0]
    late_ones = [a for a in found if a.timing.delay_s != 0.0 and a.error > WORTH]
    named = [(a, a.delay) for a in late_ones if a.delay is not None]
    off = [(abs(d[0] - a.unexplained_s), abs(d[0] - a.unexplained_s) / row_s(a.timing)) for a, d in named]
    off_s, samples = np.median(off, axis=0) if off else (np.nan, np.nan)
    yield from [
        "# Holds and delays",
        "Legs of random parameters, integrated by Runge-Kutta at 8 kHz. A controller of 50 to 1000 Hz sets a torque, "
        "open loop or by PD on an encoder of 16,384 counts. A log keeps each, each second or each fifth tick. The "
        "torque is held, ramps, or is logged as the mean over the past row. Every other leg has a delay of up to 20 ms "
        f"that is no whole sample. `legid fit` and `legid diagnose` read {RUNS} runs of {SECONDS:g} s as CSV. The rig "
        "file states no rate, no hold and no delay.",
        f"- Healthy legs that end `none`: {share(a.verdict == 'none' for a in healthy)} (98 % wanted).",
        f"- Healthy legs whose fit says TRUST: {share(a.trust == 'TRUST' for a in healthy)}.",
        f"- Parameters of healthy legs within their intervals: {share(w for a in healthy for w in a.within)}, "
        f"beta1 to beta5 {share(w for a in healthy for w in a.within[:5])} (93 to 97 % wanted).",
        f"- Material delays that are named: {share(a.delay is not None for a in late_ones)} (90 % wanted).",
        "- Named delays within their intervals, given the hold that was chosen: "
        f"{share(d[1] <= a.unexplained_s <= d[2] for a, d in named)} (93 to 97 % wanted).",
        f"- Median error of named delays: {1e3 * off_s:.2g} ms, {samples:.2g} samples (0.05 wanted).",
        "A delay counts together with the hold: how long the torque acts after its stamp in the mean."]
    yield table(f"{TIMES} | hold | fit | verdict | causes | error over noise | delay found [ms]", map(_row, found))


def _row(a: Answer) -> str:
    delay = "-" if a.delay is None else "{:.2f} [{:.2f}, {:.2f}]".format(*(1e3 * d for d in a.delay))
    return (f"{cells(a.timing)} | {a.hold} | {a.trust} | {a.verdict} | {', '.join(a.causes) or '-'} | {a.error:.2f} | "
            f"{delay}")


EVIDENCE = Evidence(
    "Holds, delays and rates of a controller and its log: are healthy legs left alone, and delays right?",
    "make timing", "timing.md", 60, "98 % of healthy legs none, 90 % of delays named, to 0.05 samples",
    (r"Healthy legs that end (`none`: [^(]* %)", r"delays that are (named: [^(]* %)", r"ms, (\S+ samples)"))
main = program(page)
