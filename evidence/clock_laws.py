"""The controller's clock under simulated delay laws and oscillators: worst error, and whether the bound ever lied.

    python -m evidence clock-laws --runs 1000
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from daq.runs.streams import CLOCK
from daq.timing import fit_ticks
from evidence.frame import Lines, program, table

EPOCH = 7_000_000_000_000
SECONDS = 300.0
PINGS_HZ = 4.0
STALLS, LONGEST_STALL_S = 0.01, 0.02
TURNAROUND_S = 40e-6
Floats = NDArray[np.float64]


class Law(NamedTuple):
    """Delays [s] of n pings down and of their answers up, without stalls."""

    name: str
    down: Callable[[Generator, int], Floats]
    up: Callable[[Generator, int], Floats]
    allowed_s: float
    """Largest error that is called good; infinite where the hardware allows none."""


LAWS = (
    # The chip hands its bytes on when its latency timer runs out; the host asks once in a USB frame of 1 ms.
    Law("USB serial, 16 ms timer", lambda r, n: 0.2e-3 + r.uniform(0, 1e-3, n),
        lambda r, n: 0.2e-3 + r.uniform(0, 16e-3, n) + r.uniform(0, 1e-3, n), np.inf),
    Law("USB serial, 1 ms timer", lambda r, n: 0.15e-3 + r.uniform(0, 0.2e-3, n) + r.exponential(0.1e-3, n),
        lambda r, n: 0.2e-3 + r.uniform(0, 1e-3, n) + r.exponential(0.1e-3, n), 150e-6),
    Law("USB-ACM", lambda r, n: 0.08e-3 + r.exponential(60e-6, n), lambda r, n: 0.1e-3 + r.exponential(60e-6, n),
        50e-6),
    # A frame of 8 bytes at 1 Mbit/s takes 0.13 ms, and waits behind those under way.
    Law("CAN", lambda r, n: 0.1e-3 + r.exponential(30e-6, n), lambda r, n: 0.12e-3 + r.exponential(40e-6, n), 50e-6),
)


class Oscillator(NamedTuple):
    """The controller's: constant, linear and warming-up parts of its rate error [ppm]."""

    ppm: float
    drift_ppm: float
    warm_ppm: float
    warm_s: float
    first_tick: int

    def tick_us(self, t: Floats) -> NDArray[np.int64]:
        """Ticks, not wrapped, at host times [s]."""
        ahead = (self.ppm * t + 0.5 * self.drift_ppm * t**2 / SECONDS
                 + self.warm_ppm * self.warm_s * (1.0 - np.exp(-t / self.warm_s)))
        ticks: NDArray[np.int64] = np.floor(t * 1e6 + ahead).astype(np.int64) + self.first_tick
        return ticks


class Run(NamedTuple):
    """One simulated recording's outcome."""

    worst_s: float
    bound_s: float


def oscillator(rng: Generator) -> Oscillator:
    """40 to 200 ppm either way, drifting by up to 4 and warming up by up to 3 ppm; ticks wrap in most runs."""
    sign = float(rng.choice([-1.0, 1.0]))
    return Oscillator(sign * rng.uniform(40, 200), rng.uniform(-4, 4), rng.uniform(-3, 3), rng.uniform(60, 300),
                      int(2**32 - rng.uniform(0, 400e6)))


def simulate(law: Law, rng: Generator, start_s: float = 0.0, end_s: float = SECONDS) -> Run:
    """Pings over [start, end), the fit, and its worst error at 2 Hz over the same time."""
    clock = oscillator(rng)
    sent = np.arange(start_s, end_s, 1.0 / PINGS_HZ) + rng.uniform(0, 0.05)
    down, up = law.down(rng, sent.size), law.up(rng, sent.size)
    for way in (down, up):
        way += np.where(rng.random(sent.size) < STALLS, rng.uniform(0, LONGEST_STALL_S, sent.size), 0.0)
    arrived = sent + down
    left = arrived + TURNAROUND_S
    probes = np.zeros(sent.size, CLOCK.dtype)
    for field, at_s in (("host_tx_ns", sent), ("host_rx_ns", left + up)):
        probes[field] = EPOCH + np.rint(at_s * 1e9)
    for field, at_s in (("rx_tick_us", arrived), ("tx_tick_us", left)):
        probes[field] = clock.tick_us(at_s) % 2**32
    fit = fit_ticks(probes, EPOCH)
    t = np.arange(sent[0], sent[-1], 0.5)
    late = rng.uniform(0, LONGEST_STALL_S, t.size)  # telemetry is stamped when it arrives, which may be late
    times = fit.host_ns((clock.tick_us(t) % 2**32), (t + late) * 1e9) * 1e-9
    return Run(float(np.abs(times - t).max()), fit.bound_s)


def reboot(law: Law, rng: Generator) -> Run:
    """A controller that restarts in mid-run: two clocks, each fitted to its own part; the worse of both."""
    at = rng.uniform(30, SECONDS - 30)
    parts = [simulate(law, rng, 0.0, at), simulate(law, rng, at + 2.0, SECONDS)]
    return max(parts, key=lambda run: run.worst_s / run.bound_s)


def study(runs: int, seed: int) -> list[tuple[Law, list[Run], list[Run]]]:
    """(law, whole runs, runs with a reboot); a fifth as many of the latter."""
    rng = default_rng(seed)
    return [(law, [simulate(law, rng) for _ in range(runs)], [reboot(law, rng) for _ in range(runs // 5)])
            for law in LAWS]



def page(runs: int = 1000, seed: int = 1) -> Lines:
    yield from [
        "# The controller's clock under simulated delay laws",
        "300 s, pings at 4 Hz, 1 % stalls up to 20 ms each way, oscillators 40 to 200 ppm off, drifting and "
        "warming up. A fifth as many runs have a reboot in the middle. The laws are assumptions "
        "(`evidence/clock_laws.py`)."]
    rows = []
    for law, whole, broken in study(runs, seed):
        worst, bound = (1e6 * np.array([getattr(run, name) for run in whole]) for name in ("worst_s", "bound_s"))
        out = sum(run.worst_s > run.bound_s for run in [*whole, *broken])
        rows.append(f"{law.name} | {worst.max():.0f} | {np.median(worst):.0f} | {np.median(bound):.0f} | {out} of "
                    f"{len(whole) + len(broken)}")
    yield table("law | worst error [us] | median of runs' worst [us] | median bound [us] | outside the bound",
                rows)


main = program(page)
