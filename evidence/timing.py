"""`make timing`: holds, delays and ages on legs whose controller, log and drive keep times of their own.

The plant is `tests/support/timed_leg`. Each leg is answered by `legid fit` and `legid diagnose` from files, by a rig
file that states no rate, no hold and no delay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

import legid
from daq import load_rig
from daq.runs import write_csv
from estimator.model import lag
from evidence.blind.score import Rate
from evidence.kept import kept
from evidence.known_legs import NAMES
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from experiments.session import as_datasets
from studies import machine
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


def drawn(seed: int, turn: int) -> Timing:
    """The timing of a leg; every other one is healthy."""
    rng = np.random.default_rng([seed, turn, 1])
    while True:
        tick, every = float(rng.choice(TICKS_HZ)), int(rng.choice(LOGGED))
        if SLOWEST_LOG_HZ <= tick / every <= FASTEST_LOG_HZ:
            break
    delay = round(float(rng.uniform(*DELAYS_S)), 4) if turn % 2 else 0.0
    loop = str(rng.choice(["open", "pd"]))
    between = "zero" if loop == "pd" else str(rng.choice(["zero", "ramp", "average"]))
    return Timing(tick, every, delay, between, loop)


def late(timing: Timing) -> float:
    """How long after its stamp the torque acts in the mean [s]."""
    tick, row = 1.0 / timing.tick_hz, timing.log_every / timing.tick_hz
    own = {"zero": 0.5 * tick, "ramp": 0.0, "average": 0.5 * tick - 0.5 * (row + tick)}[timing.between]
    return timing.delay_s + own


@kept
def answer(seed: int, turn: int) -> Answer:
    timing = drawn(seed, turn)
    rng = np.random.default_rng([seed, turn, 2])
    leg = random_leg(rng)
    with TemporaryDirectory() as folder:
        files = [Path(folder) / f"run{k}.csv" for k in range(RUNS)]
        for k, file in enumerate(files):
            write_csv(record(leg, rng, timing, seconds=SECONDS, name=f"run{k}"), file)
        rig_file = Path(folder) / "rig.toml"
        rig_file.write_text(f'[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {leg.lever}\n',
                            encoding="utf-8")
        rig = load_rig(rig_file)
        runs = as_datasets(files, rig, False)
        fit = legid.fit(runs, rig)
        found_at = dict(zip(fit.mechanism.names, fit.ci95(), strict=True))  # a fit may have chosen further terms
        inside = tuple(bool(found_at[name][0] <= b <= found_at[name][1])
                       for name, b in zip(NAMES, leg.beta(), strict=True))
        found = legid.diagnose(runs, rig)
    delay = None
    for cause in found.details.causes:
        if cause.effect == "torque_delay":
            (size,) = (s for s in cause.size if s.name == "delay")
            delay = (-size.value, -size.ci95[1], -size.ci95[0])
    return Answer(timing, found.details.hold, inside, str(fit.trust).split(" the ")[0], found.verdict,
                  tuple(c.effect for c in found.causes),
                  found.details.error[0] if found.details.error else np.nan, delay)


def share(found: Sequence[bool]) -> str:
    """`k/n = p % (low to high)`."""
    return str(Rate(sum(found), len(found)))


def page(minutes: float, seed: int) -> Iterator[str]:
    """The page, line by line."""
    found = [answer(seed, turn) for turn in within(minutes, count())]
    healthy = [a for a in found if a.timing.delay_s == 0.0]
    late_ones = [a for a in found if a.timing.delay_s != 0.0 and a.error > WORTH]
    named = [a for a in late_ones if a.delay is not None]
    off = [abs(a.delay[0] + a.timing.log_every / a.timing.tick_hz * lag(a.hold) - late(a.timing)) for a in named
           if a.delay is not None]
    inside = [a.delay[1] <= late(a.timing) - a.timing.log_every / a.timing.tick_hz * lag(a.hold) <= a.delay[2]
              for a in named if a.delay is not None]
    samples = [o * a.timing.tick_hz / a.timing.log_every for o, a in zip(off, named, strict=True)]
    yield from [
        "# Holds and delays", "",
        f"Made by `make timing MINUTES={minutes:g} SEED={seed}` (seed {seed}), {datetime.now(UTC):%Y-%m-%d}, "
        f"{machine()}.", "",
        "Legs of random parameters, integrated by Runge-Kutta at 8 kHz. A controller of 50 to 1000 Hz sets a torque, "
        "open loop or by PD on an encoder of 16,384 counts. A log keeps each, each second or each fifth tick. The "
        "torque is held, ramps, or is logged as the mean over the past row. Every other leg has a delay of up to 20 ms "
        f"that is no whole sample. `legid fit` and `legid diagnose` read {RUNS} runs of {SECONDS:g} s as CSV. The rig "
        "file states no rate, no hold and no delay.", "",
        f"- Healthy legs that end `none`: {share([a.verdict == 'none' for a in healthy])} (98 % wanted).",
        f"- Healthy legs whose fit says TRUST: {share([a.trust == 'TRUST' for a in healthy])}.",
        f"- Parameters of healthy legs within their intervals: {share([w for a in healthy for w in a.within])}, "
        f"beta1 to beta5 {share([w for a in healthy for w in a.within[:5]])} (93 to 97 % wanted).",
        f"- Material delays that are named: {share([a.delay is not None for a in late_ones])} (90 % wanted).",
        f"- Named delays within their intervals, given the hold that was chosen: {share(inside)} (93 to 97 % wanted).",
        f"- Median error of named delays: {1e3 * float(np.median(off)) if off else np.nan:.2g} ms, "
        f"{float(np.median(samples)) if samples else np.nan:.2g} samples (0.05 wanted).", "",
        "A delay counts together with the hold: how long the torque acts after its stamp in the mean.", "",
        f"| {' | '.join(COLUMNS)} |", f"|{' --- |' * len(COLUMNS)}", *map(_row, found), ""]


COLUMNS = ("tick [Hz]", "log [Hz]", "loop", "between ticks", "delay [ms]", "hold", "fit", "verdict", "causes",
           "error over noise", "delay found [ms]")


def _row(a: Answer) -> str:
    """A line of the table."""
    t = a.timing
    delay = "-" if a.delay is None else "{:.2f} [{:.2f}, {:.2f}]".format(*(1e3 * d for d in a.delay))
    return (f"| {t.tick_hz:g} | {t.tick_hz / t.log_every:g} | {t.loop} | {t.between} | {1e3 * t.delay_s:g} | "
            f"{a.hold} | {a.trust} | {a.verdict} | {', '.join(a.causes) or '-'} | {a.error:.2f} | {delay} |")


EVIDENCE = (
    Evidence("Holds, delays and rates of a controller and its log: are healthy legs left alone, and delays right?",
             "make timing", "timing.md", 60, "98 % of healthy legs none, 90 % of delays named, to 0.05 samples",
             (r"Healthy legs that end (`none`: [^(]* %)", r"delays that are (named: [^(]* %)", r"ms, (\S+ samples)")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, minutes=(60.0, "most minutes"), seed=(6000, "of the random numbers"))
