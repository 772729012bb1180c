"""`follow_commands`: a model behind its position loops, driven by commanded angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Dataset, InputError, Rig, WorkError
from daq.runs import read_csv
from estimator.likelihood import Latents, Noise, State, free_run
from estimator.signals import (
    SignalSet,
    angle_column,
    command_columns,
    commands_of,
    encoder_of,
    imu_channels,
    imu_columns,
    torque_column,
    torque_of,
)
from experiments.models import Model, fitted_model_of


def follow_commands(model: Model, plan: Path | str, rig: Rig, where: str, start: Sequence[float] | None = None
                    ) -> Dataset:
    """Run of `model` from rest at `start` [rad] under the commands in the CSV file `plan`, by the loops of `rig`.

    Raises `InputError` for a rig without a loop and a plan without commands, `WorkError` where the motion diverges.
    """
    if rig.servo is None or rig.servo.gain is None:
        raise InputError("--rig", "states no gain under [servo]", "give the gain of the loop that follows the plan")
    fitted, table, driven = fitted_model_of(model), read_csv(plan, min_samples=2), sorted(rig.mechanism.actuated)
    m, time_s = fitted.mechanism, table.time_s - table.time_s[0]
    for j in driven:
        if command_columns(j - 1)[0] not in table.columns:
            raise InputError(f"{plan}, line 1", f"column {command_columns(j - 1)[0]} is missing",
                             "add the commanded angle in rad")
    q0 = np.zeros(m.n) if start is None else np.array(start, dtype=float)
    if q0.shape != (m.n,):
        raise InputError("--start", f"needs {m.n} finite angles", "give one for every joint")
    rate_hz = (time_s.size - 1) / float(time_s[-1])
    loops = {j: rig.servo.loop(k, rig.mechanism.input == "voltage") for k, j in enumerate(driven)}
    data = Dataset("plan", rate_hz, time_s, table.columns, loops=loops)
    still = np.zeros((time_s.size, m.n))
    imus = [name for k in range(len(m.imus) if model.mechanism.has_imu else 0) for name in imu_columns(k)]
    signals = SignalSet("plan", rate_hz, time_s, still + q0, still, dict.fromkeys(imus, np.zeros(time_s.size)),
                        commands=commands_of(data, m.n, slice(0, time_s.size)))
    noise = Noise(np.ones(m.n), np.ones(m.n))
    state = State(Latents(still + q0, still, still), fitted.parameters, noise, np.zeros((fitted.parameters.size,) * 2))
    run = free_run(fitted.problem([signals]), state)
    if run is None:
        raise WorkError("the simulated motion diverges; check the loop under [servo] and the model's parameters")
    columns = {angle_column(m, j): run.readings[encoder_of(j)] for j in range(m.n)}
    columns |= {torque_column(m, j): run.readings[torque_of(j)] for j in m.actuated}
    for k in range(len(imus) // 3):
        columns |= {name: run.readings[channel] for name, channel in zip(imu_columns(k), imu_channels(k))}
    columns |= {command_columns(j - 1)[0]: table.columns[command_columns(j - 1)[0]] for j in driven}
    return replace(data, name=f"simulated by {where}", columns=columns)
