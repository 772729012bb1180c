"""`legid calibrate shunt --weight`: holds with a known weight and without into the torque constant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray, InputError, Rig
from estimator.calibration import Holds, TorqueConstant, Weight, fit_torque_constant
from experiments.calibrate.outcome import Outcome, rounded

COMMAND_NM = 1e-5
"""A command that changes by less within a step of the grid is held."""
LEAST_HOLD_S = 0.8
LOOKED_AT = 0.5
"""Share of a hold, at its end, over which readings are averaged."""
STILL_RAD = 0.003
"""Standard deviation of the knee's angle at rest."""
MOVED_RAD = 0.01
"""A knee that moved by less since the hold before says nothing of the side that it came from."""
OVERSHOT_RAD = 0.004
"""One that came back by more than this rests on no known side of its friction."""
ASSUMED = (
    "friction as large in either direction at each of the two loads, and over the angles within 15 %",
    "a linear current sensor, a constant torque constant, no gear that gives back less than it takes",
    "the weight on the link's axis and rigidly fixed, its mass and arm as given",
    "the pivot's angle by gravity at rest, the knee's by its encoder",
)


class Found(NamedTuple):
    """Holds of one run."""

    current: FloatArray
    angle_rad: FloatArray
    side: FloatArray
    left_out: int
    """Holds that moved, came back, did not move since the one before, or are the first after a reversal: there friction
    has not turned round in full."""


def find_holds(run: Dataset, rig: Rig) -> Found:
    """Rests under a held command: mean current [A] less the shunt's offset, angle of link 2 [rad], side.

    Raises `InputError` where the run lacks a column or a hold.
    """
    by_imu = "accel_x_mps2" in run
    for column in ("tau2_nm", "tau2_cmd_nm", "q2_rad", *(("accel_x_mps2", "accel_y_mps2") if by_imu else ("q1_rad",))):
        if column not in run:
            raise InputError(run.name, f"has no column {column}", "record holds with legid record, with an IMU or a "
                             "pivot angle")
    held = np.concatenate(([False], np.abs(np.diff(run["tau2_cmd_nm"])) < COMMAND_NM, [False]))
    starts, stops = np.flatnonzero(np.diff(held.astype(int)) == 1), np.flatnonzero(np.diff(held.astype(int)) == -1)
    spans = [(int(a), int(b)) for a, b in zip(starts, stops) if (b - a) * run.dt_s >= LEAST_HOLD_S]
    if not spans:
        raise InputError(run.name, f"holds no torque for {LEAST_HOLD_S:g} s", "record a plan of legid excite --holds")
    rows, left_out, before, end, way = [], 0, None, 0, 0.0
    for a, b in spans:
        rest = slice(b - round(LOOKED_AT * (b - a)), b)
        knee = run["q2_rad"][rest]
        here, moved = float(np.mean(knee)), 0.0 if before is None else float(np.mean(knee)) - before
        path = run["q2_rad"][end:b] * np.sign(moved)
        overshot = float(np.nanmax(path)) - here * np.sign(moved)
        usable = (np.isfinite(knee).all() and float(np.std(knee)) < STILL_RAD and before is not None
                  and abs(moved) > MOVED_RAD and overshot < OVERSHOT_RAD and np.sign(moved) != -way)
        if by_imu:
            hip = float(np.arctan2(np.mean(run["accel_x_mps2"][rest]), -np.mean(run["accel_y_mps2"][rest])))
        else:
            hip = float(np.mean(run["q1_rad"][rest]))
        current = float(np.mean(run["tau2_nm"][rest])) / rig.calibration.torque_constant_nm_per_a
        if usable and np.isfinite((hip, current)).all():
            rows.append((current, hip + here, np.sign(moved)))
        elif before is not None:
            left_out += 1
        before, end, way = here, b, np.sign(moved)
    table = np.array(rows).reshape(-1, 3)
    return Found(table[:, 0], table[:, 1], table[:, 2], left_out)


def calibrate_torque_constant(bare: Sequence[Dataset], weighted: Sequence[Dataset], rig: Rig,
                              weight: Weight) -> Outcome:
    """Torque constant from runs without the weight and with it. Raises `InputError` or `FitError`."""
    found = [(find_holds(run, rig), load) for runs, load in ((bare, 0.0), (weighted, 1.0)) for run in runs]
    holds = Holds(np.concatenate([f.current for f, _ in found]), np.concatenate([f.angle_rad for f, _ in found]),
                  np.concatenate([f.side for f, _ in found]),
                  np.concatenate([np.full(f.current.size, load) for f, load in found]))
    fit = fit_torque_constant(holds, weight, rig.mechanism.gravity_mps2)
    old = rig.calibration.torque_constant_nm_per_a
    left_out = sum(f.left_out for f, _ in found)
    lines = [f"{holds.current.size} holds, {int(holds.weighted.sum())} of them with the weight; {left_out} left out: "
             "moving, or resting on an unknown side of their friction",
             f"torque constant: {fit.value:.5g} +- {fit.half:.2g} N m/A (95 %; by scatter "
             f"{fit.half_holds:.2g}, by friction {fit.half_friction:.2g})",
             f"rig.toml had {old:g}: the torque gain is {fit.value / old:.4f} +- {fit.half / old:.2g}",
             f"with it: friction {fit.friction_nm:.3g} N m, the link's own moment {fit.own_moment_kgm:.4g} kg m, "
             f"scatter of a hold {fit.residual_nm:.2g} N m, zero of the angle {fit.tilt_rad:+.3f} rad",
             "the interval assumes:", *(f"- {words}" for words in ASSUMED)]
    values = {"calibration": {"torque_constant_nm_per_a": rounded(fit.value),
                              "torque_constant_half_nm_per_a": rounded(fit.half)}}
    return Outcome("\n".join(lines), values, _warnings(fit, weight))


def _warnings(fit: TorqueConstant, weight: Weight) -> list[str]:
    found = []
    if not weight.mass_half_kg or not weight.arm_half_m:
        found.append("mass and arm were taken as exact: give --weight-error and --arm-error, an arm off by 1 % is a "
                     "constant off by 1 %")
    if abs(fit.tilt_rad) > 0.05:
        found.append(f"the weight shows a zero of the angle of {fit.tilt_rad:+.3f} rad: check knee_zero_rad and the "
                     "mount, or the weight does not sit on the link's axis")
    return found
