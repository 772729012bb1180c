"""Differences between two sessions of a rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from msgspec import structs
from threadpoolctl import threadpool_limits

from daq import Dataset, InputError, Rig
from estimator import FitError
from estimator.change import Change, compare_sessions, detect_change, learn_reference
from experiments.console import note
from experiments.models import Model, known_effects, reference_of, reference_values_of
from experiments.session import (
    Prepared,
    Runs,
    SetAside,
    Setup,
    as_datasets,
    prepare,
    require_one_rig,
    require_sound,
)
from experiments.workflows.diagnose import require_alike, without_benchmark
from experiments.workflows.executor import Executor

SUFFIXES = (".mcap", ".csv", ".csv.gz")
ZEROED = "the rig file declares that this encoder's zero differs from run to run, so it is taken off every run"


@dataclass(frozen=True)
class ChangeFound:
    """The answer, and what it was made from."""

    change: Change
    prepared: Prepared
    """Runs of the first session, if these are given, then those of the second."""

    @property
    def set_aside(self) -> tuple[SetAside, ...]:
        """Runs that are not used."""
        return self.prepared.set_aside

    @property
    def datasets(self) -> tuple[Dataset, ...]:
        """Runs that are used."""
        return self.prepared.setup.datasets


def find_change(runs: Runs, against: Runs, rig: Rig) -> ChangeFound:
    """Change between `runs` and the earlier runs `against` of the same rig, all prepared together. Raises
    `InputError` for runs that do not belong together."""
    def compare(before: Sequence[Dataset], after: Sequence[Dataset], setup: Setup) -> Change:
        return detect_change(after, learn_reference(before, setup.mechanism, setup.options, setup.gear_ratio))

    return _found(compare, (against, runs), ("reference", ""), rig)


def find_difference(a: Runs, b: Runs, names: tuple[str, str], rig: Rig, pairs: int = 1) -> ChangeFound:
    """Change between the sessions `a` and `b`, called `names`: sizes are those of b less those of a. Both are
    prepared together. `pairs` is the number of comparisons that are made. Raises `InputError` for runs that do not
    belong together."""
    def compare(before: Sequence[Dataset], after: Sequence[Dataset], setup: Setup) -> Change:
        return compare_sessions(before, after, setup.mechanism, setup.options, gear_ratio=setup.gear_ratio,
                                pairs=pairs)

    return _found(compare, (a, b), names, rig)


@dataclass(frozen=True)
class SessionPair:
    """Two sessions to compare; what a worker is handed."""

    a: Sequence[Dataset]
    b: Sequence[Dataset]
    names: tuple[str, str]
    rig: Rig
    pairs: int
    """Number of comparisons that are made."""


def _difference(pair: SessionPair) -> ChangeFound:
    return find_difference(pair.a, pair.b, pair.names, pair.rig, pair.pairs)


def find_differences(pairs: Sequence[SessionPair], executor: Executor, done: Callable[[int, str], None]
                     ) -> list[ChangeFound]:
    """`find_difference` of each pair, in their order; `done(1, name)` is called for each as it finishes."""
    found: dict[int, ChangeFound] = {}
    for index, one in executor.run(_difference, pairs):
        found[index] = one
        done(1, pairs[index].names[1])
    return [found[index] for index in range(len(pairs))]


def _found(compare: Callable[[Sequence[Dataset], Sequence[Dataset], Setup], Change], sides: tuple[Runs, Runs],
           names: tuple[str, str], rig: Rig) -> ChangeFound:
    """Both sessions prepared together, their runs called by `names`, then compared."""
    known_effects()
    before, after = ([replace(d, name=f"{name} {d.name}".strip()) for d in as_datasets(some, rig)]
                     for name, some in zip(names, sides))
    prepared = prepare([*before, *after], rig)
    setup = without_benchmark(prepared.setup)
    require_one_rig(setup.datasets)
    first = {d.name for d in before}
    require_alike([replace(d, name=d.name.removeprefix(f"{names[d.name not in first]} ")) for d in setup.datasets])
    return _concluded(lambda: compare([d for d in setup.datasets if d.name in first],
                                      [d for d in setup.datasets if d.name not in first], setup), setup, prepared)


def _concluded(compare: Callable[[], Change], setup: Setup, prepared: Prepared) -> ChangeFound:
    try:
        require_sound(setup)
        with threadpool_limits(1):
            found = compare()
    except FitError as error:
        found = Change("fit_failed", f"No comparison: {error}.")
    zeroed = tuple((f"encoder_offset@{j}", ZEROED) for j in prepared.rig.terms.encoder_zero or ())
    return ChangeFound(replace(found, warnings=(*found.warnings, *prepared.warnings, *setup.notes),
                               not_testable=(*found.not_testable, *zeroed)), prepared)


def find_change_since(runs: Runs, model: Model, where: str, rig: Rig) -> ChangeFound:
    """Change against the runs that `model`, of the file `where`, was made from. Raises `InputError` for a
    model that does not hold what that needs, or is of another rig."""
    known_effects()
    if rig.terms.encoder_zero:
        raise InputError(where, "does not hold the encoders' zeros, which this rig declares to differ from run to run",
                         "give the runs that it was fitted to")
    sensors = None if model.reference is None else model.reference.sensors
    prepared = prepare(runs, rig, sensors=sensors)
    setup = without_benchmark(prepared.setup)
    require_one_rig(setup.datasets)
    require_alike(setup.datasets)
    reference = reference_of(model, where, setup.settings, setup.options)
    if reference.fit.model.mechanism.followers != setup.mechanism.followers:
        raise InputError(where, "is of runs in which the law of a position loop gives the torque of other joints than "
                         "in these", "give runs with the columns that its runs had")
    return _concluded(lambda: detect_change(setup.datasets, reference), setup, prepared)


def as_reference(model: Model, prepared: Prepared) -> Model:
    """`model` with what later runs are compared with, where the runs that it was made from allow it."""
    if prepared.rig.terms.encoder_zero:
        return model
    setup = without_benchmark(prepared.setup)
    try:
        require_sound(setup)
        with threadpool_limits(1):
            found = learn_reference(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio)
    except FitError as error:
        note(f"The model cannot be a reference for --against: {error}.")
        return model
    return structs.replace(model, reference=reference_values_of(found))


def session_names(places: Sequence[Sequence[str]]) -> list[str]:
    """Names of each session's files or folder: the folder's name, or A, B, C, ... if these are not distinct."""
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
