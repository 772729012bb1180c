"""`make changed`: is a fault found that is put into later runs of a real machine, earlier ones being the reference?

Each record is split at random into reference and test runs, several times; each fault is put into the test runs alone.
Called again it goes on where it stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq import Dataset, InputError, load_rig
from experiments.session import as_datasets
from experiments.studies import machine
from experiments.workflows import find_change
from tests.evidence.blind.records import FAULTS, RECORDS, RIGS, UNTOUCHED
from tests.evidence.kept import kept
from tests.evidence.registry import Evidence
from tests.support.paths import REAL

SPLITS, SEED = 10, 40
USED = ("a0", "c0", "servo")
"""The other records hold one run."""


class Case(NamedTuple):
    """One record, one split, one fault."""

    record: str
    reference: tuple[int, ...]
    fault: str


@kept
def one(record: str, reference: tuple[int, ...], fault: str) -> tuple[str, list[str], float]:
    """Verdict, effects of the causes, and seconds; the verdict is `refused` where the runs are."""
    known = RECORDS[record]
    rig = load_rig(RIGS / known.rig)
    runs = as_datasets([REAL / known.folder / f"{name}.csv.gz" for name in known.runs], rig, False)
    test = [spoilt(run, record, fault) for k, run in enumerate(runs) if k not in reference]
    try:
        found = find_change(test, [runs[k] for k in reference], rig).change
    except InputError:
        return "refused", [], 0.0
    return found.verdict, sorted({c.effect for c in found.causes}), found.wall_s


def spoilt(run: Dataset, record: str, fault: str) -> Dataset:
    """The run with the fault in its readings."""
    if fault == UNTOUCHED:
        return run
    columns = {"time_s": run.time_s.copy(), **{k: v.copy() for k, v in run.columns.items()}}
    torques = tuple(k for k in columns if k.startswith(("tau", "volt", "duty")))
    FAULTS[fault].put_in(columns, replace(RECORDS[record], torque=torques), RECORDS[record].sizes[fault])
    del columns["time_s"]
    return replace(run, columns=columns)


def cases() -> Iterator[Case]:
    """Every record's splits, each untouched and with every fault."""
    for record in USED:
        count = len(RECORDS[record].runs)
        splits = list(combinations(range(count), (count + 1) // 2))
        order = np.random.default_rng(SEED).permutation(len(splits))[:SPLITS]
        for k in order:
            for fault in (UNTOUCHED, *RECORDS[record].sizes):
                yield Case(record, splits[k], fault)


def page() -> Iterator[str]:
    """The page, line by line."""
    rows = [(case, *one(*case)) for case in cases()]
    spoiled = [row for row in rows if row[0].fault != UNTOUCHED]
    found = sum(case.fault in causes for case, _, causes, _ in spoiled)
    wrong = sum(bool(causes) and case.fault not in causes for case, _, causes, _ in spoiled)
    plain = [row for row in rows if row[0].fault == UNTOUCHED]
    quiet = sum(verdict == "no_change" for _, verdict, _, _ in plain)
    yield from [
        "# What changed on a real machine", "",
        f"Made by `make changed`, {SPLITS} random splits of each record into reference and test runs (seed {SEED}), "
        f"{datetime.now(UTC):%Y-%m-%d}, {machine()}.", "",
        "Each fault is put exactly into the readings of the test runs.",
        "The servo's runs hold four kinds of motion under two controllers, so its reference and test runs mostly hold "
        "different motion. The form of the model of unexplained structure was chosen on splits of `a0` and the servo.",
        "An `encoder_offset` cannot show: the rig files of both arms declare a zero that differs from run to run.", "",
        "| | measured | wanted |", "| --- | --- | --- |",
        f"| fault in the answer | {found} of {len(spoiled)} | 80 to 95 % by size |",
        f"| wrong names alone | {wrong} of {len(spoiled)} | at most 3 % |",
        f"| untouched sessions `no_change` | {quiet} of {len(plain)} | 95 % |",
        f"| seconds a comparison, median and worst | {np.median([row[3] for row in rows]):.1f}, "
        f"{max(row[3] for row in rows):.1f} | |", "",
        "| record | fault | in the answer | wrong names | `changed_unexplained` | `no_change` |",
        "| --- | --- | --- | --- | --- | --- |"]
    for record, fault in dict.fromkeys((case.record, case.fault) for case, *_ in rows):
        own = [row for row in rows if row[0].record == record and row[0].fault == fault]
        right = sum(fault in causes for _, _, causes, _ in own)
        named = sum(bool(causes) and fault not in causes for _, _, causes, _ in own)
        verdicts = [verdict for _, verdict, _, _ in own]
        yield (f"| {record} | {fault} | {right if fault != UNTOUCHED else '-'} | {named} | "
               f"{verdicts.count('changed_unexplained')} | {verdicts.count('no_change')} |")
    yield ""


EVIDENCE = (
    Evidence("What changed on real machines: untouched sessions, and faults in the later runs", "make changed",
             "what-changed.md", 5, "95 % `no_change`, 80 to 95 % of faults in the answer",
             (r"untouched sessions `no_change` \| (\d+ of \d+)", r"fault (in the answer) \| (\d+ of \d+)")),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    words = parser.parse_args(arguments)
    lines = list(page())
    print("\n".join(lines))
    words.out.write_text("\n".join(lines), encoding="utf-8")
