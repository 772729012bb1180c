"""What rig.toml is silent about, chosen by the records: terms, encoders' zeros and error, friction's rounding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import structs

from daq import Dataset, InputError, Rig, Servo
from estimator import FitError, FitOptions, FitResult, Method
from estimator.calibration import find_differing, needed_terms
from estimator.fitting import measured_states, prediction_score
from estimator.model import Mechanism, settings_of
from experiments.models import MechanismSettings, build_mechanism
from experiments.rig import Setup, needs_law, prepare, setup_of
from experiments.workflows.fit import fit_setup
from experiments.workflows.servo_gain import scaled
from experiments.workflows.usable import SetAside, set_aside

SPEED_SHARE = 1e-3
"""Of a slide's speed, over which its friction's sign is rounded: what 0.005 rad/s is of a joint at 5 rad/s."""
NOISY = 0.2
"""Share of a torque's spread that, put down to noise, asks whether the angles err by more than their encoder shows."""
UNLIMITED = 1e6
"""Torque limit [rad of error] of a servo in units of its gain."""
DOUBTFUL = 0.25
"""Such a share that is left at the end is said: intervals take it for white. (On two real arms the published values lie
up to eight half widths away.)"""
LEVELS = (2.5, 6.0)
"""Times its estimate that an encoder's error is then taken to be, and ..."""
BETTER = 0.05
"""... the share by which the next second must be foretold better for it. (Measured on two real arms: 45 and 57 %.)"""


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
        """As it stands in rig.toml."""
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
    """Rotor inertias, torque offsets, encoders' zeros and friction's rounding, each where `[terms]` says nothing."""
    bare = structs.replace(rig, terms=structs.replace(rig.terms, encoder_zero=()))
    setup = setup_of(datasets, bare, sensors, fixed)
    chosen: list[Choice] = []
    terms = rig.terms
    if setup.mechanism.length_unit == "m" and terms.friction_velocity_radps is None:
        chosen.append(_rounding(setup))
    try:
        with np.errstate(all="ignore"):
            zeros = _zeros(setup) if terms.encoder_zero is None else []
            stated = bare if terms.encoder_zero is None else rig
            known = setup_of(datasets, with_choices(stated, [*chosen, *zeros]), sensors, fixed)
            chosen += _extra_terms(known, rig)  # which other zeros in every run would hide
            if terms.encoder_zero is None and not zeros:
                zeros = _zeros(setup_of(datasets, with_choices(bare, chosen), sensors, fixed))
            chosen += zeros
    except (FitError, np.linalg.LinAlgError, ValueError):  # too short or too still to ask; the fit itself says so
        pass
    return tuple(chosen)


def _rounding(setup: Setup) -> Choice:
    speed = float(np.percentile(np.abs(np.concatenate(
        [s.qd.ravel() for s in measured_states(setup.datasets, setup.mechanism, setup.options)])), 99.0))
    value = float(f"{max(SPEED_SHARE * speed, 1e-9):.1g}")
    return Choice("terms", "friction_velocity_radps", value, f"a slide that moves at {speed:.2g} m/s",
                  "friction's sign is rounded over a thousandth of that")


def _found_rounding(stated: Mechanism, found: Mechanism) -> list[Choice]:
    """The speed over which a fit rounded friction's sign off, where it is not the one stated."""
    if np.array_equal(found.velocity_scales, stated.velocity_scales):
        return []
    value = tuple(float(f"{speed:.2g}") for speed in found.velocity_scales)
    return [Choice("terms", "friction_velocity_radps", value, "friction that takes its full level over that speed",
                   "the likeliest of speeds from the default up")]


def _extra_terms(setup: Setup, rig: Rig) -> list[Choice]:
    settings, driven = setup.settings, setup.settings.actuated
    rotors = tuple(j for j in driven if j > 1) if "rotor_inertia" in settings_of(settings.model) else ()
    offsets = driven if "torque_offset" in settings_of(settings.model) else ()
    rotors = rotors if rig.terms.rotor_inertia is None else ()
    offsets = offsets if rig.terms.torque_offset is None else ()
    if not rotors and not offsets:
        return []
    wide: MechanismSettings = structs.replace(settings, rotor_inertia=rig.terms.rotor_inertia or rotors,
                                              torque_offset=rig.terms.torque_offset or offsets)
    found = needed_terms(setup.datasets, build_mechanism(wide), setup.options)
    out = []
    for key, joints, why in (("rotor_inertia", rotors, "a rotor behind a gear"),
                             ("torque_offset", offsets, "a constant in the measured torque")):
        wanted = tuple(j for j in joints if f"{key}_{j}" in found)
        if wanted:
            falls = " and ".join(f"{100 * found[f'{key}_{j}']:.0f} %" for j in wanted)
            out.append(Choice("terms", key, wanted, why, f"slow torque not fitted is foretold {falls} better"))
    return out


def _zeros(setup: Setup) -> list[Choice]:
    found = find_differing(setup.datasets, setup.mechanism, setup.options)
    if found is None:
        return []
    spread = " and ".join(f"{1e3 * s:.0f} mrad (p = {p:.1g})" for s, p in zip(found.spread, found.p_value))
    return [Choice("terms", "encoder_zero", tuple(j + 1 for j in found.joints),
                   f"zeros that differ from run to run by {spread}",
                   f"without them {' and '.join(f'{100 * x:.0f} %' for x in found.left)} of the slow torque is left")]


@dataclass(frozen=True)
class Fitted:
    """A fit with what was chosen for it."""

    setup: Setup
    result: FitResult
    rig: Rig
    """With the choices in it."""
    choices: tuple[Choice, ...]
    aside: tuple[SetAside, ...] = ()
    """Runs that were not used."""
    servo_gain: tuple[float, float, float] | None = None
    """Value and 95 % interval of a servo's gain that the fit found"""


def fit_runs(datasets: Sequence[Dataset], rig: Rig, sensors: str | None = None,
             fixed: Mapping[str, float] | None = None, latent: str = "trajectory", method: Method = "mle") -> Fitted:
    """`fit_setup`, with what `rig` is silent about chosen by the records and said among the assumptions.

    Raises `InputError` as `setup_of`, `FitError` as `fit_setup`.
    """
    if rig.servo is not None and rig.servo.gain is None and any(needs_law(data, rig) for data in datasets):
        return _with_gain(datasets, rig, rig.servo, sensors, fixed, latent, method)
    bare = structs.replace(rig, terms=structs.replace(rig.terms, encoder_zero=()))
    usable, aside = set_aside(setup_of(datasets, bare, sensors, fixed))
    datasets = usable.datasets
    choices = choose_terms(datasets, rig, sensors, fixed)
    known = with_choices(rig, choices)
    setup = setup_of(datasets, known, sensors, fixed, latent)
    result = fit_setup(setup, method)
    if method == "mle" and latent == "trajectory" and rig.noise.encoder_rad is None and result.converged:
        choice, setup, result = encoder_error(setup, result)
        choices = (*choices, *choice)
    told = list(map(str, aside))
    if (share := noise_share(result)) > DOUBTFUL:
        wide = result.agreement is not None and result.agreement.disagree
        narrow = "intervals allow for what runs disagree about alone" if wide else "intervals are too narrow"
        told.append(f"{100 * share:.0f} % of the torque's spread is left to noise, which is hardly white: {narrow}; "
                    "see what legid tune and legid diagnose find")
    result = replace(result, assumptions=(*result.assumptions, *map(str, choices)),
                     warnings=(*told, *result.warnings))
    choices = (*choices, *_found_rounding(setup.mechanism, result.mechanism))  # its fit has said so
    return Fitted(setup, result, with_choices(rig, choices), choices, aside)


def _with_gain(datasets: Sequence[Dataset], rig: Rig, servo: Servo, sensors: str | None,
               fixed: Mapping[str, float] | None, latent: str, method: Method) -> Fitted:
    """`fit_runs` of a servo whose gain is not known: in units of the gain, which the one parameter given then tells."""
    if fixed is None or len(fixed) != 1:
        raise FitError("nothing tells the servo's gain: give it as gain under [servo], or one parameter, as "
                       "--fix NAME=VALUE, by which the fit finds it")
    (name, value), = fixed.items()
    unit = structs.replace(rig, servo=structs.replace(servo, gain=1.0, limit=UNLIMITED))
    fitted = fit_runs([prepare(data, unit) for data in datasets], unit, sensors, None, latent, method)
    if name not in fitted.result.mechanism.names:
        raise InputError("--fix", f"{rig.mechanism.model} has no parameter {name}",
                         f"it has {', '.join(fitted.result.mechanism.names)}")
    result, gain, half = scaled(fitted.result, name, value)
    told = (f"the servo's gain is {gain:.4g} [{gain - half:.4g}, {gain + half:.4g}] "
            f"{'1/rad of duty' if rig.mechanism.input == 'voltage' else result.mechanism.force_unit + '/rad'}, by "
            f"{name} = {value:g}, which was given")
    found = structs.replace(fitted.rig, servo=structs.replace(servo, gain=gain))
    return replace(fitted, result=replace(result, assumptions=(told, *result.assumptions)), rig=found,
                   servo_gain=(gain, gain - half, gain + half))


def encoder_error(setup: Setup, result: FitResult) -> tuple[tuple[Choice, ...], Setup, FitResult]:
    """A larger error of the encoders than they show, such as play, where a fit that takes it for granted foretells the
    next second better; else what was given.

    Without it the likelihood holds on to angles that are off by play, and puts torque down to noise instead.
    """
    share = noise_share(result)
    if share < NOISY or "encoder_rad" not in result.noise:
        return (), setup, result
    states = measured_states(setup.datasets, setup.mechanism, setup.options)
    first = best = prediction_score(states, result.mechanism, result.beta, result.hold)
    found: tuple[tuple[Choice, ...], Setup, FitResult] = ((), setup, result)
    for times in LEVELS:
        level = float(f"{times * result.noise['encoder_rad']:.1g}")
        options: FitOptions = replace(setup.options, noise={**setup.options.noise, "encoder_rad": level})
        trial = replace(setup, options=options)
        try:
            tried = fit_setup(trial)
        except FitError:
            continue
        score = prediction_score(states, tried.mechanism, tried.beta, tried.hold)
        if tried.converged and not tried.inadmissible and score < best + np.log(1.0 - BETTER):
            best = score
            shown = result.noise["encoder_rad"]
            why = (f"angles that err by more than their encoder shows, {shown:.2g} (play, or time stamps that jitter): "
                   f"{100 * share:.0f} % of the torque's spread went for noise")
            gain = f"{100 * (1 - np.exp(best - first)):.0f} % better" if np.isfinite(first) else "at all"
            found = ((Choice("noise", "encoder_rad", level, why,
                             f"the next second is foretold {gain}"),),
                     trial, tried)
    return found


def noise_share(result: FitResult) -> float:
    """Torque that a fit puts down to noise, as a share of the spread of what was measured, at the worst joint."""
    mechanism: Mechanism = result.mechanism
    if not result.trajectories or not mechanism.actuated:
        return 0.0
    torque = np.concatenate([t.tau_measured for t in result.trajectories])[:, list(mechanism.actuated)]
    return float(result.noise.get("torque_nm", 0.0) / max(float(np.std(torque, axis=0).max()), 1e-300))
