"""A model driven by a plan, as the run that its rig would have recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from daq import Dataset, FloatArray, InputError, WorkError
from daq.recording import Plan, read_plan
from estimator.model import Mechanism, simulate
from estimator.signals import (
    Channel,
    angle_column,
    encoder_of,
    imu_channels,
    imu_columns,
    imu_readings,
    torque_column,
    torque_of,
)
from experiments.exchange import is_native, load_to_convert
from experiments.models import Model, build_mechanism, noise_level, simulate_extended

MOST_SAMPLES = 10_000_000


def plan_for(path: Path | str, model: Model) -> Plan:
    """A torque plan, or the measured torque of a run's driven joint. Raises `InputError`."""
    torques = [f"tau{j}_{unit}" for j in model.mechanism.actuated for unit in ("nm", "n")]
    if not is_native(path):
        return read_plan(path, torques)
    run = load_to_convert(path, None, None)
    name = next((one for one in torques if one in run), None)
    if name is None or not (good := np.isfinite(run[name])).sum() > 1:
        raise InputError(str(path), f"holds no {torques[0]}", "give a run of the model's rig, or a plan as CSV")
    return Plan(run.time_s[good], run[name][good])


def simulate_run(model: Model, plan: Plan, where: str, rate_hz: float | None = None,
                 start: Sequence[float] | None = None, noise_seed: int | None = None) -> Dataset:
    """Run of `model` under `plan` from rest at `start` [rad], with the model's hold of the torque between samples.

    Raises `InputError` (the plan does not fit the mechanism) or `WorkError` (the motion diverges).
    """
    mechanism = build_mechanism(model.mechanism)
    if mechanism.exchanged:
        raise InputError(where, "is a walker, which falls under a plan: its controller keeps it up",
                         "legid validate carries it across a record's touchdowns, under the torques measured there")
    if len(mechanism.actuated) != 1:
        raise InputError(where, f"has {len(mechanism.actuated)} driven joints, a plan drives one",
                         "give a model with one actuated joint")
    q0 = np.zeros(mechanism.n) if start is None else np.array(start, dtype=float)
    if q0.shape != (mechanism.n,) or not np.isfinite(q0).all():
        raise InputError("--start", f"needs {mechanism.n} finite angles", "give one for every joint")
    rate = rate_hz or round(1.0 / float(np.median(np.diff(plan.time_s))), 6)
    if not plan.duration_s * rate <= MOST_SAMPLES:
        raise InputError("--rate", f"{rate:g} Hz gives {plan.duration_s * rate:.3g} samples of this plan",
                         f"give a rate of at most {MOST_SAMPLES / plan.duration_s:.3g} Hz, or a shorter plan")
    time_s = np.arange(max(round(plan.duration_s * rate), 2)) / rate
    command = plan.torque_nm[np.searchsorted(plan.time_s - plan.time_s[0], time_s + 1e-9, side="right") - 1]
    tau = np.zeros((time_s.size, mechanism.n))
    tau[:, mechanism.actuated[0]] = command
    try:
        with np.errstate(all="ignore"):  # what comes of it is looked at below
            columns = _extended_columns(model, mechanism, time_s, tau, q0) if model.effects or model.structure else \
                _nominal_columns(model, mechanism, tau, q0, rate)
    except (np.linalg.LinAlgError, ArithmeticError):  # a mass matrix without an inverse
        columns = {"": np.array([np.nan])}
    if not all(np.isfinite(values).all() for values in columns.values()):
        raise WorkError("the simulated motion diverges; check the model's parameters and the plan's torque")
    if noise_seed is not None:
        columns = _noisy(columns, model.noise, noise_seed)
    columns["tau2_cmd_nm"] = command
    return Dataset(f"simulated by {where}", rate, time_s, columns)


def _nominal_columns(model: Model, mechanism: Mechanism, tau: FloatArray, q0: FloatArray, rate: float
                     ) -> dict[str, FloatArray]:
    q, qd, qdd = simulate(mechanism, np.array(model.beta), q0, np.zeros(mechanism.n), tau, 1.0 / rate, model.hold)
    readings = {encoder_of(j): q[:, j] for j in range(mechanism.n)}
    readings |= {torque_of(j): tau[:, j] for j in mechanism.actuated}
    if model.mechanism.has_imu:
        readings |= imu_readings(mechanism, q.T, qd.T, qdd.T)
    return _columns(model, mechanism, readings)


def _extended_columns(model: Model, mechanism: Mechanism, time_s: FloatArray, tau: FloatArray, q0: FloatArray
                      ) -> dict[str, FloatArray]:
    return _columns(model, mechanism, simulate_extended(model, mechanism, time_s, tau, q0).readings)


def _columns(model: Model, mechanism: Mechanism, readings: Mapping[Channel, FloatArray]) -> dict[str, FloatArray]:
    """Readings by the estimator's channel as columns of the contract."""
    columns = {angle_column(mechanism, j): readings[encoder_of(j)] for j in range(mechanism.n)}
    driven = mechanism.actuated[0]
    columns[torque_column(mechanism, driven)] = readings[torque_of(driven)]
    for k in range(len(mechanism.imus) if model.mechanism.has_imu else 0):
        columns |= {column: readings[channel] for column, channel in zip(imu_columns(k), imu_channels(k))}
    return columns


def _noisy(columns: dict[str, FloatArray], noise: dict[str, float], seed: int) -> dict[str, FloatArray]:
    """White noise of the model's levels on every column that has one, correlated as the model says."""
    rng = np.random.default_rng(seed)
    rho = noise.get("accel_correlation", 0.0)
    draws = {name: rng.standard_normal(values.shape) for name, values in columns.items()}
    for name in [name for name in draws if rho and name.startswith("accel") and name.endswith("_y_mps2")]:
        draws[name] = rho * draws[name.replace("_y_", "_x_")] + np.sqrt(1.0 - rho**2) * draws[name]
    return {name: values + noise_level(noise, name) * draws[name] for name, values in columns.items()}
