"""Changes between two sessions of one rig: both prepared together, so that they differ by their runs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from daq import Dataset, InputError, Rig
from estimator import FitError
from estimator.change import Change, detect_change
from experiments.models import known_effects
from experiments.session import Prepared, as_datasets, prepare, require_one_rig, require_sound
from experiments.workflows.diagnose import require_alike, without_benchmark

SUFFIXES = (".mcap", ".csv", ".csv.gz")
ZEROED = "the rig file declares that this encoder's zero differs from run to run, so it is taken off every run"


@dataclass(frozen=True)
class ChangeFound:
    """The answer, and what it was made from."""

    change: Change
    prepared: Prepared
    """Reference runs, then test runs."""


def find_change(runs: Sequence[Path | str | Dataset], against: Sequence[Path | str | Dataset], rig: Rig,
                damaged: bool = False) -> ChangeFound:
    """Changes between `runs` and the earlier runs `against` of the same rig. Raises `InputError` for runs that do not
    belong together."""
    known_effects()
    reference = [replace(d, name=f"reference {d.name}") for d in as_datasets(against, rig, damaged)]
    prepared = prepare([*reference, *as_datasets(runs, rig, damaged)], rig, damaged=damaged)
    setup = prepared.setup
    require_one_rig(setup.datasets)
    require_alike([replace(d, name=d.name.removeprefix("reference ")) for d in setup.datasets])
    setup = without_benchmark(setup)
    names = {d.name for d in reference}
    before = [d for d in setup.datasets if d.name in names]
    after = [d for d in setup.datasets if d.name not in names]
    notes = (*prepared.warnings, *setup.notes)
    try:
        require_sound(setup)
        with threadpool_limits(1):
            found = detect_change(after, before, setup.mechanism, setup.options, gear_ratio=setup.gear_ratio)
    except FitError as error:
        found = Change("fit_failed", f"No comparison: {error}.")
    zeroed = tuple((f"encoder_offset@{j}", ZEROED) for j in prepared.rig.terms.encoder_zero or ())
    return ChangeFound(replace(found, warnings=(*found.warnings, *notes), not_testable=(*found.not_testable, *zeroed)),
                       prepared)


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
