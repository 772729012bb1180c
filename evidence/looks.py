"""Looks at readings: false findings on healthy runs, faults put in one by one and in pairs, and clipped torque.

The legs are those of `known_legs` without anything hidden, and MuJoCo's. A fault is put into readings, never into the
plant.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng

from daq import Dataset, FloatArray, InputError, parse_rig
from daq.looks import look
from daq.runs import RawTable, read_csv
from daq.timing import align_table
from estimator import FitError
from evidence.frame import Lines, new_folder, program, table
from evidence.kept import kept
from evidence.known_legs import FAMILIES, HEALTHY, short
from evidence.registry import Evidence
from experiments.judge import fit_trust
from experiments.session import setup_of, with_lost_samples
from experiments.workflows import fit_runs
from tests.support.motions import ENCODERS, MOTIONS, healthy
from tests.support.mujoco_leg import multisine, random_leg, record
from tests.support.paths import REAL

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n[sampling]\nrate_hz = 100.0\n'
SHARES = (0.02, 0.05, 0.10, 0.15, 0.25, 0.40)
"""Of the samples that are clipped."""
SIDES = ("both sides", "one side")
WITHIN = 2.0
"""Largest error of beta1 to beta5 [%] that is aimed at up to 15 % of the samples."""
RATES_HZ = (10.0, 20.0, 50.0, 100.0, 250.0, 1000.0)
"""Of records of the kinds of motion."""
JUDGED, NAMED_LEGS = 5, 10
PLAIN_LEGS, PLAIN_RUNS = 15, 8


@kept
def found_in_healthy(family: str, seed: int) -> tuple[int, list[str]]:
    """Runs of one healthy leg, and what the looks found in their readings."""
    rng = default_rng([seed, list(FAMILIES).index(family)])
    with new_folder() as folder:
        leg = FAMILIES[family].make(HEALTHY, rng, folder)
    setup = setup_of(leg.runs, leg.rig)
    moved = with_lost_samples(setup.datasets, setup.mechanism, setup.options)
    return len(leg.runs), [*(f"{run.name}: {fault}" for run in leg.runs
                             for fault in look(run.time_s, run.columns).faults),
                           *(f"{run.name}: {fault}" for run in moved for fault in run.readings)]


def found_in_motions(kind: str, seed: int) -> list[str]:
    """What the looks found in records of one kind of motion, one a rate and an encoder; a wrap is no false finding."""
    found = []
    for rate_hz in RATES_HZ:
        for encoder in ENCODERS:
            time_s, columns = healthy(kind, rate_hz, encoder, seed, 20.0 if rate_hz < 1000.0 else 6.0)
            faults = look(time_s, columns, as_read=True).faults
            found += [f"{kind}, {rate_hz:g} Hz, {encoder}: {fault}" for fault in faults if fault.what != "wrapped"]
    return found


def found_in_records(folder: Path) -> tuple[int, list[str]]:
    """Public records below `folder`, and what the looks found in their readings."""
    files = sorted(folder.glob("*/*.csv.gz"))
    found = []
    for file in files:
        table = read_csv(file)
        found += [f"{file.parent.name}/{file.name}: {fault}" for fault in look(table.time_s, table.columns).faults]
    return len(files), found


@cache
def leg_run(seed: int, number: int = 0) -> Dataset:
    """MuJoCo's run of a leg drawn by `seed`."""
    leg, rng = random_leg(default_rng(seed)), default_rng([seed, number])
    return record(leg, rng, tau=multisine(rng, np.arange(2000) / 100.0, 1.2), name=f"run{number}")


Spoilt = tuple[str, FloatArray]
"""A column's name and its values with a fault."""


def wrapped(run: Dataset, rng: Generator, zero: float = 0.5) -> Spoilt:
    q = run["q2_rad"] + rng.uniform(-zero, zero)
    low = rng.uniform(*np.quantile(q, (0.05, 0.95)))
    return "q2_rad", low + (q - low) % (2.0 * np.pi)


def isolated(run: Dataset, rng: Generator) -> Spoilt:
    q = run["q2_rad"].copy()
    q[rng.integers(50, q.size - 50)] += rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 4.0)
    return "q2_rad", q


def stepped(run: Dataset, rng: Generator) -> Spoilt:
    q = run["q2_rad"].copy()
    q[rng.integers(300, q.size - 300):] += rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 1.5)
    return "q2_rad", q


def clipped(run: Dataset, rng: Generator) -> Spoilt:
    return "tau2_nm", cut_off(run["tau2_nm"], rng.uniform(0.03, 0.3), "both sides")


def frozen(run: Dataset, rng: Generator) -> Spoilt:
    gyro, first = run["gyro_radps"].copy(), rng.integers(100, len(run) - 100)
    gyro[first:first + rng.integers(15, 40)] = gyro[first]
    return "gyro_radps", gyro


def repeated(run: Dataset, rng: Generator) -> Spoilt:
    times = rng.integers(2, 5)
    return "q1_rad", run["q1_rad"][::times].repeat(times)[:len(run)]


Kind = Callable[[Dataset, Generator], Spoilt]
KINDS: dict[str, Kind] = {
    "wrapped": wrapped, "isolated": isolated, "stepped": stepped, "clipped": clipped, "frozen": frozen,
    "repeated": repeated}


def spoil(run: Dataset, rng: Generator, kinds: Sequence[str], makers: Mapping[str, Kind],
          columns: dict[str, FloatArray]) -> None:
    """Put the faults into columns of a run, one after the other."""
    for kind in sorted(kinds, key=lambda one: one == "wrapped"):  # a sensor's range is the last on the way
        name, values = makers[kind](Dataset(run.name, run.rate_hz, run.time_s, columns), rng)
        columns[name] = values


def named(seed: int, kinds: Sequence[str]) -> tuple[list[str], list[str]]:
    """The faults put into one run, one after the other, and those that the looks named."""
    run, rng = leg_run(seed), default_rng([seed, *map(list(KINDS).index, kinds)])
    columns = dict(run.columns)
    spoil(run, rng, kinds, KINDS, columns)
    try:
        faults = [str(fault.what) for fault in look(run.time_s, columns).faults]
    except InputError as error:
        faults = [f"refused: {error}"]
    return sorted(kinds), sorted(faults)


def lost(run: Dataset, rng: Generator) -> Spoilt:
    row, count, x = rng.integers(500, 1500), rng.integers(2, 7), run["tau2_nm"]
    return "tau2_nm", np.concatenate([x[:row], x[row + count:], np.full(count, x[-1])])


def turned(run: Dataset, rng: Generator) -> Spoilt:
    return wrapped(run, rng, 0.0)


def slow_knee(run: Dataset, rng: Generator) -> Spoilt:
    return "q2_rad", run["q2_rad"][::2].repeat(2)[:len(run)]


FITTED = {**KINDS, "wrapped": turned, "repeated": slow_knee, "lost": lost}
"""Kinds that are put into runs for a fit, by pairs."""


@kept
def fit_pair(seed: int, kinds: tuple[str, str]) -> "Fit":
    """A fit of two runs of one leg with two kinds of faults in each."""
    def put_in(number: int, run: Dataset, columns: dict[str, FloatArray]) -> None:
        spoil(run, default_rng([seed, number, *map(list(FITTED).index, kinds)]), kinds, FITTED, columns)

    return _fit(seed, put_in)


def cut_off(torque: FloatArray, share: float, sides: str) -> FloatArray:
    """A torque reading (n,) that ends where `share` of the samples are beyond."""
    if sides == SIDES[0]:
        level = float(np.quantile(np.abs(torque), 1.0 - share))
        return np.clip(torque, -level, level)
    return np.minimum(torque, float(np.quantile(torque, 1.0 - share)))


class Fit(NamedTuple):
    """A fit of two runs of which the torque is clipped."""

    errors: FloatArray
    """(5,) of beta1 to beta5 [%]"""
    widths: FloatArray
    """(5,) half widths of their 95 % intervals [%]"""
    sentence: str

    @property
    def worst(self) -> float:
        """Largest error [%]; NaN where there is none."""
        return float(np.max(np.nan_to_num(np.abs(self.errors)))) if np.isfinite(self.errors).any() else np.nan

    @property
    def trusted(self) -> bool:
        return self.sentence.startswith("TRUST")

    @property
    def wrong(self) -> bool:
        """Trusted, though a parameter is off by more than twice its half width and more than is aimed at."""
        beyond = np.abs(self.errors) > np.maximum(2.0 * self.widths, WITHIN)
        return self.trusted and bool(beyond.any())


@kept
def fit_clipped(seed: int, share: float, sides: str) -> Fit:
    """A fit of two runs."""
    def put_in(number: int, run: Dataset, columns: dict[str, FloatArray]) -> None:
        if share:
            columns["tau2_nm"] = cut_off(run["tau2_nm"], share, sides)

    return _fit(seed, put_in)


def _fit(seed: int, put_in: Callable[[int, Dataset, dict[str, FloatArray]], None]) -> Fit:
    """Of two runs of a leg, read as files are, after `put_in` has changed their columns."""
    truth, tables = random_leg(default_rng(seed)).beta()[:JUDGED], []
    for number in (1, 2):
        run = leg_run(seed, number)
        columns = {name: values for name, values in run.columns.items() if name != "q1_rad"}
        put_in(number, run, columns)
        tables.append(RawTable(run.name, run.time_s, columns))
    try:
        result = fit_runs([align_table(table, 100.0) for table in tables], parse_rig(RIG)).result
    except (FitError, InputError) as error:
        return Fit(np.full(JUDGED, np.nan), np.full(JUDGED, np.nan), f"refused: {error}")
    beta, half = result.beta[:JUDGED], result.half_width[:JUDGED]
    return Fit(100.0 * (beta / truth - 1.0), 100.0 * half / truth, fit_trust(result).sentence)


def page(legs: int = 4, seed: int = 6200, records: str = str(REAL)) -> Lines:
    yield "# Looks at readings"
    yield from _healthy(seed, Path(records))
    yield from _named(seed)
    yield from _pairs(seed)
    yield from _clipped(legs, seed)


def _pairs(seed: int) -> Iterator[str]:
    """Fits of ten legs with the kinds in pairs, one leg a pair in turn."""
    found = {kinds: fit_pair(seed + k % NAMED_LEGS, kinds) for k, kinds in enumerate(combinations(FITTED, 2))}
    yield from ["## Pairs of faults, with fits", "The same kinds, and samples of the torque that are lost, in "
                f"pairs. Each pair is in both runs of one of {NAMED_LEGS} legs.",
                f"**Pairs trusted wrongly: {sum(one.wrong for one in found.values())} of {len(found)} fits, "
                f"{sum(one.trusted for one in found.values())} of which are trusted.**"]
    yield table("put in | largest error | the fit's first line", (
        f"{' and '.join(kinds)} | {one.worst:.2f} % | {short(one.sentence)}" for kinds, one in found.items()))


def _healthy(seed: int, records: Path) -> Iterator[str]:
    plain = [leg_run(seed + k, number) for k in range(PLAIN_LEGS) for number in range(PLAIN_RUNS)]
    found = {family: found_in_healthy(family, seed) for family in FAMILIES}
    found["MuJoCo, an open-loop torque"] = len(plain), [
        f"{run.name}: {fault}" for run in plain for fault in look(run.time_s, run.columns).faults]
    for kind in MOTIONS:
        found[f"{kind}, {RATES_HZ[0]:g} to {RATES_HZ[-1]:g} Hz"] = (
            len(RATES_HZ) * len(ENCODERS), found_in_motions(kind, seed))
    if records.is_dir():
        found["public records"] = found_in_records(records)
    false = [text for _, told in found.values() for text in told]
    yield from ["## Healthy runs",
                f"**False findings: {len(false)} in {sum(count for count, _ in found.values())} healthy runs.**",
                *(f"- {text}" for text in false)]
    yield table("family | runs | findings", ((name, count, len(told)) for name, (count, told) in found.items()))


def _named(seed: int) -> Iterator[str]:
    rows, right = [], 0
    for kinds in (*((kind,) for kind in KINDS), *combinations(KINDS, 2)):
        found = [named(seed + k, kinds) for k in range(NAMED_LEGS)]
        good = sum(put == told for put, told in found)
        instead = sorted({", ".join(told) or "none" for put, told in found if put != told})
        rows.append(f"{' and '.join(kinds)} | {good} of {NAMED_LEGS} | {'; '.join(instead)}")
        right += good
    yield from ["## Faults put in, one and two at a time", "In runs of 20 s at 100 Hz of legs simulated by MuJoCo. "
                "An angle wraps by a turn, is off by 1 to 4 rad in one reading, or steps by 0.8 to 1.5 rad. A torque "
                "is clipped in 3 to 30 % of the samples. A gyro hangs for 15 to 40 samples. Readings are repeated 2 to "
                "4 times.", f"**Named exactly: {right} of {NAMED_LEGS * len(rows)}.**"]
    yield table("put in | named exactly | named instead", rows)


def _clipped(legs: int, seed: int) -> Iterator[str]:
    found = {(sides, share): [fit_clipped(seed + k, share, sides) for k in range(legs)]
             for sides in SIDES for share in (0.0, *SHARES)}
    every = [one for fits in found.values() for one in fits]
    few = [one.worst <= WITHIN for (_, share), fits in found.items() if 0.0 < share <= 0.15 for one in fits]
    yield from ["## Clipped torque", "Fits of two runs of 20 s of the same legs, without noise levels in the rig "
                "file. The torque reading ends where a share of the samples is beyond. Errors are those of beta1 to "
                "beta5.",
                f"**Trusted wrongly: {sum(one.wrong for one in every)} of {len(every)} fits. Up to 15 % of the samples "
                f"clipped, every parameter is within {WITHIN:g} % in {sum(few)} of {len(few)} fits.**"]
    yield table("clipped | samples | largest error of a leg, median | worst leg | intervals that hold | trusted | "
                "trusted wrongly", (
        f"{sides} | {100 * share:.0f} % | {np.nanmedian([one.worst for one in fits]):.2f} % | "
        f"{np.nanmax([one.worst for one in fits]):.2f} % | "
        f"{sum(int(np.sum(np.abs(one.errors) <= one.widths)) for one in fits)} of {JUDGED * legs} | "
        f"{sum(one.trusted for one in fits)} of {legs} | {sum(one.wrong for one in fits)}"
        for (sides, share), fits in found.items()))
    yield "Trusted wrongly: the first line says TRUST, and a parameter is off by more than 2 % and two half widths."


EVIDENCE = (
    Evidence("Do looks at readings find nothing in healthy runs?", "python -m evidence looks", "looks.md", 10,
             "none in 200 runs", (r"(False findings: \d+ in \d+) healthy runs",)),
    Evidence("Are faults of readings named, and is a clipped torque never trusted wrongly?",
             "python -m evidence looks", "looks.md", 10, "all named; no fit trusted wrongly; within 2 % to 15 %",
             (r"(Named exactly: \d+ of \d+)", r"(Trusted wrongly: \d+ of \d+) fits",
              r"(within 2 % in \d+ of \d+ fits)")),
    Evidence("Is a fit of runs with two kinds of faulty readings ever trusted wrongly?",
             "python -m evidence looks", "looks.md", 10, "never",
             (r"(Pairs trusted wrongly: \d+ of \d+) fits",)),
    Evidence("Do looks find nothing in files of other people's joints?", "python -m evidence looks",
             "real-files.md", 25, "none that alters a reading, at most 3 that only speak",
             (r"(alter a reading: \d+ of \d+) files", r"(only speak: \d+)"), resumes="by hand"))
main = program(page)
