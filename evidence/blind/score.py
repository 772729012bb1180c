"""One diagnosis against what was hidden: is it exact, is the truth in it, is a name wrong, are its sizes in their
intervals; and rates with their 95 % intervals."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any

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


def sizes_inside(outcome: Outcome) -> list[bool]:
    """One entry for each hidden size that the diagnosis states with an interval.

    Matched by name, else by a unit that occurs once, else as the only size of both. Only of effects whose law is the
    library's.
    """
    inside = []
    for effect in (e for e in outcome.hidden if e["effect"] not in OTHER_FORMS):
        stated = [s for c in outcome.causes if same(c, effect) for s in c["size"]]
        hidden = _sizes(effect)
        for name, unit, value in hidden:
            matching = [s for s in stated if s["name"] == name] or _alike(
                [s for s in stated if unit is None or s["unit"] == unit], [u for _, u, _ in hidden if u == unit])
            if matching and matching[0].get("ci95"):
                low, high = matching[0]["ci95"]
                inside.append(bool(low <= value <= high))
    return inside


def _sizes(effect: Mapping[str, Any]) -> list[tuple[str, str | None, float]]:
    """(name, unit, value) of what was hidden; families of other simulators state no unit."""
    if "size" in effect:
        return [(s["name"], s["unit"], s["value"]) for s in effect["size"]]
    return [(name, None, value) for name, value in effect.get("sizes", {}).items()]


def _alike(stated: list[Mapping[str, Any]], hidden: list[str | None]) -> list[Mapping[str, Any]]:
    return stated if len(stated) == len(hidden) == 1 else []
