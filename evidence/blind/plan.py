"""Cases of `make evidence`: a family of legs, what is hidden, a seed; and the order in which they are diagnosed."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evidence.blind import bench, geared, outside, records, servo, several_faults, stickslip
from evidence.blind.cases import Case, draw_pair
from evidence.blind.effects import INSIDE, OUTSIDE
from tests.support.paths import REAL

HEALTHY = 8
"""Seeds of each healthy leg in a round: a fifth of a round of all families is healthy."""
BENCH, RECORDS = "bench", "records"
DRAWN = "pair"
"""Of the bench: two effects that the seed draws."""


def bench_case(hidden: str, seed: int) -> Case:
    """Case of the bench, of moderate level; `hidden` is its class, and the effect after a space."""
    kind, *effects = hidden.split()
    return Case(kind, draw_pair(seed) if kind == DRAWN else tuple(effects), seed=seed)


def make_bench(hidden: str, seed: int, out: Path) -> None:
    """As `servo.make_case`."""
    bench.generate([bench_case(hidden, seed)], out)


class Family(NamedTuple):
    """One make of legs."""

    legs: str
    make: Callable[[str, int, Path], None]
    """(hidden, seed, folder): writes the case's runs and rig file to a folder, its truth next to that, last."""
    hidden: tuple[str, ...]


FAMILIES: dict[str, Family] = {
    "servo": Family("MuJoCo under a position servo at 1 kHz", servo.make_case, tuple(servo.MAKERS)),
    "stickslip": Family("event-driven stick-slip, faults in the readings", stickslip.make_case,
                        tuple(stickslip.MAKERS)),
    "geared": Family("soft gear, play, LuGre friction, a dozen small faults", geared.make_case, tuple(geared.MAKERS)),
    "small_faults": Family("the servo's legs with ten small faults", several_faults.make_case, several_faults.NAMES),
    "outside": Family("the servo's legs, ten causes outside the library",
                      partial(servo.make_case, makers=outside.MAKERS), tuple(outside.MAKERS)),
    "pairs": Family("the servo's legs, two effects", partial(several_faults.make_case, always={}),
                    several_faults.PAIRS),
    BENCH: Family("own integration, open-loop torque; `deleted`: the effect is taken out of the library", make_bench,
                  ("none", *(f"single {name}" for name in INSIDE), DRAWN, *(f"outside {name}" for name in OUTSIDE),
                   *(f"deleted {name}" for name in INSIDE))),
    RECORDS: Family("real records, a fault put into their readings", records.make_case, records.NAMES)}


class PlannedCase(NamedTuple):
    """A case by its family, what is hidden in it, and the seed of everything else."""

    family: str
    hidden: str
    seed: int

    @property
    def name(self) -> str:
        """Of its folder; a family has each name once."""
        return bench_case(self.hidden, self.seed).name if self.family == BENCH else f"{self.hidden}-{self.seed}"

    @property
    def kind(self) -> str:
        """none, single, pair, outside, deleted, or record."""
        if self.family == RECORDS:
            return "record"
        if self.family == BENCH:
            return self.hidden.split()[0]
        if "+" in self.hidden:
            return "pair"
        return next((kind for kind in ("none", "outside") if self.hidden.startswith(kind)), "single")

    @property
    def effects(self) -> tuple[str, ...]:
        """What is hidden, as far as an effect of the library can name it; of `deleted` the effect that it lacks."""
        if self.family == BENCH and self.hidden == DRAWN:
            return draw_pair(self.seed)
        if self.family == RECORDS:
            fault = self.hidden.split(".")[1]
            return () if fault == records.UNTOUCHED else (fault,)
        return () if self.kind in ("none", "outside") else tuple(self.hidden.split(" ")[-1].split("+"))

    def make(self, out: Path) -> None:
        """Write its files below OUT; nothing where they are, whole: its truth is written last."""
        if not (out / f"{self.name}.truth.json").exists():
            FAMILIES[self.family].make(self.hidden, self.seed, out)


def one_round(number: int, families: Iterable[str], seed: int) -> list[PlannedCase]:
    """The cases of round `number` in random order: each cause with one seed, each healthy leg with HEALTHY."""
    base = seed + number * HEALTHY
    cases = [PlannedCase(family, hidden, base + k) for family in families for hidden in FAMILIES[family].hidden
             if not _untouched(hidden) for k in range(_seeds(family, hidden))]
    order = np.random.default_rng([seed, number]).permutation(len(cases))
    return [cases[k] for k in order]


def plan(families: Sequence[str], seed: int) -> Iterator[PlannedCase]:
    """Rounds without end, so that what is done at any time is a simple random sample of the last round begun.

    Untouched records come first, with one seed: each spoilt record is compared with its own.
    """
    for family in families:
        yield from (PlannedCase(family, hidden, seed) for hidden in FAMILIES[family].hidden if _untouched(hidden))
    number = 0
    while cases := one_round(number, families, seed):
        yield from cases
        number += 1


def choose(families: Iterable[str], words: Sequence[str], seeds: Sequence[int]) -> list[PlannedCase]:
    """Each case whose hidden name has one of `words` in it (all without words), with each of `seeds`."""
    return [PlannedCase(family, hidden, seed) for family in families for seed in seeds
            for hidden in FAMILIES[family].hidden if not words or any(word in hidden for word in words)]


def _seeds(family: str, hidden: str) -> int:
    return HEALTHY if PlannedCase(family, hidden, 0).kind == "none" or hidden == DRAWN else 1


def _untouched(hidden: str) -> bool:
    return hidden.endswith(f".{records.UNTOUCHED}")


def here(families: Iterable[str]) -> list[str]:
    """Those of the families whose data are on this machine: without the shared records all but theirs."""
    return [family for family in families if family != RECORDS or REAL.is_dir()]
