"""The guess for a leg with an IMU or an encoder on its pivot, and a driven knee."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daq import Column, FloatArray
from daq.runs import IMU
from experiments.exchange.column_map import TIME, apply_map
from experiments.exchange.guess_names import MOST_RIVALS, WORDS, fitting, lacking, triad
from experiments.exchange.guess_physics import find_imu
from experiments.exchange.guess_result import GuessedMap
from experiments.exchange.guess_rivals import best_knee
from experiments.exchange.imported import ImportedFile
from experiments.exchange.units import unit_in_name


def guess_leg(imported: ImportedFile, columns: dict[str, Column], notes: dict[str, str], rivals: Sequence[Column],
               gravity_mps2: float) -> GuessedMap:
    """The guess for a leg by its knee's torque; without one by the error of the command that the knee follows."""
    triads = {kind: triad(imported, kind) for kind in ("gyro", "accel")}
    follows = "tau2_nm" not in columns
    torques = [] if follows else [Column(name=name, unit=unit_in_name(name, "tau2_nm")) for name in
                                  fitting(imported, "tau") if name != columns["tau2_nm"].name][:MOST_RIVALS]
    plain = [*(Column(name=name) for names in triads.values() for name in names), *rivals,
             *(Column(name=column.name) for column in torques)]
    spare = {f"q{k}_rad": column for k, column in enumerate(plain, 3)}
    raw = apply_map(imported, columns | spare)
    read = {column.name: raw[name] for name, column in spare.items()}
    warnings, unexplained = [], []
    pose: FloatArray | None = None
    curves: dict[str, tuple[FloatArray, FloatArray]] = {}
    if triads["gyro"] and len(triads["accel"]) >= 2:
        gyro, accel = ({name: read[name] for name in names} for names in triads.values())
        imu = find_imu(raw.rate_hz, gyro, accel, gravity_mps2)
        columns |= imu.columns
        notes |= imu.notes
        warnings += imu.warnings
        unexplained += imu.unexplained
        pose = imu.pose
        curves["accel_x_mps2: measured, and computed from gyro and gravity [m/s²]"] = imu.check
    elif "q1_rad" not in columns:
        raise lacking(imported, "a gyro and two axes of an accelerometer, or an angle of the pivot",
                       {kind: WORDS[kind] for kind in ("gyro", "accel")} | {"q1": WORDS["q1_rad"]})
    if follows:
        raw = replace(raw, columns={**raw.columns, "tau2_nm": raw["q2_cmd_rad"] - raw["q2_rad"]})
    others = {name: [(column, read[column.name]) for column in some]
              for name, some in (("q2_rad", rivals), ("tau2_nm", torques))}
    knee, why = best_knee(raw, columns, others, pose, gravity_mps2)
    notes |= why
    columns |= knee.columns
    notes |= {name: "\n".join(filter(None, (notes.get(name, ""), text))) for name, text in knee.notes.items()}
    what = "q2_cmd_rad - q2_rad: measured, and computed from the motion [rad]" if follows else \
        "tau2_nm: measured, and computed from the motion [N m]"
    curves[what] = knee.check
    warnings += knee.warnings
    unexplained += knee.unexplained
    if pose is not None and "q1_rad" in columns and not columns["q1_rad"].unit:
        del columns["q1_rad"]  # a benchmark only: without a unit it is of no use
        notes.pop("q1_rad", None)
    order = [TIME, *IMU, "q1_rad", "q2_rad", "q2_cmd_rad", "tau2_nm", "tau2_cmd_nm"]
    columns = {name: columns[name] for name in order if name in columns}
    return GuessedMap(columns, notes, warnings, unexplained, curves)
