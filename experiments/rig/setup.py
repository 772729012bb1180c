"""From a rig file to what the estimator takes: the mechanism, the options, the sensors, the runs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from daq import Dataset, InputError, Rig, joint_count
from daq.runs import imu_columns_of
from estimator import FitOptions
from estimator.calibration import DistanceMeter, angle_record, find_zeros, subtract, zeros_text
from estimator.fitting import has_torque
from estimator.model import Mechanism
from estimator.signals import STANCE, cut_steps
from experiments.console import detail, progress
from experiments.exchange import load_any_run
from experiments.models import MechanismSettings, build_mechanism, mechanism_settings
from experiments.rig.servo_law import with_law

FREE_SWING = "no joint is driven, for every torque of every run is exactly zero"


@dataclass(frozen=True)
class Setup:
    """Everything a fit or a validation needs beside its method."""

    settings: MechanismSettings
    mechanism: Mechanism
    options: FitOptions
    datasets: tuple[Dataset, ...]
    notes: tuple[str, ...] = ()
    """What was done to the runs, in sentences."""
    gear_ratio: float = 1.0
    """Of the motor."""


def load_setup(paths: Sequence[Path | str], rig: Rig, sensors: str | None = None,
               fixed: Mapping[str, float] | None = None, latent: str = "trajectory",
               beta: NDArray[np.float64] | None = None, damaged: bool = False) -> Setup:
    """Runs read and aligned; the rest as `setup_of`. Raises `InputError`, and `FitError` as that does."""
    return setup_of(load_runs(paths, rig, damaged), rig, sensors, fixed, latent, beta)


def load_runs(paths: Sequence[Path | str], rig: Rig, damaged: bool = False) -> tuple[Dataset, ...]:
    """Runs read, aligned, with the input that the mechanism is driven by.

    Raises `InputError`, for a run of whose file something is missing too, unless `damaged` ones are wanted, and
    `FitError` as `prepare`.
    """
    return tuple(prepare(require_whole(_loaded(path, rig), damaged), rig)
                 for path in progress(list(paths), "reading runs", unit="run"))


def _loaded(path: Path | str, rig: Rig) -> Dataset:
    started = time.monotonic()
    data = load_any_run(path, rig)
    detail(f"{path}: {len(data)} samples at {data.rate_hz:g} Hz, read in {time.monotonic() - started:.2f} s")
    return data


def require_whole(data: Dataset, damaged: bool = False) -> Dataset:
    """`data` itself. Raises `InputError` where something is missing of its file, unless `damaged` ones are wanted."""
    if "damaged" in data.sources and not damaged:
        raise InputError(data.name, f"is damaged: {data.sources['damaged']}",
                         "save what is whole with legid recover, or use it as it is with --damaged")
    return data


def damaged_runs(datasets: Sequence[Dataset]) -> list[dict[str, str]]:
    """Runs of whose files something is missing, and what: `damaged` of every document."""
    return [{"run": d.name, "what": d.sources["damaged"]} for d in datasets if "damaged" in d.sources]


def setup_of(datasets: Sequence[Dataset], rig: Rig, sensors: str | None = None,
             fixed: Mapping[str, float] | None = None, latent: str = "trajectory",
             beta: NDArray[np.float64] | None = None) -> Setup:
    """Mechanism and options by the rig, for runs that are in memory, less encoders' zeros that it declares: those by
    a known `beta` (p,), else beside beta.

    Raises `InputError`, and `FitError` where the zeros are not to be found.
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
    for name in fixed or {}:
        if name not in mechanism.names:
            raise InputError("--fix", f"{settings.model} has no parameter {name}",
                             f"it has {', '.join(mechanism.names)}")
    options = fit_options(rig, choose_sensors(rig, datasets, sensors), fixed or {}, latent)
    if rig.distance_meter is not None and (rig.distance_meter.sigma_m or rig.distance_meter.sigma_per_m):
        sigmas = [d["q1_sigma_rad"] for d in datasets if "q1_sigma_rad" in d]
        if sigmas:
            level = float(np.sqrt(np.nanmean(np.square(np.concatenate(sigmas)))))
            options = replace(options, noise={**options.noise, "encoder1_rad": level})
    doubts = (f"{d.name} is to be doubted: {d.sources['doubt']}" for d in datasets if "doubt" in d.sources)
    steps = (f"{d.name}: {d.sources['steps']}" for d in datasets if "steps" in d.sources)
    notes = (*[FREE_SWING] * free_swing, *doubts, *steps)
    return zeroed(Setup(settings, mechanism, options, tuple(datasets), notes, rig.motor.gear_ratio), rig, beta)


def zeroed(setup: Setup, rig: Rig, beta: NDArray[np.float64] | None = None) -> Setup:
    """`setup` less the encoders' zeros that its rig declares to differ from run to run; see `find_zeros`."""
    joints = [j - 1 for j in rig.terms.encoder_zero or ()]
    known = beta if beta is not None and len(beta) == setup.mechanism.p else None
    if not joints or (len(setup.datasets) == 1 and known is None):  # one run says nothing of differences
        return setup
    zeros = find_zeros(setup.datasets, setup.mechanism, setup.options, joints, known)
    return replace(setup, datasets=subtract(setup.datasets, setup.mechanism, zeros),
                   notes=(*setup.notes, zeros_text(setup.datasets, zeros)))


def prepare(data: Dataset, rig: Rig) -> Dataset:
    """`data` with the input that the mechanism is driven by: for a servo on voltage, duty times volts, for one without
    a torque channel what its law gives; with the absolute angle that a distance meter shows; and a walker's cut into
    steps.

    The column keeps its torque name; every parameter is then in volt units, and said to be. Raises `FitError`
    where a walker's steps cannot be told.
    """
    if rig.walker is not None:
        return walked(data, rig.walker.touchdown_s)
    if rig.distance_meter is not None and "distance_m" in data:
        d = rig.distance_meter
        data = angle_record(data, DistanceMeter(d.mount_m, d.gamma_rad, d.sigma_m, d.sigma_per_m), d.upright_rad)
    if rig.servo is not None and rig.servo.gain is not None:
        data = with_law(data, rig, rig.servo)
    if rig.mechanism.input != "voltage" or "duty" not in data:
        return data
    column = "tau1_n" if "q1_m" in data and "q1_rad" not in data else "tau1_nm"
    return replace(data, columns={**data.columns, column: data["duty"] * data["volts"]})


def walked(data: Dataset, open_s: float) -> Dataset:
    """A walker's record by role, and in its sources what was seen of its steps. Raises `FitError`."""
    cut, found = cut_steps(data, open_s)
    told = f"its column {STANCE} says" if STANCE in data else \
        f"its angles show, to {1e3 * float(found.open_s.max()):.1f} ms, for it has no column {STANCE}"
    return replace(cut, sources={**cut.sources, "steps": f"{found.time_s.size} touchdowns, as {told}"})


def choose_sensors(rig: Rig, datasets: Sequence[Dataset], wanted: str | None) -> str:
    """imu where the rig has IMUs (a leg always) and every run all their columns, encoder otherwise; `wanted` decides if
    it can be met."""
    columns, model = imu_columns_of(rig), rig.mechanism.model
    lacking = [d.name for d in datasets if not all(c in d for c in columns)]
    has_imu = model == "leg2" or (rig.imu is not None and model != "joint1")
    if wanted == "imu" and not has_imu and model != "joint1":
        raise InputError("--sensors", f"the rig file says of no IMU where it sits on this {model}",
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
    """What the rig file knows, as the estimator's options."""
    of_each = {"accel_mps2": ("accel_x_mps2", "accel_y_mps2"),
               "torque_nm": tuple(f"torque{j}_nm" for j in sorted(rig.mechanism.actuated)),
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
    rounding = "auto" if rig.terms.friction_velocity_radps is None else "given"
    joints = rig.mechanism.encoders
    encoders = None if joints is None else tuple(j - 1 for j in sorted(joints))
    return FitOptions(sensors=sensors, encoders=encoders, hold=rig.sampling.hold, rounding=rounding, noise=noise,
                      accel_correlation=rig.noise.accel_correlation, torque_correlation=rig.noise.torque_correlation,
                      cutoff_hz=rig.filter.cutoff_hz, filter_order=rig.filter.order, fixed=dict(fixed), latent=latent)
