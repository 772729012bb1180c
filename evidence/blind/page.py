"""The page of `make evidence`: each class of cases by family, against targets; sizes, times, and what is not right."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from estimator.diagnosis import MATERIAL
from estimator.diagnosis.decision_rule import EDGE
from evidence.blind import records
from evidence.blind.calibration import Stated, fit, left_out
from evidence.blind.plan import FAMILIES, PlannedCase
from evidence.blind.score import NAMES, PRESENT, Outcome, Rate, sizes_inside
from evidence.frame import share, table

PROBABILITIES = (0.0, 0.5, 0.8, 0.95, 1.0)
"""Bins of the stated probability."""
RATIOS = (-np.inf, EDGE, 2.0, 5.0, np.inf)
OUTSIDE = ("outside", "deleted")


class Answer(NamedTuple):
    """What `legid diagnose` says of one case."""

    case: PlannedCase
    outcome: Outcome
    document: dict[str, Any]
    """Diagnosis JSON, with `bench` of `run.diagnose`."""

    @property
    def kind(self) -> str:
        return self.case.kind

    @property
    def before(self) -> float | None:
        """Rms error of free runs over what noise leaves; None where the diagnosis states none."""
        return (self.document.get("error") or {}).get("before")

    @property
    def material(self) -> bool:
        """Whether a named cause can be due; without an error as well, so that no case is lost."""
        return self.before is None or self.before >= 1.0 + MATERIAL

    @property
    def above_edge(self) -> bool:
        return self.before is None or self.before > EDGE

    @property
    def outside_right(self) -> bool:
        """Of a cause outside the library: `unexplained`, or `partial` without a wrong name."""
        o = self.outcome
        return o.verdict == "unexplained" or (o.verdict == "partial" and not o.wrong_name)

    @property
    def tells_both(self) -> bool:
        """Of two causes: whether each is named or listed as present, and none is named wrongly."""
        listed = replace(self.outcome, causes=(*self.outcome.causes, *self.listed))
        return self.outcome.verdict in NAMES and listed.names_truth and not self.outcome.wrong_name

    @property
    def listed(self) -> tuple[dict[str, Any], ...]:
        """Effects that the diagnosis calls present, not material."""
        return tuple(self.document.get("immaterial", ()))

    @property
    def right(self) -> bool:
        """Whether it need not be listed: a cause that is not material may stay unnamed."""
        o = self.outcome
        if self.kind == "none":
            return o.verdict == "none"
        if self.kind in OUTSIDE:
            return self.outside_right or (o.verdict == "none" and not self.above_edge)
        if self.kind == "pair" or self.material:
            return o.exact
        return o.verdict in ("none", "unexplained") or (o.inside and not o.wrong_name)

    @property
    def probability(self) -> float | None:
        """That the diagnosis states of its answer."""
        return self.document.get("probability")

    @property
    def in_library(self) -> float | None:
        """The same if the library has the causes."""
        return self.document.get("probability_in_library")

    @property
    def true(self) -> bool:
        """Whether the answer says what is hidden, as its probability has it; `none`: that nothing material is."""
        o = self.outcome
        if o.verdict == "none":
            return self.kind == "none" or not (self.above_edge if self.kind in OUTSIDE else self.material)
        if o.verdict == "partial":
            return not o.wrong_name
        return o.inside if o.verdict == "one_of" else o.exact


Count = Callable[[Answer], bool | None]
"""Whether an answer is a hit; None where it does not count."""


@dataclass(frozen=True)
class Column:
    """A rate of the table by family."""

    title: str
    count: Count
    target: float | None = None
    at_most: bool = False

    def misses(self, rate: Rate) -> bool:
        """Whether the measured share is on the wrong side of the target."""
        if self.target is None or not rate.count:
            return False
        return rate.value > self.target if self.at_most else rate.value < self.target

    def judge(self, rate: Rate) -> str:
        """The target, and whether it is met; a rate is sure where its whole interval is on one side."""
        if self.target is None:
            return "-"
        wanted = f"{'at most' if self.at_most else 'at least'} {100 * self.target:.0f} %"
        if not rate.count:
            return f"{wanted}: not run"
        low, high = rate.interval
        if not self.misses(rate):
            sure = high <= self.target if self.at_most else low >= self.target
            return f"{wanted}: met" if sure else f"{wanted}: met, too few cases to prove it"
        sure = low > self.target if self.at_most else high < self.target
        return f"{wanted}: **missed**" if sure else f"{wanted}: **missed**, too few cases to prove it"


def of(kinds: Sequence[str], hit: Callable[[Answer], bool], among: Callable[[Answer], bool] = lambda a: True) -> Count:
    """Counts answers of these kinds that are `among` those meant."""
    return lambda a: hit(a) if a.kind in kinds and among(a) else None


_material, _exact, _inside, _wrong = map(attrgetter, (
    "material", "outcome.exact", "outcome.inside", "outcome.wrong_name"))


def _none(answer: Answer) -> bool:
    return answer.outcome.verdict == "none"


COLUMNS = (
    Column("healthy: no alarm", of(["none"], _none), 0.98),
    Column("material singles: named exactly", of(["single"], _exact, _material), 0.85),
    Column("truth in the answer", of(["single"], _inside, _material), 0.95),
    Column("wrong name", of(["single"], _wrong, _material), 0.02, at_most=True),
    Column("`none`", of(["single"], _none, _material)),
    Column("pairs: both named", of(["pair"], _exact), 0.75),
    Column("pairs: one named, the other listed as present, or both named", of(["pair"], lambda a: a.tells_both)),
    Column("outside: `unexplained` or `partial`, no wrong name", of(OUTSIDE, lambda a: a.outside_right), 0.85),
    Column("outside: wrong name", of(OUTSIDE, _wrong)),
    Column(f"outside above {EDGE:g} floors: `none`", of(OUTSIDE, _none, lambda a: a.above_edge), 0.0, at_most=True))
BY_RATIO = {"singles: named exactly": of(["single"], _exact), "truth in the answer": of(["single"], _inside),
            "wrong name": of(["single"], _wrong), "`none`": of(["single"], _none),
            "outside: right": of(OUTSIDE, lambda a: a.outside_right), "outside: `none`": of(OUTSIDE, _none)}


def rate(answers: Iterable[Answer], count: Count) -> Rate:
    hits = [hit for hit in map(count, answers) if hit is not None]
    return Rate(sum(hits), len(hits))


def sizes(answers: Iterable[Answer]) -> Rate:
    """Sizes in their intervals, of single and double causes that are named exactly."""
    inside = [one for a in answers if a.kind in ("single", "pair") and a.outcome.exact
              for one in sizes_inside(a.outcome)]
    return Rate(sum(inside), len(inside))


def read(cases: Iterable[PlannedCase], folder: Path) -> list[Answer]:
    """The answers that are kept below `folder`; a case that could not be made has the truth of its name."""
    found = []
    for case in cases:
        document = json.loads(answer_file(case, folder).read_text())
        file = folder / case.family / "cases" / f"{case.name}.truth.json"
        truth = json.loads(file.read_text()) if file.exists() else {
            "name": case.name, "effects": [{"effect": e, "joint": None, "sizes": {}, "also": []} for e in case.effects]}
        found.append(Answer(case, Outcome(truth, document["verdict"], tuple(document.get("causes", ()))), document))
    return found


def answer_file(case: PlannedCase, folder: Path) -> Path:
    return folder / case.family / "diagnoses" / f"{case.name}.json"


def tables(answers: Sequence[Answer], at_once: int) -> Iterator[str]:
    """The page's tables and what is said of them."""
    legs = [a for a in answers if a.kind != "record"]
    real = [a for a in answers if a.kind == "record"]
    if legs:
        yield from _by_family(legs)
        yield from _by_ratio(legs)
        yield from _reliability(legs)
        yield from _sizes_and_times(legs, at_once)
        yield from _not_right(legs)
    if real:
        yield from ["## Real records with a fault put in",
                    "Found: the fault is named or in the set, and was not before, or grew by what was put in.",
                    *records.compare([a.outcome for a in real], {a.case.name: a.document for a in real})]


def _families(answers: Sequence[Answer]) -> Iterator[tuple[str, list[Answer]]]:
    """Each family that has answers, and all."""
    for family in (*FAMILIES, "all"):
        own = [a for a in answers if family in (a.case.family, "all")]
        if own:
            yield family, own


def _by_family(answers: Sequence[Answer]) -> Iterator[str]:
    rows = []
    for family, own in _families(answers):
        cells = ((column, rate(own, column.count)) for column in COLUMNS)
        rows.append((family, *(f"**{one}**" if column.misses(one) else _cell(one) for column, one in cells)))
    rows.append(("target", *(column.judge(rate(answers, column.count)) for column in COLUMNS)))
    yield from ["## By family", "Bold: misses the target."]
    yield table(" | ".join(["family", *(column.title for column in COLUMNS)]), rows)
    single = rate(answers, of(["single"], _wrong, lambda a: not a.material))
    pair = rate(answers, of(["pair"], _wrong))
    listed = [a.outcome.true_cause(c) for a in answers if a.kind in ("single", "pair") and a.outcome.verdict in NAMES
              for c in a.listed]
    yield (f"Wrong names of other cases: singles that are not material {single.hits} of {single.count}, pairs "
           f"{pair.hits} of {pair.count}. Of {len(listed)} effects listed as present together with a name "
           f"{sum(listed)} were put in; several families have small faults of their own. Cases without an "
           f"answer: {sum(bool(a.document['bench']['crashed']) for a in answers)}. They count as misses.")


def _by_ratio(answers: Sequence[Answer]) -> Iterator[str]:
    groups = {f"up to {high:g}" if low == -np.inf else f"above {low:g}" if high == np.inf else f"{low:g} to {high:g}":
              [a for a in answers if a.before is not None and low < a.before <= high] for low, high in pairwise(RATIOS)}
    if unknown := [a for a in answers if a.before is None]:
        groups["not stated"] = unknown
    yield "## By error before, over the floor"
    yield table(" | ".join(["ratio", *BY_RATIO]), (
        (name, *(_cell(rate(own, count)) for count in BY_RATIO.values())) for name, own in groups.items()))


def _reliability(answers: Sequence[Answer]) -> Iterator[str]:
    """Share of true answers by stated probability, of causes in the library and outside it; and calibrated anew."""
    stated = [(a, a.probability) for a in answers if a.probability is not None]
    known = [(a, a.in_library) for a in answers if a.in_library is not None]
    yield from ["## Stated probability and true answers",
                "An answer is true if its causes are exactly those present. For `partial`, its causes are among those "
                "present. For `none`, nothing material is. Outside the library only `none` can be true, up to "
                f"{EDGE:g} floors. {len(answers) - len(stated)} of {len(answers)} answers state no probability.",
                _by_probability("stated", stated),
                "The probability if the library has the true causes:", _by_probability("if in the library", known)]
    told = [Stated(a.case.family, p, a.true) for a, p in known]
    if len({one.family for one in told}) > 1:
        yield from ["Calibrated anew by these answers, each family by all others (of all: a = {:.3g}, b = {:.3g}, "
                    "c = {:.3g}):".format(*fit(told)),
                    _by_probability("calibrated", [(a, p) for (a, _), p in zip(known, left_out(told))])]


def _by_probability(title: str, stated: Sequence[tuple[Answer, float]]) -> str:
    rows = []
    for low, high in [*pairwise(PROBABILITIES), (0.0, 1.0)]:
        own = [(a, p) for a, p in stated if low <= p and (p < high or high == 1.0)]
        groups = ([a.true for a, _ in own if kinds is None or (a.kind in OUTSIDE) == kinds]
                  for kinds in (None, False, True))
        rows.append(("all" if high - low == 1.0 else f"{low:g} to {high:g}", len(own),
                     f"{np.mean([p for _, p in own]):.2f}" if own else "-", *map(share, groups)))
    return table(f"{title} | answers | mean | true | in the library or healthy | outside", rows)


def _sizes_and_times(answers: Sequence[Answer], at_once: int) -> Iterator[str]:
    yield from ["## Sizes and time",
                f"Time of one diagnosis: median, 95th percentile, worst; {at_once} ran at once. The target of wall "
                "time is for two idle cores."]
    yield table("family | sizes in their 95 % intervals | wall time [s] | processor time [s]", [
        *((family, _cell(sizes(own)), _times(own, "wall_s"), _times(own, "cpu_s"))
          for family, own in _families(answers)), "target | 93 to 97 % | 4, 12, 30 | -"])


def _times(answers: Iterable[Answer], key: str) -> str:
    values = [a.document["bench"][key] for a in answers if key in a.document["bench"]]
    return "{:.0f}, {:.0f}, {:.0f}".format(*np.quantile(values, (0.5, 0.95, 1.0))) if values else "-"


def _not_right(answers: Sequence[Answer]) -> Iterator[str]:
    wrong = [a for a in answers if not a.right]
    yield from ["## Cases that are not right",
                f"{len(answers) - len(wrong)} of {len(answers)} are right. Material singles and pairs must be named "
                f"exactly. Of a cause outside the library `none` is right up to {EDGE:g} floors."]
    yield table("family | case | answer | error before | after", (
        (a.case.family, a.case.name, _said(a), *(
            "-" if value is None else f"{value:.2f}"
            for value in (a.before, (a.document.get("error") or {}).get("after"))))
        for a in sorted(wrong, key=lambda a: (list(FAMILIES).index(a.case.family), a.case.name))))


def _said(answer: Answer) -> str:
    names, o = " + ".join(c["effect"] for c in answer.outcome.causes), answer.outcome
    if o.verdict not in PRESENT and names:
        return f"{o.verdict} (closest {names})"
    return f"{o.said} ({answer.document['bench']['said']})" if o.verdict == "fit_failed" else o.said


def _cell(one: Rate) -> str:
    return str(one) if one.count else "-"
