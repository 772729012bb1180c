"""`make changed-families`: is the change of one effect found on simulated and emulated legs that have small faults?

Every family of legs in turn, its small faults always there. Four runs are the reference; in four more runs one effect
is added, or none. Called again it goes on where it stopped.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

import legid
from daq import InputError, Rig, WorkError, load_rig
from estimator import FitError
from evidence.blind import geared, servo, stickslip
from evidence.blind.bench import generate
from evidence.blind.cases import TABLE_RATIO, Case, draw_case, strengths
from evidence.blind.effects import INSIDE
from evidence.blind.score import Rate
from evidence.blind.servo import RUNS as BOTH
from evidence.blind.servo import write_case
from evidence.blind.several_faults import TEN, together
from evidence.emulated_legs import leg_of, rig_in
from evidence.investigate import scaled
from evidence.kept import kept
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from experiments.documents import finite
from experiments.emulation import EFFECTS, Hidden, record_emulated
from experiments.excite import random_multisine
from experiments.workflows import find_change
from studies import machine
from tests.support.mujoco_leg import random_leg

SEED, RUNS, UNTOUCHED = 4042, 4, 5
"""... one case of so many has no change."""
STRENGTH = (0.3, 1.15)
"""Range of the added effect, in the family's ordinary strength."""
SMALL = 0.04
"""Share of the ordinary strength that is always there, where the family has no shares of its own."""
EMULATED_S, EMULATED_NM = 5.0, 0.7
HORIZON_S = 1.0
RATIOS = ((0.0, 1.3), (1.3, 2.0), (2.0, 4.0), (4.0, np.inf))
TWINS = {frozenset({"torque_offset", "asymmetric_friction"})}
"""No run tells these apart (docs/diagnosis.md)."""

Recorder = Callable[[str, float, np.random.Generator, Path], list[Path]]
"""(effect, strength, random numbers, folder) -> files of RUNS reference and RUNS later runs; rig.toml is with each."""


class Family(NamedTuple):
    """One make of legs."""

    legs: str
    effects: tuple[str, ...]
    """What may be added."""
    record: Recorder


class Outcome(NamedTuple):
    """One case."""

    family: str
    effect: str
    """`none` where nothing was added."""
    strength: float
    verdict: str
    causes: tuple[str, ...]
    ratio: float
    """Free-run error of the later runs over that of the reference runs, by the nominal model of the latter; infinite
    where the simulation diverges, NaN without a nominal model."""

    @property
    def hit(self) -> bool:
        return any(cause == self.effect or frozenset({cause, self.effect}) in TWINS for cause in self.causes)


def servo_runs(name: str, strength: float, rng: np.random.Generator, folder: Path) -> list[Path]:
    small = [servo.MAKERS[n](share * rng.uniform(0.7, 1.3)) for n, share in TEN.items()]
    before, now = together(small), together([*small, servo.MAKERS[name](strength)])
    leg, dry = replace(random_leg(rng), coulomb=(0.0, 0.0)), rng.uniform(0.02, 0.08)
    runs = (servo.record(leg, before if run < RUNS else now, dry, rng, run % RUNS, session_s=25.0 * (run % RUNS))
            for run in range(BOTH))
    write_case(name, 0, folder, runs, rng, leg, geared.RIG, [], dry)
    return _files(folder / f"{name}-0")


def geared_runs(name: str, strength: float, rng: np.random.Generator, folder: Path) -> list[Path]:
    leg, dry, runs = geared.record([geared.Hidden()] * RUNS + [geared.MAKERS[name](strength)] * RUNS, rng)
    write_case(name, 0, folder, runs, rng, leg, geared.RIG, [], dry)
    return _files(folder / f"{name}-0")


def stickslip_runs(name: str, strength: float, rng: np.random.Generator, folder: Path) -> list[Path]:
    small = [stickslip.MAKERS[n][0](SMALL * rng.uniform(0.7, 1.3)) for n in STICKSLIP]

    def changed(more: Callable[[stickslip.Readings], None]) -> Callable[[stickslip.Readings], None]:
        def change(readings: stickslip.Readings) -> None:
            for one in (*small, more):
                one(readings)
        return change

    before, now = (changed(stickslip.MAKERS[n][0](strength)) for n in ("none", name))
    leg, dry, runs = stickslip.record([before] * RUNS + [now] * RUNS, rng)
    write_case(name, 0, folder, runs, rng, leg, "", [], dry)
    return _files(folder / f"{name}-0")


def blind_runs(name: str, strength: float, rng: np.random.Generator, folder: Path) -> list[Path]:
    """Of the leg without the effect the first runs, of the same leg with it the last."""
    seed, ordinary = int(rng.integers(2**31)), strengths()
    plain = Case("calibrate", tuple(TEN), seed=seed)
    changed = replace(plain, effects=(*TEN, *[name] * (name != "none")))
    unit = np.sqrt((draw_case(plain, ordinary).target ** 2 - 1.0) / (TABLE_RATIO**2 - 1.0))
    table = {n: share * ordinary[n] / unit for n, share in TEN.items()}
    generate([plain], folder, table=table, with_ratio=False)
    generate([changed], folder / "changed", table=table | {name: strength * ordinary.get(name, 0.0) / unit},
             with_ratio=False)
    return [*_files(folder / plain.name)[:RUNS], *_files(folder / "changed" / changed.name)[RUNS:]]


def emulated_runs(name: str, strength: float, rng: np.random.Generator, folder: Path) -> list[Path]:
    number = int(rng.integers(2**31))
    small: dict[str, float] = {n: SMALL * rng.uniform(0.7, 1.3) for n in EFFECTS}
    before, now = _joined(small), _joined(small | ({name: strength} if name != "none" else {}))
    rig, text = rig_in(folder)
    files = [folder / f"run{k}.mcap" for k in range(BOTH)]
    for k, file in enumerate(files):
        record_emulated(file, rig, text, random_multisine(number + k, EMULATED_S, EMULATED_NM), number + k,
                        leg_of(SEED, number), before if k < RUNS else now)
    return files


def _joined(shares: Mapping[str, float]) -> Hidden:
    """The emulator's effects together, each with its share of the demo's size."""
    parts = [scaled(EFFECTS[name], share) for name, share in shares.items()]
    return Hidden("several", None, "", tuple(one for part in parts for one in part.body),
                  tuple(one for part in parts for one in part.torques), sum(part.torque_offset_nm for part in parts),
                  sum(part.gyro_bias_radps for part in parts), imu_late_s=sum(part.imu_late_s for part in parts))


def _files(folder: Path) -> list[Path]:
    return [folder / f"r{k}.csv" for k in range(1, BOTH + 1)]


def _known(names: Iterator[str] | Sequence[str] | Mapping[str, object], *left_out: str) -> tuple[str, ...]:
    return tuple(n for n in names if not n.startswith(("none", "outside")) and n not in left_out)


# the ten small faults of a leg whose faults are all in its readings
STICKSLIP = _known(stickslip.MAKERS, "torque_saturation")
FAMILIES: dict[str, Family] = {
    "servo": Family("MuJoCo under a position servo", _known(servo.MAKERS), servo_runs),
    "geared": Family("a soft gear with play, LuGre friction and a lag of the current", _known(geared.MAKERS),
                     geared_runs),
    "stick-slip": Family("event-driven stick-slip", _known(stickslip.MAKERS), stickslip_runs),
    # presliding takes a leg of three times the friction (`NEEDS`): reference and test would be of two legs
    "blind": Family("the blind bench's simulation", _known(INSIDE, "presliding_friction"), blind_runs),
    "emulated": Family("the emulated rig through the drivers", _known(EFFECTS), emulated_runs)}


def effect_of(family: str, turn: int) -> str:
    """Effect added at this turn of a family: each of a shuffled list, and none in every UNTOUCHED-th turn."""
    effects = FAMILIES[family].effects
    order = np.random.default_rng([SEED, list(FAMILIES).index(family)]).permutation(len(effects))
    return "none" if turn % UNTOUCHED == 0 else effects[order[(turn - 1 - turn // UNTOUCHED) % len(effects)]]


@kept
def outcome(family: str, turn: int) -> Outcome:
    """One case: its eight runs, the comparison, how much the change raises the error."""
    rng, name = np.random.default_rng([SEED, list(FAMILIES).index(family), turn]), effect_of(family, turn)
    strength = float(rng.uniform(*STRENGTH))
    with tempfile.TemporaryDirectory() as place:
        files = FAMILIES[family].record(name, strength, rng, Path(place))
        rig = load_rig(files[0].with_name("rig.toml"))
        found = find_change(files[RUNS:], files[:RUNS], rig).change
        runs = legid.load(files, rig)
        ratio = raised(runs[:RUNS], runs[RUNS:], rig)
    return Outcome(family, name, strength, found.verdict, tuple(dict.fromkeys(c.effect for c in found.causes)), ratio)


def raised(before: Sequence[legid.Dataset], now: Sequence[legid.Dataset], rig: Rig) -> float:
    """Free-run error of the runs `now` over that of `before`, by the nominal model of `before`: rms over the angles."""
    try:
        model = legid.model(legid.fit(before, rig, choose=False), before, rig)
    except (FitError, WorkError):
        return float("nan")
    errors = []
    for runs in (before, now):
        try:
            rows = legid.validate(model, runs, rig, horizons_s=(HORIZON_S,)).horizons
        except (FitError, InputError):
            return float("inf")
        errors.append(next({name: finite(error) for name, error in row.rmse.items()} for row in rows
                           if row.horizon_s == HORIZON_S))
    return float(np.sqrt(np.mean([(errors[1].get(name, np.inf) / error) ** 2 for name, error in errors[0].items()])))


def page(cases: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    rows = list[Outcome]()
    for number in within(minutes, range(cases)):
        turn, place = divmod(number, len(FAMILIES))
        rows.append(outcome(list(FAMILIES)[place], turn))
        print(number, rows[-1], flush=True)
    yield from [
        "# A change of one effect on legs with small faults", "",
        f"Made by `make changed-families MINUTES={minutes:g}` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, "
        f"{machine()}.", "",
        "Legs of five families with small faults that are always there. Four runs are the reference. In four more runs "
        f"one effect is added: {STRENGTH[0]:g} to {STRENGTH[1]:g} times the family's ordinary strength. "
        "`legid diagnose --against` compares them.", "",
        *(f"- {name}: {family.legs}" for name, family in FAMILIES.items()), "",
        f"{len(rows)} of {cases} cases were measured.", "",
        "| family | the effect is in the answer | `no_change` with an added effect | together with a second name "
        "| only wrong names | untouched: `no_change` |", "| --- | --- | --- | --- | --- | --- |",
        *(_rates(name, [row for row in rows if row.family == name]) for name in FAMILIES), _rates("in all", rows),
        "| wanted | 80 to 95 % by ratio | | | at most 3 % | 95 % |", "",
        f"The ratio is the free-run error over {HORIZON_S:g} s of the later runs over that of the reference runs, by "
        "the nominal model of the latter. It is the rms over the angles. A dash: that model did not converge.", "",
        "| ratio | the effect is in the answer | wanted |", "| --- | --- | --- |"]
    for (low, high), wanted in zip(RATIOS, ("", "80 %", "90 %", "95 %")):
        own = [row.hit for row in rows if row.effect != "none" and low <= row.ratio < high]
        yield f"| {f'{low:g} to {high:g}' if high < np.inf else f'{low:g} and more'} | {_rate(own)} | {wanted} |"
    yield from ["", "| family | added | strength | ratio | verdict | causes |",
                "| --- | --- | ---: | ---: | --- | --- |"]
    for r in sorted(rows, key=lambda row: (list(FAMILIES).index(row.family), row.effect, row.strength)):
        ratio = "-" if np.isnan(r.ratio) else f"{r.ratio:.3g}"
        yield f"| {r.family} | {r.effect} | {r.strength:.2f} | {ratio} | {r.verdict} | {', '.join(r.causes) or '-'} |"
    yield ""


def _rates(name: str, rows: Sequence[Outcome]) -> str:
    """A row of the table of rates."""
    changed, same = ([r for r in rows if (r.effect == "none") == untouched] for untouched in (False, True))
    cells = ([r.hit for r in changed], [r.verdict == "no_change" for r in changed],
             [r.hit and len(r.causes) > 1 and r.verdict != "one_of" for r in changed],
             [bool(r.causes) and not r.hit for r in rows], [r.verdict == "no_change" for r in same])
    return f"| {name} | {' | '.join(map(_rate, cells))} |"


def _rate(hits: Sequence[bool]) -> str:
    return str(Rate(sum(hits), len(hits)))


EVIDENCE = (
    Evidence("Is the change of one effect found on legs with small faults?", "make changed-families",
             "changed-families.md", 45, "80 to 95 % by ratio; untouched 95 %",
             (r"(the effect is in the answer) \|(?:.|\n)*?in all \| ([^|]*\))",
              r"(untouched: `no_change`) \|(?:.|\n)*?in all \|(?:[^|]*\|){4} ([^|]*\))")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, cases=(100, "at most"),
               minutes=(45.0, "after which no other case is begun"))
