"""The estimator's input from a rig and runs: the mechanism, the options, the runs less their zeros."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from daq import Dataset, Disturbance, FloatArray, InputError, Rig, did_you_mean, joint_count
from daq.runs import imu_columns_of
from estimator import FitOptions
from estimator.calibration import find_hanging, find_zeros, subtract, zeros_text
from estimator.effects import EncoderOffset, VelocityFilter
from estimator.fitting import has_torque
from estimator.model import HELD, HOLDS, Mechanism, body_values, ticks_of
from estimator.score import ONLY, STRUCTURE, TORQUE_GAIN, default_tolerances
from experiments.models import MechanismSettings, build_mechanism, mechanism_settings

SMOOTH = "smooth"
"""Hold of a torque that a loop makes of command and angle, which is known between samples, too."""
HIDDEN = ("gravity does not show where the joints of encoder_zero hang: measure that, and write it as offset under "
          "[columns], or let them swing freely")
FREE_SWING = "no joint is driven: every torque of every run is exactly zero"


@dataclass(frozen=True)
class Setup:
    """Everything a fit or a validation needs in addition to its method."""

    settings: MechanismSettings
    mechanism: Mechanism
    options: FitOptions
    datasets: tuple[Dataset, ...]
    notes: tuple[str, ...] = ()
    """What was done to the runs, in sentences."""
    gear_ratio: float = 1.0
    """Of the motor."""
    tolerances: Mapping[str, tuple[float, ...]] | None = None
    """Of `FitOptions`, for a fit that has a budget."""


def setup_of(datasets: Sequence[Dataset], rig: Rig, sensors: str | None = None,
             fixed: Mapping[str, float] | None = None, latent: str = "trajectory",
             beta: FloatArray | None = None) -> Setup:
    """Mechanism and options of `rig` for runs in memory, with the encoder zeros that it declares subtracted.

    The zeros are estimated with a known `beta` (p,), else together with beta. Raises `InputError`, and `FitError` if
    the zeros cannot be estimated.
    """
    settings = mechanism_settings(rig, prismatic=any("q1_m" in d and "q1_rad" not in d for d in datasets))
    try:
        mechanism = build_mechanism(settings)
    except ValueError as error:
        raise InputError("the rig file", str(error), "correct [mechanism], [terms] and [[imu]]") from None
    free_swing = bool(datasets and settings.actuated) and not has_torque(datasets, mechanism)
    if free_swing:
        settings = structs.replace(settings, actuated=())
        mechanism = build_mechanism(settings)
    followers = set.intersection(*(set(d.by_law) for d in datasets)) if datasets else set()
    mechanism = replace(mechanism, followers=tuple(sorted(j - 1 for j in followers if j - 1 in mechanism.actuated)))
    for name in fixed or {}:
        if name not in mechanism.names:
            raise InputError("--fix", f"{settings.model} has no parameter {name}",
                             f"it has {', '.join(mechanism.names)}")
    for name in rig.prior:
        if name not in (*mechanism.names, *body_values(mechanism)):
            bodies = f"; its bodies have {', '.join(body_values(mechanism))}" if body_values(mechanism) else ""
            raise InputError("the rig file", f"[prior] {name} is nothing that {settings.model} has",
                             f"it has {', '.join(mechanism.names)}{bodies}")
    options = fit_options(rig, choose_sensors(rig, datasets, sensors), fixed or {}, latent)
    if rig.servo is not None and mechanism.followers:
        options = replace(options, unknown_loop=() if rig.servo.delay_s is not None else ("delay_s",),
                          hold=SMOOTH if options.hold == "auto" else options.hold)
    if options.hold == "auto" and rig.timing.control_period_s is not None and datasets:
        options = replace(options, hold=hold_of(1.0 / (datasets[0].rate_hz * rig.timing.control_period_s)))
    if rig.distance_meter is not None and (rig.distance_meter.sigma_m or rig.distance_meter.sigma_per_m):
        sigmas = [d["q1_sigma_rad"] for d in datasets if "q1_sigma_rad" in d]
        if sigmas:
            level = float(np.sqrt(np.nanmean(np.square(np.concatenate(sigmas)))))
            options = replace(options, noise={**options.noise, "encoder1_rad": level})
    ages = {d.imu_age_s for d in datasets if d.imu_age_s is not None}
    aged = [f"the IMU's readings are used up to {1e3 * age:.3g} ms before their stamps: by its settings they are so old"
            for age in sorted(ages)]
    device = max((d.imu for d in datasets if d.imu is not None), key=lambda imu: imu.age_std_s, default=None)
    notes = (*[FREE_SWING] * free_swing, *aged, *(f"{d.name}: {d.steps}" for d in datasets if d.steps is not None))
    return zeroed(Setup(settings, mechanism, options, tuple(datasets), notes, rig.motor.gear_ratio,
                        stated_tolerances(rig.told_by(device), mechanism)), beta)


def stated_tolerances(rig: Rig, mechanism: Mechanism) -> dict[str, tuple[float, ...]] | None:
    """Those of the rig file; None where all are zero. Raises `InputError` for a name that no effect has."""
    found = dict(rig.tolerances)
    always = VelocityFilter.name, TORQUE_GAIN, ONLY
    known = always if set(found) <= set(always) else (*default_tolerances(), STRUCTURE, *always)
    joints = {str(j + 1) for j in range(mechanism.n)}
    for key in found:
        name, _, joint = key.partition("@")
        if name not in known or (joint and joint not in joints):
            raise InputError("the rig file", f"[tolerance] {key.replace('@', '.')} is no effect of this rig"
                             f"{did_you_mean(name, known)}", "legid effects lists them")
    return None if set(found) == {ONLY} else found


def hold_of(ticks: float) -> str:
    """Hold of a torque that a controller sets so many times from one sample to the next, and holds in between."""
    if ticks < 1.5:
        return HELD
    nearest = min((hold for hold in HOLDS if ticks_of(hold) > 1), key=lambda hold: abs(ticks_of(hold) - ticks))
    return "smooth" if ticks > 1.5 * ticks_of(nearest) else nearest


def zeroed(setup: Setup, beta: FloatArray | None = None) -> Setup:
    """`setup` less the encoders' zeros that its options declare to be unknown; see `find_zeros`.

    Where neither a model nor gravity shows what is common to all runs, their differences are taken off.
    """
    joints = setup.options.encoder_zeros
    known = beta if beta is not None and len(beta) == setup.mechanism.p else None
    if not joints:
        return setup
    zeros = find_hanging(setup.datasets, setup.mechanism, setup.options, joints) if known is None else None
    if zeros is None and known is None:
        setup = replace(setup, notes=(*setup.notes, HIDDEN))
        if len(setup.datasets) == 1:
            return setup
    elif zeros is not None and setup.tolerances is not None:  # what is known no better than that
        own = {f"{EncoderOffset.name}@{j + 1}": (float(std),) for j, std in zip(joints, zeros.std.max(axis=0))
               if std > default_tolerances()[EncoderOffset.name][0]}
        setup = replace(setup, tolerances={**own, **setup.tolerances})
    zeros = zeros or find_zeros(setup.datasets, setup.mechanism, setup.options, joints, known)
    return replace(setup, datasets=subtract(setup.datasets, setup.mechanism, zeros),
                   notes=(*setup.notes, zeros_text(setup.datasets, zeros)))


def choose_sensors(rig: Rig, datasets: Sequence[Dataset], wanted: str | None) -> str:
    """imu where the rig has IMUs (a leg always) and every run all their columns, encoder otherwise; `wanted` decides if
    it can be met."""
    columns, model = imu_columns_of(rig), rig.mechanism.model
    lacking = [d.name for d in datasets if not all(c in d for c in columns)]
    has_imu = model == "leg2" or (rig.imu is not None and model != "joint1")
    if wanted == "imu" and not has_imu and model != "joint1":
        raise InputError("--sensors", f"the rig file gives no IMU's place on this {model}",
                         "give link and lever_arm_m under [imu], or use --sensors encoder")
    if wanted == "imu" and lacking:
        raise InputError(lacking[0], "has no IMU columns " + ", ".join(columns), "use --sensors encoder")
    sensors = wanted or ("imu" if has_imu and not lacking else "encoder")
    if sensors == "encoder" and rig.mechanism.model == "leg2":
        for data in datasets:
            if "q1_rad" not in data:
                raise InputError(data.name, "has no column q1_rad for the encoder path",
                                 "give runs that all have it, or all have the IMU columns")
    return sensors


def fit_options(rig: Rig, sensors: str, fixed: Mapping[str, float], latent: str = "trajectory") -> FitOptions:
    """The estimator's options by the rig file."""
    of_each = {"accel_mps2": ("accel_x_mps2", "accel_y_mps2"),
               "torque_nm": tuple(f"torque{j}_nm" for j in sorted(rig.mechanism.actuated)),
               "passive_nm": tuple(f"passive{j}_nm" for j in range(1, joint_count(rig.mechanism) + 1)
                                   if j not in rig.mechanism.actuated),
               "encoder_rad": tuple(f"encoder{j + 1}_rad" for j in range(joint_count(rig.mechanism)))}
    noise: dict[str, float] = {}
    for name in ("gyro_radps", "accel_mps2", "torque_nm", "passive_nm", "encoder_rad"):
        level = getattr(rig.noise, name)
        if isinstance(level, tuple):
            noise |= dict(zip(of_each[name], level, strict=True))
        elif level is not None:
            noise[name] = level
    for k, imu in enumerate(rig.imus):
        own = k + 1 if len(rig.imus) > 1 else ""
        given = {f"gyro{own}_radps": imu.gyro_radps, f"accel{own}_mps2": imu.accel_mps2}
        noise |= {name: level for name, level in given.items() if level is not None}
    if rig.noise.disturbance is not None:
        noise |= disturbance_levels(rig.noise.disturbance, joint_count(rig.mechanism))
    smoothing = "auto" if rig.terms.friction_velocity_radps is None else "given"
    joints = rig.mechanism.encoders
    encoders = None if joints is None else tuple(j - 1 for j in sorted(joints))
    zeros = tuple(j - 1 for j in rig.terms.encoder_zero or ())
    return FitOptions(sensors=sensors, encoders=encoders, encoder_zeros=zeros, hold=rig.sampling.hold,
                      smoothing_velocity=smoothing, noise=noise,
                      prior={name: (entry[0], entry[1]) for name, entry in rig.prior.items()},
                      accel_correlation=rig.noise.accel_correlation, torque_correlation=rig.noise.torque_correlation,
                      cutoff_hz=rig.filter.cutoff_hz, filter_order=rig.filter.order, fixed=dict(fixed), latent=latent)


def disturbance_levels(declared: Disturbance, joints: int) -> dict[str, float]:
    """Level [N m] and time constant [s] of each joint's disturbance, as the estimator's options name them."""
    found: dict[str, float] = {}
    for name, values in (("nm", declared.torque_nm), ("s", declared.time_constant_s)):
        each = values if isinstance(values, tuple) else (values,) * joints
        found |= {f"disturbance{j + 1}_{name}": value for j, value in enumerate(each)}
    return found
