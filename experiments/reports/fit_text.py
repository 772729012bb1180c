"""A fit as text for a terminal."""

from __future__ import annotations

import math
import re

import numpy as np

from estimator import FitResult
from experiments.console import text_table
from experiments.judge import number
from experiments.reports.budget import budget_lines
from experiments.reports.friction_form import friction_lines
from experiments.reports.prior_knowledge import HEADER as PRIOR_HEADER
from experiments.reports.prior_knowledge import measure_sentence, prior_rows, prior_sentence
from experiments.reports.run_agreement import agreement_lines
from experiments.reports.second_opinion import opinion_lines


def parameter_rows(result: FitResult) -> list[list[str]]:
    """name, value, std, 95 % interval, unit, meaning of every parameter."""
    rows = []
    for p, value, std, (low, high) in zip(result.mechanism.parameters, result.beta, result.std, result.ci95()):
        if p.name in result.open_parameters:
            rows.append([p.name, "not determined", "", "", p.unit, p.meaning])
            continue
        if p.name in result.fixed:
            spread, interval = "given", ""
        elif p.name in result.at_bound:
            spread, interval = "at its bound", f"0 .. {number(high)}"
        elif math.isfinite(std):
            spread, interval = number(float(std), float(std)), f"{number(low, std)} .. {number(high, std)}"
        else:
            spread, interval = "none", "not determined"
        rows.append([p.name, number(float(value), float(std)), spread, interval, p.unit, p.meaning])
    return rows


VOLTS = "The input is a voltage: every parameter is in volt units."
PARAMETER_HEADER = ["parameter", "value", "std", "95 % interval", "unit", "meaning"]
NOISE_NAMES = {"gyro_radps": "gyro", "accel_mps2": "accelerometer", "accel_x_mps2": "accelerometer x",
               "accel_y_mps2": "accelerometer y", "accel_correlation": "their correlation, as given",
               "torque_nm": "torque", "encoder_rad": "encoder", "passive_joint_nm": "passive joint, model error"}
OF_ONE_JOINT = re.compile(r"(torque|encoder)([0-9]+)_(?:nm|rad)")
OF_DISTURBANCE = re.compile(r"disturbance([0-9]+)_(nm|s)")
OF_ONE_IMU = re.compile(r"(gyro|accel)([0-9]+)(_[xy])?(_radps|_mps2)")


def noise_rows(result: FitResult) -> list[list[str]]:
    """(channel, level, unit) of each noise level. A common level is left out if each of its sensors has its own."""
    rows = []
    for name, level in result.noise.items():
        told, unit = _channel(result, name)
        several = any(map(OF_ONE_IMU.fullmatch, result.noise))
        if not ((name.endswith("_mps2") and name.replace("_mps2", "_x_mps2") in result.noise)
                or (several and name in ("gyro_radps", "accel_x_mps2", "accel_y_mps2"))
                or (name == "torque_nm" and any(map(OF_ONE_JOINT.fullmatch, result.noise)))):
            rows.append([told, f"{level:.3g}", unit])
    return rows


def _channel(result: FitResult, name: str) -> tuple[str, str]:
    """A noise channel in words, and its unit."""
    force, length = result.mechanism.force_unit, result.mechanism.length_unit
    units = {"gyro_radps": "rad/s", "accel_mps2": "m/s^2", "accel_x_mps2": "m/s^2", "accel_y_mps2": "m/s^2",
             "torque_nm": force, "encoder_rad": length, "passive_joint_nm": force}
    disturbance = OF_DISTURBANCE.fullmatch(name)
    if disturbance:
        told, unit = {"nm": ("disturbance", force), "s": ("its time constant", "s")}[disturbance[2]]
        return (f"{told} of joint {disturbance[1]}" if disturbance[2] == "nm" else told), unit
    joint = OF_ONE_JOINT.fullmatch(name)
    if joint:
        return f"{joint[1]} {joint[2]}", units[f"{joint[1]}_{'nm' if joint[1] == 'torque' else 'rad'}"]
    imu = OF_ONE_IMU.fullmatch(name)
    if imu:
        told, unit = (part[imu[1] + (imu[3] or "") + imu[4]] for part in (NOISE_NAMES, units))
        return f"{told} of IMU {imu[2]}", unit
    return NOISE_NAMES.get(name, name), units.get(name, "")


def run_noise_lines(result: FitResult) -> list[str]:
    """A line for each channel whose noise differs between runs: lowest and highest level, and the consequence."""
    found, lines = result.run_noise, list[str]()
    if found is None:
        return lines
    for name, own in found.levels.items():
        told, unit = _channel(result, name)
        quiet, noisy = int(np.argmin(own)), int(np.argmax(own))
        lines.append(f"noise of runs differs: {told} {own[quiet]:.3g} {unit} ({found.runs[quiet]}) to {own[noisy]:.3g} "
                     f"({found.runs[noisy]}); each run is weighted by its own level")
    return lines


def parameter_text(result: FitResult) -> str:
    """The table of the parameters."""
    return text_table(PARAMETER_HEADER, parameter_rows(result), right={1, 2, 3})


def fit_text(result: FitResult, model: str) -> str:
    """Text after a fit."""
    lines = [*([prior_sentence(result), ""] if result.prior else []),
             f"{model}, {result.method}, sensors {result.sensors}: {result.samples} samples, "
             f"{result.iterations} iterations, {result.wall_s:.2f} s, "
             + ("converged" if result.converged else "NOT CONVERGED"), "",
             parameter_text(result), ""]
    if result.noise:
        lines.append("noise (1 sigma): " + ", ".join(
            f"{name} {level} {unit}".rstrip() for name, level, unit in noise_rows(result)))
    lines += run_noise_lines(result)
    lines.append("torque residual (rms): " + ", ".join(
        f"joint {j + 1} {rms:.3g} {result.mechanism.force_unit}" for j, rms in enumerate(result.torque_residual_rms)))
    if result.mechanism.force_unit == "V":
        lines.append(VOLTS)
    if result.prior:
        lines += ["", text_table(PRIOR_HEADER, prior_rows(result), right={1, 2, 3, 4}), ""]
    lines += budget_lines(result)
    lines += friction_lines(result)
    lines += agreement_lines(result)
    lines += opinion_lines(result)
    lines += [f"not determined by this data: {name}" for name in result.undetermined]
    lines += [f"warning: {text}" for text in (*result.inadmissible, *result.warnings)]
    lines += [f"assumed: {text}" for text in result.assumptions]
    if advice := measure_sentence(result):
        lines.append(f"next: {advice}")
    return "\n".join(lines)
