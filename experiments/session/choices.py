"""Entries that rig.toml leaves open, chosen from the records: terms, encoder zeros, friction smoothing velocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import structs

from daq import Dataset, Rig
from estimator import FIT_ERRORS
from estimator.calibration import find_differing, find_wrong, needed_terms
from estimator.model import settings_of
from estimator.prediction import filtered_motion
from estimator.signals import split_signals
from experiments.models import MechanismSettings, build_mechanism
from experiments.session.setup import Setup, setup_of

SPEED_SHARE = 1e-3
"""Friction smoothing velocity of a slide over its speed: the same as 0.005 rad/s for a joint at 5 rad/s."""


@dataclass(frozen=True)
class Choice:
    """One entry of rig.toml that the records chose."""

    table: str
    key: str
    value: Any
    why: str
    changes: str
    """What it changes, measured."""

    @property
    def entry(self) -> str:
        """Entry in the form of rig.toml."""
        value = list(self.value) if isinstance(self.value, tuple) else self.value
        return f"{self.key} = {value!r}".replace("'", '"') + f" under [{self.table}]"

    @property
    def document(self) -> dict[str, Any]:
        """For the JSON documents."""
        return {"table": self.table, "key": self.key, "value": self.value, "why": self.why, "changes": self.changes}

    def __str__(self) -> str:
        return f"chosen, where rig.toml is silent: {self.entry}, for {self.why}; {self.changes}"


def with_choices(rig: Rig, choices: Sequence[Choice]) -> Rig:
    """`rig` with the entries chosen."""
    for choice in choices:
        table = structs.replace(getattr(rig, choice.table), **{choice.key: choice.value})
        rig = structs.replace(rig, **{choice.table: table})
    return rig


def choose_terms(datasets: Sequence[Dataset], rig: Rig, sensors: str | None = None,
                 fixed: Mapping[str, float] | None = None) -> tuple[Choice, ...]:
    """Choices of rotor inertias, torque offsets, encoder zeros and smoothing velocity that `[terms]` leaves open."""
    bare = structs.replace(rig, terms=structs.replace(rig.terms, encoder_zero=()))
    setup = setup_of(datasets, bare, sensors, fixed)
    chosen: list[Choice] = []
    terms = rig.terms
    if setup.mechanism.length_unit == "m" and terms.friction_velocity_radps is None:
        chosen.append(_smoothing_velocity(setup))
    try:
        with np.errstate(all="ignore"):
            zeros = _zeros(setup) if terms.encoder_zero is None else []
            stated = bare if terms.encoder_zero is None else rig
            known = setup_of(datasets, with_choices(stated, [*chosen, *zeros]), sensors, fixed)
            chosen += _extra_terms(known, rig)  # which other zeros in every run would hide
            if terms.encoder_zero is None and chosen and not zeros:
                zeros = _zeros(setup_of(datasets, with_choices(bare, chosen), sensors, fixed))
            chosen += zeros
    except (*FIT_ERRORS, ValueError):  # too short or too still to ask; the fit itself says so
        pass
    return tuple(chosen)


def _smoothing_velocity(setup: Setup) -> Choice:
    speed = float(np.percentile(np.abs(np.concatenate(
        [k.qd.ravel() for k in filtered_motion(split_signals(setup.datasets, setup.mechanism, setup.options),
                                               setup.mechanism, setup.options)])), 99.0))
    value = float(f"{max(SPEED_SHARE * speed, 1e-9):.1g}")
    return Choice("terms", "friction_velocity_radps", value, f"a slide that moves at {speed:.2g} m/s",
                  "the friction smoothing velocity is a thousandth of that")


def open_terms(setup: Setup, rig: Rig) -> dict[str, tuple[int, ...]]:
    """Optional terms that `[terms]` leaves open, each with its joints (1-based)."""
    driven, has = setup.settings.actuated, settings_of(setup.settings.model)
    every = {"rotor_inertia": tuple(j for j in driven if j > 1), "torque_offset": driven}
    return {key: joints for key, joints in every.items() if joints and key in has and getattr(rig.terms, key) is None}


def wanted_terms(setup: Setup, rig: Rig, datasets: Sequence[Dataset]) -> Mapping[str, float]:
    """Those `open_terms` that predict other runs of `datasets` better; see `needed_terms`. None where too little moves.
    """
    wide: MechanismSettings = structs.replace(setup.settings, **open_terms(setup, rig))
    try:
        return needed_terms(datasets, build_mechanism(wide), setup.options) if wide != setup.settings else {}
    except (*FIT_ERRORS, ValueError):
        return {}


def _extra_terms(setup: Setup, rig: Rig) -> list[Choice]:
    terms, found = open_terms(setup, rig), wanted_terms(setup, rig, setup.datasets)
    out = []
    for key, why in (("rotor_inertia", "a rotor behind a gear"),
                     ("torque_offset", "a constant in the measured torque")):
        wanted = tuple(j for j in terms.get(key, ()) if f"{key}_{j}" in found)
        if wanted:
            falls = " and ".join(f"{100 * found[f'{key}_{j}']:.0f} %" for j in wanted)
            out.append(Choice("terms", key, wanted, why, f"it predicts slow torque of other runs {falls} better"))
    return out


def _zeros(setup: Setup) -> list[Choice]:
    found = find_differing(setup.datasets, setup.mechanism, setup.options)
    if found is None:
        wrong = find_wrong(setup.datasets, setup.mechanism, setup.options)
        if wrong is None:
            return []
        zeros, left = wrong
        hang = " and ".join(f"q{j + 1} hangs at {zero:.3f} {setup.mechanism.length_unit}, not at 0"
                            for j, zero in zip(zeros.joints, zeros.values.mean(axis=0)))
        return [Choice("terms", "encoder_zero", tuple(j + 1 for j in zeros.joints), hang,
                       f"with it {' and '.join(f'{100 * x:.0f} %' for x in left)} of slow torque's residual is left")]
    spread = " and ".join(f"{1e3 * s:.0f} mrad (p = {p:.1g})" for s, p in zip(found.spread, found.p_value))
    return [Choice("terms", "encoder_zero", tuple(j + 1 for j in found.joints),
                   f"zeros that differ from run to run by {spread}",
                   f"without them {' and '.join(f'{100 * x:.0f} %' for x in found.left)} of the slow torque is left")]
