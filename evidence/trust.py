"""`make trust`: of fits that say TRUST, are 95 % of the parameters within their intervals?

Legs with known parameters, half of them with a hidden effect, are fitted from one run and from eight, as `legid fit
RUNS --rig RIG --json` does. Real records with published values follow. Called again it goes on where it stopped.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

import legid
from daq import Dataset, InputError, Rig, WorkError, load_rig
from estimator import FitError
from evidence.blind.score import Rate
from evidence.frame import Lines, new_folder, program, share, table, tell, within
from evidence.kept import kept
from evidence.known_legs import FAMILIES, HEALTHY, NAMES, RUNS, Family, KnownLeg, hidden_at, make, short
from evidence.lab_legs import lab_leg
from evidence.machine_records import MACHINES, Machine
from evidence.machines import typed, unpack
from evidence.registry import Evidence
from experiments.session import as_datasets
from studies.casebook import RIGS, load_cases
from tests.support.paths import REAL

LAB = "tolerances"
"""Family whose faults are drawn from the default tolerances, the scale of the torque among them."""
EVERY_FAMILY = {**FAMILIES, LAB: Family("MuJoCo under a position servo, every fault drawn from its tolerance", (),
                                        lab_leg)}
WRONG = (0.5, 2.0)
"""Faults over the tolerances, in the table of tolerances that are wrong."""
SLOW, EVERY = "emulated", 4
"""A family whose legs take a minute each: one of its turns in so many."""
RIGID = NAMES[:5]
"""Inertias and gravity terms; the others are friction."""


class Outcome(NamedTuple):
    """One fit against the truth."""

    source: str
    """Family or record."""
    hidden: str
    runs: int
    sentence: str
    """First line, or the error of a fit that gives no values."""
    errors: Mapping[str, tuple[float, bool]]
    """Parameter -> error over standard deviation, and whether the 95 % interval has the truth."""
    half_widths: Sequence[float] = ()
    """Halves of the intervals of inertias and gravity terms, over the true values."""

    @property
    def trusted(self) -> bool:
        return self.sentence.startswith("TRUST the")


def outcome(source: str, hidden: str, runs: Sequence[Dataset], rig: Rig, truth: Mapping[str, float],
            fixed: Mapping[str, float] | None = None) -> Outcome:
    """The fit of these runs."""
    try:
        found = legid.fit(runs, rig, fixed=fixed).document
    except (FitError, InputError, WorkError) as error:
        return Outcome(source, hidden, len(runs), str(error), {})
    halves = [0.5 * (p["ci95"][1] - p["ci95"][0]) / abs(truth[p["name"]]) for p in found["parameters"]
              if p["name"] in RIGID and truth.get(p["name"]) and p["ci95"][0] is not None]
    return Outcome(source, hidden, len(runs), found["trust"]["sentence"], errors_of(found, truth), halves)


def errors_of(found: Mapping[str, Any], truth: Mapping[str, float]) -> dict[str, tuple[float, bool]]:
    """`Outcome.errors` of a fit's document; without parameters that are given, at a bound or not determined."""
    errors = {}
    for p in found["parameters"]:
        known = truth.get(p["name"])
        std = np.nan if p["std"] is None else p["std"]
        if known is not None and std > 0.0 and not p["fixed"] and not p.get("at_bound"):
            low, high = p["ci95"]
            errors[p["name"]] = float((p["value"] - known) / std), bool(low <= known <= high)
    return errors


def fits_of(source: str, hidden: str, known: KnownLeg) -> tuple[Outcome, ...]:
    """The fits of a leg from its first run and from all."""
    return tuple(outcome(source, hidden, known.runs[:count], known.rig, known.truth) for count in (1, RUNS))


@kept
def leg(family: str, turn: int, seed: int) -> tuple[Outcome, ...]:
    """The leg of this turn."""
    hidden = HEALTHY if family == LAB else hidden_at(family, turn)
    with new_folder() as folder:
        if family == LAB:
            known = lab_leg(hidden, np.random.default_rng([seed, turn]), folder)
        else:
            known = make(family, turn, seed, folder)
            known = known._replace(rig=structs.replace(known.rig, tolerance={"torque_gain": 0.0}))
    return fits_of(family, hidden, known)


@kept
def wrong(times: float, turn: int, seed: int) -> tuple[Outcome, ...]:
    """A leg whose faults are drawn from `times` the tolerances."""
    with new_folder() as folder:
        known = lab_leg(HEALTHY, np.random.default_rng([seed, turn, 1]), folder, times)
    return fits_of(f"{times:g}", HEALTHY, known)


@kept
def record(number: int) -> tuple[Outcome, ...]:
    """The fits of a case of the casebook to which values are published, all by the default method."""
    case = load_cases()[number]
    found = list[Outcome]()
    for task in case.fit:
        if task.published:
            rig = load_rig(RIGS / task.rig)
            runs = as_datasets([REAL / case.folder / run for run in task.runs], rig, False)
            found.append(outcome(case.folder, task.title, runs, rig, task.published, task.fix))
    return tuple(found)


@kept
def public(one: Machine, snapshot: Path) -> Outcome:
    """The fit of a public machine's records, typed as its page has it."""
    with new_folder() as folder:
        unpack(one, snapshot, folder)
        for command in one.commands:
            if not command.startswith(("legid validate", "legid diagnose")):
                done = typed(command, folder)
        if not (folder / "fit.json").exists():
            return Outcome(one.title, HEALTHY, 0, done.stderr.strip().splitlines()[-1], {})
        found = json.loads((folder / "fit.json").read_bytes())
    return Outcome(one.title, HEALTHY, 0, found["trust"]["sentence"], errors_of(found, one.published))


def cases(turns: int) -> Iterator[tuple[str, int]]:
    """(family, turn), turn by turn."""
    for turn in range(turns):
        yield from ((family, turn) for family in EVERY_FAMILY if family != SLOW or turn % EVERY in (0, 1))


def page(turns: int = 40, minutes: float = 60.0, seed: int = 6200, snapshots: str = "") -> Lines:
    rows, real = list[Outcome](), list[Outcome]()
    for family, turn in within(minutes, cases(turns)):
        rows += leg(family, turn, seed)
        for one in rows[-2:]:
            tell(turn, *one[:4], len(one.errors), sum(held for _, held in one.errors.values()))
    beyond = {times: list[Outcome]() for times in WRONG}
    for times, turn in within(minutes * len(WRONG) / 10.0, [(times, turn) for turn in range(turns) for times in WRONG]):
        beyond[times] += wrong(times, turn, seed)
    if REAL.is_dir():
        real += [one for number in range(len(load_cases())) for one in record(number)]
    if snapshots:
        real += [public(one, Path(snapshots) / one.repository.split("/")[1]) for one in MACHINES]
    families = [(name, kind, [one for one in rows if one.source == name and (one.hidden == HEALTHY) == healthy])
                for name in EVERY_FAMILY for kind, healthy in KINDS]
    yield from [
        "# Is TRUST right?",
        "Legs of seven families with known parameters. Every second leg has one hidden effect of the family's ordinary "
        f"strength. Each leg is fitted from its first run and from all {RUNS}, as `legid fit RUNS --rig RIG` does. The "
        "torque of these legs has the right scale, and their rig files say so; all other tolerances are the defaults. "
        "An eighth family has all faults at once, drawn from the default tolerances, that of the torque's scale too.",
        *(f"- {name}: {family.legs}" for name, family in EVERY_FAMILY.items()),
        "A fit is trusted if its first line begins with `TRUST the`. `TRUST WITH CARE` and `DO NOT TRUST` count as "
        "others. A share counts parameters; the intervals by Wilson take them as independent, which those of one fit "
        "are not. Distances are errors in standard deviations of the fit: median, 95th percentile. Friction counts "
        "only where the leg has the nominal model's law. The rotor of a geared leg is lumped into the parameters whose "
        "torque is nearest. Parameters at a bound and fits without values do not count. Half widths are medians over "
        "inertias and gravity terms.",
        f"{len(rows) // 2} legs were measured."]
    yield table(HEAD, [
        *(_line(f"{name}, {kind}", some) for name, kind, some in families if some),
        *(_line(f"in all, {kind}", [one for one in rows if (one.hidden == HEALTHY) == healthy])
          for kind, healthy in KINDS),
        *(_line(f"in all, {count} run{'s' * (count > 1)}", [one for one in rows if one.runs == count])
          for count in (1, RUNS)),
        _line("in all", rows)])
    yield table("trusted fits | inertias and gravity terms within | friction within", (
        f"{kind} | {_within(some, RIGID)} | {_within(some, NAMES[5:])}" for kind, healthy in KINDS
        for some in [[one for one in rows if one.trusted and (one.hidden == HEALTHY) == healthy]]))
    yield "Faults drawn from half and from twice the tolerances that the rig file says:"
    yield table(HEAD, (_line(f"faults {times:g} times the tolerances", some) for times, some in beyond.items()
                            if some))
    yield "Trusted fits that miss inertias or gravity terms:"
    yield table("family | hidden | runs | within | largest distance", _misses(rows))
    if real:
        yield "Real records against published values, which have errors of their own:"
        yield table("record | fit | first line | published values within | largest distance", (
            (one.source, one.hidden.replace(HEALTHY, "-"), short(one.sentence), *_held(one.errors.values()))
            for one in real))


KINDS = (("no effect", True), ("hidden effect", False))
HEAD = ("legs | fits | trusted | trusted: within | others: within | trusted: distance | others: distance | trusted: "
        "half width | others: half width")


def _line(name: str, rows: Sequence[Outcome]) -> tuple[object, ...]:
    """A row of the table of rates."""
    groups = [one for one in rows if one.trusted], [one for one in rows if not one.trusted]
    return (name, len(rows), Rate(len(groups[0]), len(rows)), *map(_within, groups), *map(_distance, groups),
            *map(_half_width, groups))


def _half_width(rows: Sequence[Outcome]) -> str:
    halves = [half for one in rows for half in one.half_widths]
    return f"{100 * np.median(halves):.2g} %" if halves else "-"


def _within(rows: Sequence[Outcome], names: Sequence[str] = NAMES) -> str:
    return share(inside for one in rows for name, (_, inside) in one.errors.items() if name in names)


def _held(errors: Iterable[tuple[float, bool]]) -> tuple[str, str]:
    """How many are within, and the largest distance."""
    every = list(errors)
    return (f"{sum(inside for _, inside in every)} of {len(every)}",
            f"{max(abs(z) for z, _ in every):.1f}" if every else "-")


def _distance(rows: Sequence[Outcome]) -> str:
    far = [abs(z) for one in rows for z, _ in one.errors.values()]
    return "{:.1f}, {:.1f}".format(*np.quantile(far, (0.5, 0.95))) if far else "-"


def _misses(rows: Sequence[Outcome]) -> Iterator[tuple[object, ...]]:
    """Rows of the table of trusted fits that miss most."""
    for one in rows:
        own = [one.errors[name] for name in RIGID if name in one.errors]
        if one.trusted and not all(inside for _, inside in own):
            yield one.source, one.hidden, one.runs, *_held(own)


EVIDENCE = Evidence(
    "Of fits that say TRUST, how many parameters are within their intervals?", "make trust", "trust-rates.md",
    60, "95 % of those of trusted fits",
    tuple(rf"({which}) \| \d+ \| [^|]*\| ([^|]*\))"
                   for which in ("in all, no effect", "in all, hidden effect", "in all")))
main = program(page)
