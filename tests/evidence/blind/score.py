"""Score diagnoses against what was hidden: confusion table, rates with Wilson intervals, sizes inside intervals.

    python -m tests.evidence blind.score DIAGNOSES TRUTHS

DIAGNOSES holds NAME.json (diagnosis JSON), TRUTHS holds NAME.truth.json; either is searched through its folders.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import sqrt
from pathlib import Path
from typing import Any

MODERATE = (2.0, 5.0)
NAMES = ("named", "partial")
"""Verdicts that say each of their causes is present."""
PRESENT = (*NAMES, "one_of")
"""... or one of them."""
OTHER_FORMS = frozenset((
    "stribeck_friction", "presliding_friction", "friction_drift", "joint_elasticity", "backlash", "end_stop_contact",
    "base_compliance", "torque_ripple", "torque_saturation"))
"""Hidden by another law than the library's, so their sizes are not the same quantities; see effects.py."""


@dataclass(frozen=True)
class Rate:
    """`hits` of `count`, with the 95 % interval of Wilson (1927)."""

    hits: int
    count: int

    @property
    def value(self) -> float:
        return self.hits / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        if not self.count:
            return 0.0, 1.0
        z, n, p = 1.959964, self.count, self.value
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
        return max(0.0, middle - half), min(1.0, middle + half)

    def __str__(self) -> str:
        if not self.count:
            return "no cases"
        low, high = self.interval
        return f"{self.hits}/{self.count} = {100 * self.value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


@dataclass(frozen=True)
class Outcome:
    """One diagnosis beside its truth."""

    truth: Mapping[str, Any]
    verdict: str
    causes: tuple[Mapping[str, Any], ...]

    @property
    def hidden(self) -> tuple[Mapping[str, Any], ...]:
        return tuple(self.truth["effects"])

    def found(self, effect: Mapping[str, Any]) -> bool:
        return any(same(cause, effect) for cause in self.causes)

    def true_cause(self, cause: Mapping[str, Any]) -> bool:
        """The cause was hidden, or is truly there beside what was hidden."""
        return any(same(cause, e) or any(same(cause, a) for a in e["also"]) for e in self.hidden)

    @property
    def names_truth(self) -> bool:
        return bool(self.hidden) and all(self.found(e) for e in self.hidden)

    @property
    def exact(self) -> bool:
        return self.verdict in NAMES and self.names_truth and all(map(self.true_cause, self.causes))

    @property
    def inside(self) -> bool:
        return self.verdict in PRESENT and self.names_truth

    @property
    def wrong_name(self) -> bool:
        return self.verdict in NAMES and not all(map(self.true_cause, self.causes))

    @property
    def said(self) -> str:
        names = sorted({c["effect"] for c in self.causes})
        if self.verdict in NAMES:
            return " + ".join([*names, *(["?"] if self.verdict == "partial" else [])])
        if self.verdict == "one_of":
            return "one of {" + ", ".join(names) + "}"
        return self.verdict


def same(cause: Mapping[str, Any], effect: Mapping[str, Any]) -> bool:
    """Whether both are one effect at one joint."""
    joints = cause.get("joint"), effect.get("joint")
    return bool(cause["effect"] == effect["effect"] and (None in joints or joints[0] == joints[1]))


def load(diagnoses: Path, truths: Path) -> tuple[list[Outcome], list[str]]:
    """All pairs, and the names of truths that have no diagnosis."""
    answers = {p.name.removesuffix(".json"): p for p in diagnoses.rglob("*.json") if ".truth." not in p.name}
    outcomes, missing = [], []
    for path in sorted(truths.rglob("*.truth.json")):
        truth = json.loads(path.read_text(encoding="utf-8"))
        if truth["name"] not in answers:
            missing.append(truth["name"])
            continue
        answer = json.loads(answers[truth["name"]].read_text(encoding="utf-8"))
        outcomes.append(Outcome(truth, answer["verdict"], tuple(answer.get("causes", ()))))
    return outcomes, missing


@dataclass
class Score:
    """Every rate of the bench."""

    rates: dict[str, Rate] = field(default_factory=dict)
    confusion: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def add(self, name: str, outcomes: Iterable[Outcome], hit: str | None = None, **kinds: Any) -> None:
        chosen = list(outcomes)
        self.rates[name] = Rate(sum(bool(getattr(o, hit) if hit else o.verdict in kinds["verdicts"])
                                    for o in chosen), len(chosen))


def score(outcomes: Sequence[Outcome]) -> Score:
    """Rates by class. A single is moderate when its projected ratio is 2 to 5, whatever its level was called."""
    out = Score()
    for o in outcomes:
        label = " + ".join(e["effect"] for e in o.hidden) or f"nothing ({o.truth['variant']})"
        if o.truth["class"] == "deleted":
            label += " (deleted)"
        out.confusion[label][o.said] += 1
    by_class: dict[str, list[Outcome]] = defaultdict(list)
    for o in outcomes:
        by_class[o.truth["class"]].append(o)
    none, single = by_class["none"], by_class["single"]
    alarm = (*NAMES, "one_of", "unexplained")
    out.add("false alarms", none, verdicts=alarm)
    out.add("negatives with a name", none, verdicts=(*NAMES, "one_of"))
    out.add("negatives whose fit failed", none, verdicts=("fit_failed",))
    for label, chosen in (("moderate singles", [o for o in single if _moderate(o.truth)]),
                          ("larger singles", [o for o in single if _ratio(o.truth) > MODERATE[1]]),
                          ("smaller singles", [o for o in single if _ratio(o.truth) < MODERATE[0]])):
        out.add(f"{label}: named exactly", chosen, "exact")
        out.add(f"{label}: truth inside named or one_of", chosen, "inside")
        out.add(f"{label}: wrong name", chosen, "wrong_name")
        out.add(f"{label}: unexplained", chosen, verdicts=("unexplained",))
        out.add(f"{label}: none", chosen, verdicts=("none",))
    for name in ("outside", "deleted"):
        out.add(f"{name}: unexplained", by_class[name], verdicts=("unexplained",))
        out.add(f"{name}: unexplained, of those detected", [o for o in by_class[name] if o.verdict != "none"],
                verdicts=("unexplained",))
        out.add(f"{name}: wrong name", by_class[name], "wrong_name")
    out.add("pairs: both named", by_class["pair"], "exact")
    out.add("pairs: wrong name", by_class["pair"], "wrong_name")
    out.add("pairs: one_of or unexplained", by_class["pair"], verdicts=("one_of", "unexplained"))
    sizes = [inside for o in single if o.exact for inside in _sizes_inside(o)]
    out.rates["sizes inside their 95 % intervals"] = Rate(sum(sizes), len(sizes))
    return out


def _ratio(truth: Mapping[str, Any]) -> float:
    return float(truth["ratio"]["projected"])


def _moderate(truth: Mapping[str, Any]) -> bool:
    return MODERATE[0] <= _ratio(truth) <= MODERATE[1]


def _sizes_inside(outcome: Outcome) -> list[bool]:
    """One entry for each hidden size that the diagnosis states, matched by name, else by a unit that occurs once.

    Only of effects whose law is the library's.
    """
    inside = []
    for effect in (e for e in outcome.hidden if e["effect"] not in OTHER_FORMS):
        stated = [s for c in outcome.causes if same(c, effect) for s in c["size"]]
        for size in effect["size"]:
            matching = [s for s in stated if s["name"] == size["name"]]
            unit = [s for s in stated if s["unit"] == size["unit"]]
            if not matching and len(unit) == 1 and sum(s["unit"] == size["unit"] for s in effect["size"]) == 1:
                matching = unit
            if matching and matching[0].get("ci95"):
                low, high = matching[0]["ci95"]
                inside.append(bool(low <= size["value"] <= high))
    return inside


def render(result: Score, missing: Sequence[str]) -> str:
    """The page: rates, then the confusion table."""
    width = max(map(len, result.rates))
    lines = ["| rate | hits/cases (95 % Wilson) |", "| --- | --- |"]
    lines += [f"| {name:{width}s} | {rate} |" for name, rate in result.rates.items() if rate.count]
    lines += ["", "| hidden | said |", "| --- | --- |"]
    for label in sorted(result.confusion):
        said = "; ".join(f"{count} x {name}" for name, count in result.confusion[label].most_common())
        lines.append(f"| {label} | {said} |")
    if missing:
        lines += ["", f"Without a diagnosis: {len(missing)} ({', '.join(missing[:5])}{' ...' if missing[5:] else ''})"]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("diagnoses", type=Path)
    parser.add_argument("truths", type=Path)
    options = parser.parse_args(arguments)
    outcomes, missing = load(options.diagnoses, options.truths)
    if not outcomes:
        parser.error(f"no diagnosis in {options.diagnoses} has a truth in {options.truths}")
    print(render(score(outcomes), missing))
    return 0
