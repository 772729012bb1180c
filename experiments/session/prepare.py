"""`prepare`: where every verb starts, from the shell and from Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec import structs

from daq import Dataset, Rig
from estimator import cores
from experiments.models import Model
from experiments.session.choices import Choice, choose_terms, with_choices
from experiments.session.flags import RunFlag, flags_of
from experiments.session.inputs import driven
from experiments.session.lost_samples import with_lost_samples, without_starts
from experiments.session.runs import load_runs
from experiments.session.setup import Setup, setup_of
from experiments.session.step_zeros import with_step_zeros
from experiments.session.usable import SetAside, usable_runs

Runs = Sequence[Path | str | Dataset]


@dataclass(frozen=True)
class Prepared:
    """Input of a verb, and the steps that prepared it."""

    setup: Setup
    """Mechanism, options and the runs that are used."""
    rig: Rig
    """With the choices in it."""
    set_aside: tuple[SetAside, ...] = ()
    """Runs that are not used."""
    choices: tuple[Choice, ...] = ()
    """Entries of `rig` that the records chose."""
    flags: tuple[RunFlag, ...] = ()
    """Of the runs that are used."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings to be read before the result: runs left out, and flags."""
        return (*map(str, self.set_aside), *map(str, self.flags))


def prepare(runs: Runs, rig: Rig, *, sensors: str | None = None, fixed: Mapping[str, float] | None = None,
            latent: str = "trajectory", model: Model | None = None, choose: bool = False, workers: int | None = 1
            ) -> Prepared:
    """The runs (files, or data sets) of a rig, ready for any verb, in their order.

    Every verb leaves out the runs that cannot be used. The flags say in what verbs differ:

    - `choose`: entries that the rig file leaves open are chosen by the records (fit, tune);
    - `model`: by its parameters encoders' zeros are found, and it has the terms that `rig` leaves open (validate,
      compare);
    - `sensors`, `fixed`, `latent`: as the command line gives them;
    - `workers`: forked processes, None: one a core (diagnose).

    Raises `InputError` for a run or a rig that cannot be read, and `FitError` where no run is left, or zeros or steps
    cannot be found.
    """
    rig = with_terms_of(rig, model)
    datasets = as_datasets(runs, rig)
    bare = setup_of(datasets, unzeroed(rig), sensors, fixed)
    known_zeros = with_step_zeros(bare.datasets, bare.mechanism, bare.options)
    in_time = without_starts(with_lost_samples(known_zeros, bare.mechanism, bare.options, workers or cores()),
                             bare.mechanism, bare.options)
    kept, gone = usable_runs(in_time, bare.mechanism, bare.options)
    if rig.sampling.as_read:
        kept, gone = tuple(replace(data, readings=tuple(replace(fault, done="kept") for fault in told.readings))
                           for data, told in zip(bare.datasets, in_time, strict=True)), ()
    choices = choose_terms(kept, rig, sensors, fixed) if choose else ()
    known = with_choices(rig, choices)
    beta = None if model is None else np.array(model.beta)
    return Prepared(setup_of(kept, known, sensors, fixed, latent, beta), known, gone, choices, flags_of(kept, rig))


def as_datasets(runs: Runs, rig: Rig, damaged: bool = False) -> tuple[Dataset, ...]:
    """Data sets with the input of the rig's mechanism; files among `runs` are read. Raises as `load_runs`."""
    files = iter(load_runs([run for run in runs if not isinstance(run, Dataset)], rig, damaged))
    return tuple(driven(run, rig) if isinstance(run, Dataset) else next(files) for run in runs)


def with_terms_of(rig: Rig, model: Model | None) -> Rig:
    """`rig` with the terms of `model` where it is silent about them: a fit may have chosen them."""
    if model is None:
        return rig
    silent = {key: getattr(model.mechanism, key) for key in ("rotor_inertia", "torque_offset", "encoder_zero")
              if getattr(rig.terms, key) is None}
    return structs.replace(rig, terms=structs.replace(rig.terms, **silent))


def unzeroed(rig: Rig) -> Rig:
    """`rig` without encoders' zeros of single runs."""
    return structs.replace(rig, terms=structs.replace(rig.terms, encoder_zero=()))
