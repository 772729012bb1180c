"""Runs of a rig tested one after the other, as they arrive, against its reference; an alarm is named."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from daq import Dataset, InputError, Rig
from daq.runs import started_at
from estimator import FitError
from estimator.change import Watch, detect_change, learn_reference, start_watch
from experiments.documents import WatchedRun
from experiments.models import Model, known_effects, reference_of
from experiments.session import Runs, prepare, require_one_rig, require_sound, setup_of
from experiments.workflows.change import SUFFIXES, runs_in
from experiments.workflows.diagnose import require_alike, without_benchmark

NAMED_BY = 4
"""Latest runs, at most, that name a change."""
POLL_S = 1.0
STALE_S = 60.0
"""A native run file without an end that does not grow for so long was cut off."""
MAGIC = b"\x89MCAP0\r\n"


@dataclass
class Watcher:
    """The test of a rig, and the runs since its last alarm."""

    rig: Rig
    test: Watch
    damaged: bool = False
    alarmed: list[Dataset] = field(default_factory=list)

    def watch(self, run: Path | str | Dataset) -> WatchedRun:
        """The next run, a file or a data set. One that cannot be read or used is not tested; the reason is given."""
        reference = self.test.reference
        try:
            prepared = prepare([run], self.rig, sensors=reference.fit.options.sensors, beta=reference.fit.model.beta,
                               damaged=self.damaged)
            setup = without_benchmark(prepared.setup)
            require_sound(setup)
        except (InputError, FitError) as error:
            name = run.name if isinstance(run, Dataset) else Path(run).name
            return WatchedRun(run=name, state="not tested", seconds=0.0, failed=str(error))
        recorded = None if isinstance(run, Dataset) or Path(run).suffix.lower() != ".mcap" else started_at(run)
        with threadpool_limits(1):
            data = setup.datasets[0]
            found = self.test.test(data)
            if found.alarm is not None or self.alarmed:
                self.alarmed = [*self.alarmed, data][-NAMED_BY:]
            change = detect_change(self.alarmed, reference) if len(self.alarmed) > 1 else None
        if change is not None and change.verdict == "no_change":
            self.alarmed = []
        return WatchedRun.of(found, change, recorded)


def watcher_of(against: Runs | Model, where: str, rig: Rig, false_alarms: float, damaged: bool = False) -> Watcher:
    """The test against reference runs, or against a model of the file `where`. Raises `InputError`, `FitError`."""
    known_effects()
    if isinstance(against, Model):
        if rig.terms.encoder_zero:
            raise InputError(where, "does not hold the encoders' zeros, which this rig declares to differ from run to "
                                    "run", "give the runs that it was fitted to")
        setup = setup_of([], rig, None if against.reference is None else against.reference.sensors)
        return Watcher(rig, start_watch(reference_of(against, where, setup.settings, setup.options), false_alarms),
                       damaged)
    prepared = prepare(against, rig, damaged=damaged)
    setup = without_benchmark(prepared.setup)
    require_one_rig(setup.datasets)
    require_alike(setup.datasets)
    require_sound(setup)
    try:
        with threadpool_limits(1):
            reference = learn_reference(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio)
            return Watcher(prepared.rig, start_watch(reference, false_alarms, setup.datasets), damaged)
    except np.linalg.LinAlgError as error:
        raise FitError(f"the reference runs give no reference: {error}") from None


def arrivals(places: Sequence[str], known: Sequence[str], follow: bool, sleep: Callable[[float], None] = time.sleep
             ) -> Iterator[str]:
    """Finished run files among `places`, none of `known`; with `follow` also those that arrive later, without end.

    Raises `InputError` for a place that is neither."""
    seen = {Path(file).resolve() for file in known}
    sizes: dict[Path, tuple[int, float]] = {}
    while True:
        for file in _present(places) if follow else runs_in(places):
            path = Path(file).resolve()
            if path not in seen and (not follow or _finished(path, sizes)):
                seen.add(path)
                yield file
        if not follow:
            return
        sleep(POLL_S)


def _present(places: Sequence[str]) -> list[str]:
    """Run files that are there; an empty folder is one to which runs will come."""
    for place in places:
        if not Path(place).exists():
            raise InputError(place, "does not exist", "make the folder, or name another")
    empty = [p for p in places if Path(p).is_dir() and not any(q.name.endswith(SUFFIXES) for q in Path(p).iterdir())]
    return runs_in([place for place in places if place not in empty])


def _finished(path: Path, sizes: dict[Path, tuple[int, float]]) -> bool:
    """Whether nobody writes `path` any more: a native run has its end, another file has not grown since the last
    look."""
    size = path.stat().st_size
    before, since = sizes.get(path, (-1, 0.0))
    now = time.monotonic()
    if size != before:
        sizes[path] = (size, now)
    if path.name.endswith(".mcap"):
        with path.open("rb") as file:
            file.seek(-min(len(MAGIC), size), 2)
            return (size > 2 * len(MAGIC) and file.read() == MAGIC) or (size == before and now - since > STALE_S)
    return size == before
