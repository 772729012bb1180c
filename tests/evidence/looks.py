"""Looks at readings: false findings on healthy runs, faults put in one by one and in pairs, and clipped torque.

The legs are those of `known_legs` without anything hidden, and MuJoCo's. A fault is put into readings, never into the
plant.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray, InputError, load_rig
from daq.looks import look
from daq.runs import RawTable, read_csv
from daq.timing import align_table
from estimator import FitError
from experiments.judge import fit_trust
from experiments.session import setup_of, with_lost_samples
from experiments.workflows import fit_runs
from studies import machine
from tests.evidence.kept import kept
from tests.evidence.known_legs import FAMILIES, HEALTHY
from tests.evidence.registry import Evidence
from tests.support.motions import ENCODERS, MOTIONS, healthy
from tests.support.mujoco_leg import multisine, random_leg, record
from tests.support.paths import ROOT

PAGE = ROOT / "docs/evidence/looks.md"
RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n[sampling]\nrate_hz = 100.0\n'
SHARES = (0.02, 0.05, 0.10, 0.15, 0.25, 0.40)
"""Of the samples that are clipped."""
SIDES = ("both sides", "one side")
WITHIN = 2.0
"""Largest error of beta1 to beta5 [%] that is aimed at up to 15 % of the samples."""
RATES_HZ = (10.0, 20.0, 50.0, 100.0, 250.0, 1000.0)
"""Of records of the kinds of motion."""
JUDGED, NAMED_LEGS = 5, 10
FAMILY_LEGS, PLAIN_LEGS, PLAIN_RUNS = 1, 15, 8


@kept
def found_in_healthy(family: str, seed: int) -> tuple[int, list[str]]:
    """Runs of one healthy leg, and what the looks found in their readings."""
    rng = np.random.default_rng([seed, list(FAMILIES).index(family)])
    with tempfile.TemporaryDirectory() as folder:
        leg = FAMILIES[family].make(HEALTHY, rng, Path(folder))
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
    leg, rng = random_leg(np.random.default_rng(seed)), np.random.default_rng([seed, number])
    return record(leg, rng, tau=multisine(rng, np.arange(2000) / 100.0, 1.2), name=f"run{number}")


def wrapped(run: Dataset, rng: np.random.Generator, zero: float = 0.5) -> tuple[str, FloatArray]:
    q = run["q2_rad"] + rng.uniform(-zero, zero)
    low = float(rng.uniform(*np.quantile(q, (0.05, 0.95))))
    return "q2_rad", low + (q - low) % (2.0 * np.pi)


def isolated(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    q = run["q2_rad"].copy()
    q[rng.integers(50, q.size - 50)] += rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 4.0)
    return "q2_rad", q


def stepped(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    q = run["q2_rad"].copy()
    q[int(rng.integers(300, q.size - 300)):] += rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 1.5)
    return "q2_rad", q


def clipped(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    return "tau2_nm", cut_off(run["tau2_nm"], float(rng.uniform(0.03, 0.3)), "both sides")


def frozen(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    gyro, first = run["gyro_radps"].copy(), int(rng.integers(100, len(run) - 100))
    gyro[first:first + int(rng.integers(15, 40))] = gyro[first]
    return "gyro_radps", gyro


def repeated(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    times = int(rng.integers(2, 5))
    return "q1_rad", run["q1_rad"][::times].repeat(times)[:len(run)]


KINDS: dict[str, Callable[[Dataset, np.random.Generator], tuple[str, FloatArray]]] = {
    "wrapped": wrapped, "isolated": isolated, "stepped": stepped, "clipped": clipped, "frozen": frozen,
    "repeated": repeated}


def named(seed: int, kinds: Sequence[str]) -> tuple[list[str], list[str]]:
    """The faults put into one run, one after the other, and those that the looks named."""
    run, rng = leg_run(seed), np.random.default_rng([seed, *map(list(KINDS).index, kinds)])
    columns = dict(run.columns)
    for kind in sorted(kinds, key=lambda one: one == "wrapped"):  # a sensor's range is the last on the way
        name, values = KINDS[kind](Dataset(run.name, run.rate_hz, run.time_s, columns), rng)
        columns[name] = values
    try:
        faults = [str(fault.what) for fault in look(run.time_s, columns).faults]
    except InputError as error:
        faults = [f"refused: {error}"]
    return sorted(kinds), sorted(faults)


def lost(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    row, count, x = int(rng.integers(500, 1500)), int(rng.integers(2, 7)), run["tau2_nm"]
    return "tau2_nm", np.concatenate([x[:row], x[row + count:], np.full(count, x[-1])])


def turned(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    return wrapped(run, rng, 0.0)


def slow_knee(run: Dataset, rng: np.random.Generator) -> tuple[str, FloatArray]:
    return "q2_rad", run["q2_rad"][::2].repeat(2)[:len(run)]


FITTED = {**KINDS, "wrapped": turned, "repeated": slow_knee, "lost": lost}
"""Kinds that are put into runs for a fit, by pairs."""


@kept
def fit_pair(seed: int, kinds: tuple[str, str]) -> Fit:
    """A fit of two runs of one leg with two kinds of faults in each, read as files are."""
    runs = []
    for number in (1, 2):
        run, rng = leg_run(seed, number), np.random.default_rng([seed, number, *map(list(FITTED).index, kinds)])
        columns = {name: values for name, values in run.columns.items() if name != "q1_rad"}
        for kind in sorted(kinds, key=lambda one: one == "wrapped"):  # a sensor's range is the last on the way
            name, values = FITTED[kind](Dataset(run.name, run.rate_hz, run.time_s, columns), rng)
            columns[name] = values
        runs.append(RawTable(run.name, run.time_s, columns))
    return _fit(seed, runs)


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
    def trusted(self) -> bool:
        return self.sentence.startswith("TRUST")

    @property
    def wrong(self) -> bool:
        """Trusted, though a parameter is off by more than twice its half width and more than is aimed at."""
        beyond = np.abs(self.errors) > np.maximum(2.0 * self.widths, WITHIN)
        return self.trusted and bool(beyond.any())


@kept
def fit_clipped(seed: int, share: float, sides: str) -> Fit:
    """A fit of two runs, read as files are."""
    runs = []
    for number in (1, 2):
        run = leg_run(seed, number)
        columns = {name: values for name, values in run.columns.items() if name != "q1_rad"}
        columns["tau2_nm"] = cut_off(run["tau2_nm"], share, sides) if share else run["tau2_nm"]
        runs.append(RawTable(run.name, run.time_s, columns))
    return _fit(seed, runs)


def _fit(seed: int, tables: Sequence[RawTable]) -> Fit:
    truth = random_leg(np.random.default_rng(seed)).beta()[:JUDGED]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "rig.toml").write_text(RIG, encoding="utf-8")
        rig = load_rig(Path(folder) / "rig.toml")
    try:
        result = fit_runs([align_table(table, 100.0) for table in tables], rig).result
    except (FitError, InputError) as error:
        return Fit(np.full(JUDGED, np.nan), np.full(JUDGED, np.nan), f"refused: {error}")
    beta, half = result.beta[:JUDGED], result.half_width[:JUDGED]
    return Fit(100.0 * (beta / truth - 1.0), 100.0 * half / truth, fit_trust(result).sentence)


def page(legs: int, seed: int, records: Path | None) -> str:
    """The page."""
    lines = ["# Looks at readings", "",
             f"Made by `python -m tests.evidence looks`, seeds {seed} to {seed + legs - 1}, "
             f"{datetime.now(UTC):%Y-%m-%d}, {machine()}.", ""]
    return "\n".join([*lines, *_healthy(seed, records), *_named(NAMED_LEGS, seed), *_pairs(seed),
                      *_clipped(legs, seed)])


def _pairs(seed: int) -> list[str]:
    """Fits of ten legs with the kinds in pairs, one leg a pair in turn."""
    rows, wrong, trusted = [], 0, 0
    pairs = list(combinations(FITTED, 2))
    for k, kinds in enumerate(pairs):
        found = fit_pair(seed + k % NAMED_LEGS, kinds)
        worst = float(np.nanmax(np.abs(found.errors))) if np.isfinite(found.errors).any() else np.nan
        wrong, trusted = wrong + found.wrong, trusted + found.trusted
        rows.append(f"| {' and '.join(kinds)} | {worst:.2f} % | {found.sentence.partition(':')[0].rstrip('.')} |")
        print(rows[-1], flush=True)
    return ["## Pairs of faults, with fits", "", "The same kinds, and samples of the torque that are lost, in pairs. "
            f"Each pair is in both runs of one of {NAMED_LEGS} legs.", "",
            f"**Pairs trusted wrongly: {wrong} of {len(pairs)} fits, {trusted} of which are trusted.**", "",
            "| put in | largest error | the fit's first line |", "| --- | ---: | --- |", *rows, ""]


def _healthy(seed: int, records: Path | None) -> list[str]:
    rows, runs, false = [], 0, list[str]()
    for family in FAMILIES:
        count, found = 0, list[str]()
        for k in range(FAMILY_LEGS):
            more, told = found_in_healthy(family, seed + k)
            count, found = count + more, found + told
        rows.append(f"| {family} | {count} | {len(found)} |")
        print(rows[-1], *found, sep="\n", flush=True)
        runs, false = runs + count, false + found
    plain = [leg_run(seed + k, number) for k in range(PLAIN_LEGS) for number in range(PLAIN_RUNS)]
    found = [f"{run.name}: {fault}" for run in plain for fault in look(run.time_s, run.columns).faults]
    rows.append(f"| MuJoCo, an open-loop torque | {len(plain)} | {len(found)} |")
    runs, false = runs + len(plain), false + found
    for kind in MOTIONS:
        found = found_in_motions(kind, seed)
        count = len(RATES_HZ) * len(ENCODERS)
        rows.append(f"| {kind}, {RATES_HZ[0]:g} to {RATES_HZ[-1]:g} Hz | {count} | {len(found)} |")
        runs, false = runs + count, false + found
    if records is not None and records.is_dir():
        count, found = found_in_records(records)
        rows.append(f"| public records | {count} | {len(found)} |")
        runs, false = runs + count, false + found
    return ["## Healthy runs", "", f"**False findings: {len(false)} in {runs} healthy runs.**",
            *(f"- {text}" for text in false), "", "| family | runs | findings |", "| --- | ---: | ---: |", *rows, ""]


def _named(legs: int, seed: int) -> list[str]:
    rows, right, whole = [], 0, 0
    for kinds in (*((kind,) for kind in KINDS), *combinations(KINDS, 2)):
        found = [named(seed + k, kinds) for k in range(legs)]
        good = sum(put == told for put, told in found)
        rows.append(f"| {' and '.join(kinds)} | {good} of {legs} | "
                    f"{'; '.join(sorted({', '.join(told) or 'none' for put, told in found if put != told}))} |")
        right, whole = right + good, whole + legs
    return ["## Faults put in, one and two at a time", "", "In runs of 20 s at 100 Hz of legs simulated by MuJoCo. "
            "An angle wraps by a turn, is off by 1 to 4 rad in one reading, or steps by 0.8 to 1.5 rad. A torque is "
            "clipped in 3 to 30 % of the samples. A gyro hangs for 15 to 40 samples. Readings are repeated 2 to 4 "
            "times.", "",
            f"**Named exactly: {right} of {whole}.**", "", "| put in | named exactly | named instead |",
            "| --- | ---: | --- |", *rows, ""]


def _clipped(legs: int, seed: int) -> list[str]:
    rows, wrong, fits, near, few = [], 0, 0, 0, 0
    for sides in SIDES:
        for share in (0.0, *SHARES):
            found = [fit_clipped(seed + k, share, sides) for k in range(legs)]
            worst = [float(np.nanmax(np.abs(one.errors))) for one in found if np.isfinite(one.errors).any()]
            inside = sum(int(np.sum(np.abs(one.errors) <= one.widths)) for one in found)
            bad = sum(one.wrong for one in found)
            rows.append(f"| {sides} | {100 * share:.0f} % | {np.median(worst):.2f} % | {max(worst):.2f} % | "
                        f"{inside} of {JUDGED * legs} | {sum(one.trusted for one in found)} of {legs} | {bad} |")
            print(rows[-1], flush=True)
            wrong, fits = wrong + bad, fits + legs
            if 0.0 < share <= 0.15:
                near, few = near + sum(one <= WITHIN for one in worst), few + legs
    return ["## Clipped torque", "", "Fits of two runs of 20 s of the same legs, without noise levels in the rig file. "
            "The torque reading ends where a share of the samples is beyond. Errors are those of beta1 to beta5.", "",
            f"**Trusted wrongly: {wrong} of {fits} fits. Up to 15 % of the samples clipped, every parameter is within "
            f"{WITHIN:g} % in {near} of {few} fits.**", "",
            "| clipped | samples | largest error of a leg, median | worst leg | intervals that hold | trusted | "
            "trusted wrongly |",
            "| --- | ---: | ---: | ---: | ---: | ---: | ---: |", *rows, "",
            "Trusted wrongly: the first line says TRUST, and a parameter is off by more than 2 % and two half widths.",
            ""]


EVIDENCE = (
    Evidence("Do looks at readings find nothing in healthy runs?", "python -m tests.evidence looks", "looks.md", 10,
             "none in 200 runs", (r"(False findings: \d+ in \d+) healthy runs",)),
    Evidence("Are faults of readings named, and is a clipped torque never trusted wrongly?",
             "python -m tests.evidence looks", "looks.md", 10, "all named; no fit trusted wrongly; within 2 % to 15 %",
             (r"(Named exactly: \d+ of \d+)", r"(Trusted wrongly: \d+ of \d+) fits",
              r"(within 2 % in \d+ of \d+ fits)")),
    Evidence("Is a fit of runs with two kinds of faulty readings ever trusted wrongly?",
             "python -m tests.evidence looks", "looks.md", 10, "never",
             (r"(Pairs trusted wrongly: \d+ of \d+) fits",)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--legs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=6200)
    parser.add_argument("--records", type=Path, default=ROOT.parent / "shared/realdata",
                        help="folder of public records as CSV by the contract, one folder each machine")
    parser.add_argument("--out", type=Path, default=PAGE)
    given = parser.parse_args(arguments)
    given.out.write_text(page(given.legs, given.seed, given.records), encoding="utf-8")
