"""Families of plants of other makes: make cases, have `legid diagnose` answer each as a user would, count.

    python -m tests.evidence blind.family --family servo --seeds 11-14 --out OUT
        [--effects none,torque_delay] [--page PAGE]

writes OUT/cases and OUT/diagnoses; what is there already is kept, so an interrupted bench goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from tests.evidence.blind import geared, outside, records, servo, several_faults, stickslip
from tests.evidence.blind.page import describe_machine
from tests.evidence.blind.run import diagnose, parse_seeds
from tests.evidence.blind.score import PRESENT, Outcome, Rate, load
from tests.evidence.registry import Evidence

Maker = Callable[[str, int, Path], None]
FAMILIES: dict[str, tuple[Maker, Sequence[str]]] = {
    "servo": (servo.make_case, tuple(servo.MAKERS)), "stickslip": (stickslip.make_case, tuple(stickslip.MAKERS)),
    "geared": (geared.make_case, tuple(geared.MAKERS)),
    "small_faults": (several_faults.make_case, several_faults.NAMES),
    "outside": (outside.make_case, tuple(outside.MAKERS)),
    "pairs": (several_faults.make_pair, several_faults.PAIRS), "records": (records.make_case, records.NAMES)}


@dataclass(frozen=True)
class FamilyCase:
    """Stands for a case of the blind bench where it is diagnosed."""

    name: str
    kind: str = "family"
    effects: tuple[str, ...] = ()


def rates(outcomes: Sequence[Outcome]) -> dict[str, Rate]:
    """What a family's cases say, by what was hidden. An effect that the verdict calls present but too small to matter
    counts neither as named nor as wrong."""
    healthy = [o for o in outcomes if o.truth["name"].startswith("none")]
    outside = [o for o in outcomes if o.truth["name"].startswith("outside_")]
    single, pair = ([o for o in outcomes if len(o.hidden) == n] for n in (1, 2))

    def share(of: list[Outcome], hit: Callable[[Outcome], bool]) -> Rate:
        return Rate(sum(map(hit, of)), len(of))

    return {"healthy: false alarm": share(healthy, lambda o: o.verdict != "none"),
            "single: named exactly": share(single, lambda o: o.exact),
            "single: truth inside the answer": share(single, lambda o: o.inside),
            "single: wrong name": share(single, lambda o: o.wrong_name),
            "single: unexplained": share(single, lambda o: o.verdict == "unexplained"),
            "single: none": share(single, lambda o: o.verdict == "none"),
            "pair: both named, nothing else": share(pair, lambda o: o.exact),
            "pair: wrong name": share(pair, lambda o: o.wrong_name),
            "outside the library: wrong name": share(outside, lambda o: o.verdict in PRESENT)}


def page(family: str, seeds: Sequence[int], root: Path) -> str:
    """The page's text: rates with Wilson's intervals, then every case."""
    outcomes, missing = load(root / "diagnoses", root / "cases")
    names = [o.truth["name"] for o in outcomes]
    answers = {n: json.loads((root / "diagnoses" / f"{n}.json").read_text()) for n in names}
    lines = [f"# Diagnosis of plants of another make: {family}", "",
             f"`make family FAMILY={family}`, seeds {min(seeds)} to {max(seeds)}, {len(outcomes)} cases; "
             f"{datetime.now(UTC):%Y-%m-%d}, {describe_machine()}.", ""]
    if family == "records":
        lines += records.compare(outcomes, answers)
    else:
        lines += ["| | measured |", "| --- | --- |"]
        lines += [f"| {name} | {rate} |" for name, rate in rates(outcomes).items() if rate.count]
    wall = [a["bench"]["wall_s"] for a in answers.values()]
    lines += ["", f"Time: median {np.median(wall):.0f} s, 95th percentile {np.quantile(wall, 0.95):.0f} s.", "",
              "| hidden | answers | rms error before, after |", "| --- | --- | --- |"]
    for name in dict.fromkeys(o.truth["name"].rsplit("-", 1)[0] for o in outcomes):
        of = [o for o in outcomes if o.truth["name"].rsplit("-", 1)[0] == name]
        said = ", ".join(f"{text} ({n})" if n > 1 else text for text, n in Counter(map(_said, of)).items())
        found = [answers[o.truth["name"]].get("error") for o in of]
        errors = "; ".join(f"{e['before']:.2f}, {e['after']:.2f}" if e else "-" for e in found)
        lines.append(f"| {name} | {said} | {errors} |")
    if missing:
        lines += ["", f"Without an answer: {', '.join(missing)}."]
    return "\n".join([*lines, ""])


def _said(outcome: Outcome) -> str:
    if outcome.verdict == "unexplained" and outcome.causes:
        return f"unexplained (closest {' + '.join(c['effect'] for c in outcome.causes)})"
    return outcome.said


EVIDENCE = (
    Evidence("Plants of other makes: what `legid diagnose` names there", "make family FAMILY=servo SEEDS=811",
             "families.md", 15, "no false alarm, no wrong name",
             (r"Of its \d+ single causes \d+ are named or inside a `one_of`", r"No healthy leg raises an alarm"),
             r"Seed (\d+) was fresh", r"cases; (\d{4}-\d\d-\d\d)"),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--family", choices=FAMILIES, required=True)
    parser.add_argument("--seeds", type=parse_seeds, required=True, help="N or A-B, several after commas")
    parser.add_argument("--effects", default="", help="comma-separated; all by default")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--page", type=Path)
    args = parser.parse_args(arguments)
    make, every = FAMILIES[args.family]
    names = [n for n in args.effects.split(",") if n] or every
    (args.out / "diagnoses").mkdir(parents=True, exist_ok=True)
    for seed in args.seeds:
        for name in names:
            make(name, seed, args.out / "cases")
            case = FamilyCase(f"{name}-{seed}")
            if not (args.out / "diagnoses" / f"{case.name}.json").exists():
                found = diagnose(case, args.out / "cases", args.out / "diagnoses", share=2)
                print(case.name, found["verdict"], [c["effect"] for c in found["causes"]], found.get("error"),
                      f"{found['bench']['wall_s']:.0f} s", found["bench"]["said"] or "", flush=True)
    if args.page:
        args.page.write_text(page(args.family, args.seeds, args.out), encoding="utf-8")
