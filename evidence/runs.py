"""`make runs`: what runs disagree about, and what intervals that allow for it cost and hold.

Emulated legs whose runs are alike, and whose friction, zeros or torque gain differ from run to run, beside the means
that made them; real records beside what is published of them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator, default_rng

from daq import Dataset, FloatArray, parse_rig
from estimator import FitError, FitOptions, FitResult, fit
from estimator.model import leg2
from evidence.blind import servo
from evidence.coverage import case
from evidence.frame import Lines, program, table, tell
from evidence.kept import kept
from evidence.registry import Evidence, shares
from evidence.untuned import RECORDS, paths_of
from experiments.session import load_runs
from experiments.workflows import fit_runs
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.paths import REAL

RUNS, RATE_HZ = 4, 100.0
KNEE = 0.05
"""Coulomb level of the knee over the peak torque."""
FRICTION, ZERO_RAD, GAIN = 0.2, 0.03, 0.03
"""Scatter between runs: of both Coulomb levels over themselves, of the knee's zero, of the torque's gain."""
Case = tuple[Leg, list[Dataset]]
Change = Callable[[Generator, Dataset], Dataset]


def by_servo(seed: int) -> Case:
    """A leg of MuJoCo's friction under a position servo, and its runs."""
    rng = default_rng([7, seed])
    dry = rng.uniform(0.02, 0.08)
    leg = replace(random_leg(rng), coulomb=(0.1 * dry, dry))
    bare = replace(leg, coulomb=(0.0, 0.0))
    runs = []
    for k in range(RUNS):
        columns = servo.record(bare, servo.Plant(), dry, rng, k, session_s=25.0 * k)
        noisy = {c: columns[c] + servo.NOISE.get(c, 0.0) * rng.normal(size=columns[c].size) for c in servo.COLUMNS[1:]}
        noisy["q2_rad"] = servo.counted(noisy["q2_rad"])
        runs.append(Dataset(f"run{k}", servo.RATE_HZ, columns["time_s"], noisy))
    return leg, runs


def changed(column: str, by: Callable[[Generator, FloatArray], FloatArray]) -> Change:
    return lambda rng, run: replace(run, columns={**run.columns, column: by(rng, run[column])})


CHANGES: dict[str, Change] = {
    f"knee's zero, {1e3 * ZERO_RAD:g} mrad": changed("q2_rad", lambda rng, q: q + ZERO_RAD * rng.normal()),
    f"torque's gain, {100 * GAIN:g} %": changed("tau2_nm", lambda rng, u: u * (1.0 + GAIN * rng.normal())),
}


@kept
def row(what: str, differ: str, sensors: str, cases: Sequence[Case]) -> str:
    """One line: how often runs disagree, coverage by the noise alone and now, and how much wider intervals are."""
    found = []
    for leg, runs in cases:
        try:
            one = fit(runs, leg2(lever_arm=leg.lever), FitOptions(sensors=sensors, hold="auto"))
        except FitError:
            continue
        if one.converged and one.agreement is not None:
            error = np.abs(one.beta - leg.beta())
            found.append((error < 1.959964 * one.own_std, error < one.half_width, one.widening,
                          bool(one.agreement.disagree)))
    alone, now, wider, told = zip(*found)
    held = [f"{100 * np.mean(x):.0f} % ({100 * np.mean(x, axis=0).min():.0f} %)" for x in (alone, now)]
    line = (f"{what} | {sensors} | {differ} | {len(found)}/{len(cases)} | {sum(told)} | {' | '.join(held)} | "
            f"{np.mean(wider):.2f}")
    tell(line)
    return line


def emulated(fits: int) -> Iterator[str]:
    """Rows of legs; half as many where runs differ, and of the slow plant."""
    half = -(-fits // 2)
    for closed in (False, True):
        what = f"dry friction, {'position' if closed else 'torque'}"
        alike = [case(seed, KNEE, closed, RATE_HZ, RUNS, 0.0) for seed in range(4000, 4000 + fits)]
        worn = [case(seed, KNEE, closed, RATE_HZ, RUNS, FRICTION) for seed in range(4100, 4100 + half)]
        for sensors in ("imu", "encoder"):
            yield row(what, "nothing", sensors, alike)
            yield row(what, f"Coulomb levels, {100 * FRICTION:g} %", sensors, worn)
            for differ, change in CHANGES.items():
                rng = default_rng(5)
                yield row(what, differ, sensors, [(leg, [change(rng, run) for run in runs])
                                                  for leg, runs in alike[:half]])
    yield row("MuJoCo, servo", "nothing", "imu", [by_servo(seed) for seed in range(half)])


def beyond(result: FitResult, published: Sequence[float], half: FloatArray) -> str:
    """Departures from what is published over half a 95 % interval."""
    return " ".join(f"{abs(b - p) / h:.1f}" for b, p, h in zip(result.beta, published, half))


@kept
def real(folder: str) -> tuple[str, list[str]]:
    """A record's row, and what its runs are seen to disagree about."""
    known = RECORDS[folder]
    rig = parse_rig(known.rig)
    result = fit_runs(load_runs(paths_of(folder), rig), rig).result
    found = result.agreement
    before = beyond(result, known.published, 1.959964 * result.own_std)
    if found is None or not found.disagree:
        return f"{known.title} | {len(known.runs)} | {before} | the same | ", []
    names = [f"{known.title} | {p.name} ({p.meaning}) | {mean:.4g} | {scatter:.2g} | {low:.4g} to {high:.4g}"
             for p, mean, scatter, low, high, seen in
             zip(result.mechanism.parameters, found.mean, found.scatter, found.by_run.min(axis=0),
                 found.by_run.max(axis=0), found.seen) if seen]
    departure = " ".join(f"{100 * (m / p - 1):+.1f}" for m, p in zip(found.mean, known.published))
    return (f"{known.title} | {len(known.runs)} | {before} | {beyond(result, known.published, result.half_width)} | "
            f"{departure}", names)


def page(fits: int = 24) -> Lines:
    yield from [
        "# Runs that differ", "What is fitted, and how: [theory](../theory.md#runs-that-differ).", "## Emulated legs",
        f"{RUNS} runs of 20 s at {RATE_HZ:g} Hz each; the knee's Coulomb level is {100 * KNEE:g} % of the peak torque. "
        "Coverage of the 95 % intervals over all parameters, and of the worst parameter in brackets; the truth is the "
        "mean that runs scatter about. The last column: how many times as wide as by noise alone, on average."]
    yield table("plant | sensors | differs between runs | fits | disagree | coverage by noise alone | coverage | "
                "wider", emulated(fits))
    rows = [real(folder) for folder in RECORDS] if REAL.is_dir() else []
    yield from ["## Real records, in one command without an option",
                "Distance of published and fitted values in half widths of the 95 % interval, in the mechanism's "
                "order. Beyond 3 an interval is too narrow. The last column is the departure of the mean over runs "
                "[%]."]
    yield table("record | runs | by noise alone | with what runs disagree about | mean over runs",
                (line for line, _ in rows))
    yield "What runs disagree about:"
    yield table("record | parameter | mean | scatter | by run", (line for _, lines in rows for line in lines))


EVIDENCE = Evidence(
    "Runs that differ: coverage of intervals that allow for it", "make runs FITS=24", "runs.md", 15,
    "95 % in every row",
    shares(r"\| \d+/\d+ \| \d+ \| \d+ % \(\d+ %\) \| (\d+) % \(", "% of the intervals hold, by row"))
main = program(page)
