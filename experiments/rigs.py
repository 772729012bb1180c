"""From a rig file to what the estimator takes: the mechanism, the options, the sensors, the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.columns import IMU
from daq.dataset import Dataset
from daq.errors import InputError
from daq.load import load_run
from daq.rig import Rig, joint_count
from estimator import mechanism as mechanisms
from estimator.mechanism import Mechanism
from estimator.options import FitOptions
from estimator.zeros import find_zeros, subtract, zeros_text
from experiments.model_file import MechanismSettings
from experiments.output import progress


@dataclass(frozen=True)
class Setup:
    """Everything a fit or a validation needs beside its method."""

    settings: MechanismSettings
    mechanism: Mechanism
    options: FitOptions
    datasets: tuple[Dataset, ...]
    notes: tuple[str, ...] = ()
    """What was done to the runs, in sentences."""


def load_setup(paths: Sequence[Path | str], rig: Rig, sensors: str | None = None,
               fixed: Mapping[str, float] | None = None, latent: str = "trajectory",
               beta: NDArray[np.float64] | None = None) -> Setup:
    """Runs read and aligned; the rest as `setup_of`. Raises `InputError`, and `FitError` as that does."""
    return setup_of(load_runs(paths, rig), rig, sensors, fixed, latent, beta)


def load_runs(paths: Sequence[Path | str], rig: Rig) -> tuple[Dataset, ...]:
    """Runs read, aligned, with the input that the mechanism is driven by. Raises `InputError`."""
    return tuple(prepare(load_run(path, rig), rig) for path in progress(list(paths), "reading runs", unit="run"))


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
        raise InputError("the rig file", str(error), "correct [mechanism] and [terms]") from None
    for name in fixed or {}:
        if name not in mechanism.names:
            raise InputError("--fix", f"{settings.model} has no parameter {name}",
                             f"it has {', '.join(mechanism.names)}")
    options = fit_options(rig, choose_sensors(rig, datasets, sensors), fixed or {}, latent)
    return zeroed(Setup(settings, mechanism, options, tuple(datasets)), rig, beta)


def zeroed(setup: Setup, rig: Rig, beta: NDArray[np.float64] | None = None) -> Setup:
    """`setup` less the encoders' zeros that its rig declares to differ from run to run; see `estimator.zeros`."""
    joints = [j - 1 for j in rig.terms.encoder_zero]
    known = beta if beta is not None and len(beta) == setup.mechanism.p else None
    if not joints or (len(setup.datasets) == 1 and known is None):  # one run says nothing of differences
        return setup
    zeros = find_zeros(setup.datasets, setup.mechanism, setup.options, joints, known)
    return replace(setup, datasets=subtract(setup.datasets, setup.mechanism, zeros),
                   notes=(*setup.notes, zeros_text(setup.datasets, zeros)))


def prepare(data: Dataset, rig: Rig) -> Dataset:
    """`data` with the input that the mechanism is driven by: for a servo on voltage, duty times volts.

    The column keeps its torque name; every parameter is then in volt units, and said to be.
    """
    if rig.mechanism.input != "voltage" or "duty" not in data:
        return data
    column = "tau1_n" if "q1_m" in data and "q1_rad" not in data else "tau1_nm"
    return replace(data, columns={**data.columns, column: data["duty"] * data["volts"]})


def mechanism_settings(rig: Rig, prismatic: bool = False) -> MechanismSettings:
    """The rig's mechanism as it goes into a model file."""
    m, terms = rig.mechanism, rig.terms
    return MechanismSettings(
        model=m.model, actuated=m.actuated, gravity_mps2=m.gravity_mps2, links=joint_count(m), input=m.input,
        prismatic=prismatic, lever_arm_m=rig.imu.lever_arm_m, rotor_inertia=terms.rotor_inertia,
        torque_offset=terms.torque_offset, friction_velocity_radps=terms.friction_velocity_radps)


def build_mechanism(s: MechanismSettings) -> Mechanism:
    """The estimator's mechanism, joints counted from 0 there. Raises ValueError for settings it cannot have."""
    actuated, rotors, offsets = (tuple(j - 1 for j in joints)
                                 for joints in (s.actuated, s.rotor_inertia, s.torque_offset))
    n = {"leg2": 2, "biped3": 3, "joint1": 1}.get(s.model, s.links)
    if any(j >= n for j in (*actuated, *rotors, *offsets)):
        raise ValueError(f"a joint above {n} is named, {s.model} has {n}")
    if s.input == "voltage" and s.model != "joint1":
        raise ValueError(f'input = "voltage" is for joint1, not {s.model}')
    if s.model == "leg2":
        return mechanisms.leg2(gravity_mps2=s.gravity_mps2, lever_arm=s.lever_arm_m, actuated=actuated,
                               rotor_inertia=rotors, torque_offset=offsets,
                               velocity_scale=s.friction_velocity_radps)
    if s.model == "chain":
        return mechanisms.chain(s.links, gravity_mps2=s.gravity_mps2, actuated=actuated, rotor_inertia=rotors,
                                torque_offset=offsets, velocity_scale=s.friction_velocity_radps)
    if rotors:
        raise ValueError(f"terms.rotor_inertia cannot be told from the inertia of {s.model}")
    if s.model == "biped3":
        if offsets:
            raise ValueError("terms.torque_offset is not part of biped3")
        return mechanisms.biped3(actuated=actuated, gravity_mps2=s.gravity_mps2)
    return mechanisms.joint1(gravity_mps2=s.gravity_mps2, prismatic=s.prismatic, actuated=actuated,
                             torque_offset=offsets, velocity_scale=s.friction_velocity_radps,
                             voltage=s.input == "voltage", lever_arm=s.lever_arm_m)


def choose_sensors(rig: Rig, datasets: Sequence[Dataset], wanted: str | None) -> str:
    """imu where every run has all three IMU columns, encoder otherwise; `wanted` decides if it can be met."""
    lacking = [d.name for d in datasets if not all(c in d for c in IMU)]
    if wanted == "imu" and lacking:
        raise InputError(lacking[0], "has no IMU columns " + ", ".join(IMU), "use --sensors encoder")
    if wanted == "imu" and rig.mechanism.model not in ("leg2", "joint1"):
        raise InputError("--sensors", f"{rig.mechanism.model} has no IMU model", "use --sensors encoder")
    sensors = wanted or ("imu" if rig.mechanism.model == "leg2" and not lacking else "encoder")
    if sensors == "encoder" and rig.mechanism.model == "leg2":
        for data in datasets:
            if "q1_rad" not in data:
                raise InputError(data.name, "has no column q1_rad for the encoder path",
                                 "give runs that all have it, or all have the IMU columns")
    return sensors


def fit_options(rig: Rig, sensors: str, fixed: Mapping[str, float], latent: str = "trajectory") -> FitOptions:
    """What the rig file knows, as the estimator's options."""
    noise = {name: level for name in ("gyro_radps", "accel_mps2", "torque_nm", "encoder_rad")
             if (level := getattr(rig.noise, name)) is not None}
    return FitOptions(sensors=sensors, hold=rig.sampling.hold, noise=noise, cutoff_hz=rig.filter.cutoff_hz,
                      filter_order=rig.filter.order, fixed=dict(fixed), latent=latent)
