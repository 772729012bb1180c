"""What differs between two sessions of a rig: both prepared together, so that they differ by their runs alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from daq import Dataset, InputError, Rig
from estimator import FitError
from estimator.change import Change, compare_sessions, detect_change
from experiments.models import known_effects
from experiments.session import Prepared, Runs, as_datasets, prepare, require_one_rig, require_sound
from experiments.workflows.diagnose import require_alike, without_benchmark

SUFFIXES = (".mcap", ".csv", ".csv.gz")
ZEROED = "the rig file declares that this encoder's zero differs from run to run, so it is taken off every run"


@dataclass(frozen=True)
class ChangeFound:
    """The answer, and what it was made from."""

    change: Change
    prepared: Prepared
    """Reference runs, then test runs."""


def find_change(runs: Runs, against: Runs, rig: Rig, damaged: bool = False) -> ChangeFound:
    """What differs between `runs` and the earlier runs `against` of the same rig. Raises `InputError` for runs that do
    not belong together."""
    return _found(detect_change, runs, against, "reference", "", rig, damaged)


def find_difference(a: Runs, b: Runs, names: tuple[str, str], rig: Rig, damaged: bool = False, pairs: int = 1
                    ) -> ChangeFound:
    """What differs between the sessions `a` and `b`, called `names`: sizes are those of b less those of a. `pairs` is
    the number of comparisons that are made. Raises `InputError` for runs that do not belong together."""
    def compare(test: Sequence[Dataset], reference: Sequence[Dataset], *more: Any, **options: Any) -> Change:
        return compare_sessions(reference, test, *more, pairs=pairs, **options)

    return _found(compare, b, a, *names, rig, damaged)


def _found(compare: Callable[..., Change], runs: Runs, against: Runs, before: str, after: str, rig: Rig, damaged: bool
           ) -> ChangeFound:
    """Both sessions prepared together, then compared; their runs are called by `before` and `after`."""
    known_effects()
    reference, test = ([replace(d, name=f"{name} {d.name}".strip()) for d in as_datasets(some, rig, damaged)]
                       for name, some in ((before, against), (after, runs)))
    prepared = prepare([*reference, *test], rig, damaged=damaged)
    setup = prepared.setup
    require_one_rig(setup.datasets)
    require_alike([replace(d, name=d.name.removeprefix(f"{before} ").removeprefix(f"{after} "))
                   for d in setup.datasets])
    setup = without_benchmark(setup)
    names = {d.name for d in reference}
    sides = [d for d in setup.datasets if d.name not in names], [d for d in setup.datasets if d.name in names]
    notes = (*prepared.warnings, *setup.notes)
    try:
        require_sound(setup)
        with threadpool_limits(1):
            found = compare(*sides, setup.mechanism, setup.options, gear_ratio=setup.gear_ratio)
    except FitError as error:
        found = Change("fit_failed", f"No comparison: {error}.")
    zeroed = tuple((f"encoder_offset@{j}", ZEROED) for j in prepared.rig.terms.encoder_zero or ())
    return ChangeFound(replace(found, warnings=(*found.warnings, *notes), not_testable=(*found.not_testable, *zeroed)),
                       prepared)


def session_names(places: Sequence[Sequence[str]]) -> list[str]:
    """Of each session's files or folder: the folder's name, or A, B, C, ... where these do not tell them apart."""
    names = [Path(own[0]).resolve().name if len(own) == 1 and Path(own[0]).is_dir() else "" for own in places]
    return names if all(names) and len(set(names)) == len(names) else [chr(ord("A") + k) for k in range(len(names))]


def runs_in(places: Sequence[str]) -> list[str]:
    """Run files among `places`; of a folder all run files in it, by name. Raises `InputError` for a folder without
    any."""
    found: list[str] = []
    for place in places:
        if not Path(place).is_dir():
            found.append(place)
            continue
        inside = sorted(str(p) for p in Path(place).iterdir() if p.name.endswith(SUFFIXES))
        if not inside:
            raise InputError(place, "holds no run file", "give a folder with .mcap, .csv or .csv.gz files")
        found += inside
    return found
