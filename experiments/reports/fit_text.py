"""A fit as text for a terminal."""

from __future__ import annotations

import math
import re

from experiments.documents import FitDocument, finite
from experiments.judge import Files, number, with_names
from experiments.reports.budget import budget_lines
from experiments.reports.html import Table
from experiments.reports.prior_knowledge import prior_sentence, prior_table
from experiments.reports.run_agreement import agreement_lines
from experiments.reports.second_opinion import opinion_lines


def parameter_table(fit: FitDocument) -> Table:
    """One row a parameter."""
    rows = []
    for p in fit.parameters:
        if p.value is None:
            rows.append([p.name, "not determined", "", "", p.unit, p.meaning])
            continue
        std, low, high = finite(p.std), *map(finite, p.ci95)
        if p.fixed:
            spread, interval = "given", ""
        elif p.at_bound:
            spread, interval = "at its bound", f"0 .. {number(high)}"
        elif math.isfinite(std):
            spread, interval = number(std, std), f"{number(low, std)} .. {number(high, std)}"
        else:
            spread, interval = "none", "not determined"
        rows.append([p.name, number(p.value, std), spread, interval, p.unit, p.meaning])
    return Table(["parameter", "value", "std", "95 % interval", "unit", "meaning"], rows, {1, 2, 3})


VOLTS = "The input is a voltage: every parameter is in volt units."
CHANNEL = re.compile(r"([a-z]+?)([0-9]*)((?:_[xy])?)_(radps|mps2|nm|rad|s)")
"""Kind, number of one of several, axis and unit of a noise channel."""


def noise_rows(fit: FitDocument) -> list[list[str]]:
    """(channel, level, unit) of each noise level. A common level is left out if each of its sensors has its own."""
    rows, levels = [], fit.levels
    numbered = {found[1] for found in map(CHANNEL.fullmatch, levels) if found and found[2]}
    for name, level in levels.items():
        if not ((name.endswith("_mps2") and name.replace("_mps2", "_x_mps2") in levels)
                or (name in ("gyro_radps", "accel_x_mps2", "accel_y_mps2") and numbered & {"gyro", "accel"})
                or (name == "torque_nm" and numbered & {"torque", "encoder"})):
            told, unit = _channel(fit, name)
            rows.append([told, f"{level:.3g}", unit])
    return rows


def _channel(fit: FitDocument, name: str) -> tuple[str, str]:
    """A noise channel in words, and its unit."""
    found = CHANNEL.fullmatch(name)
    if found is None:
        return {"accel_correlation": ("their correlation, as given", ""),
                "passive_joint_nm": ("passive joint, model error", fit.force_unit)}.get(name, (name, ""))
    kind, number, axis, unit = found.groups()
    told = f"{'accelerometer' if kind == 'accel' else kind}{axis.replace('_', ' ')}"
    if kind == "disturbance":
        told = "its time constant" if unit == "s" else f"disturbance of joint {number}"
    elif kind == "unseen":
        told = f"torque {number} between samples"
    elif number:
        told += f" {number}" if kind in ("torque", "encoder") else f" of IMU {number}"
    return told, {"radps": "rad/s", "mps2": "m/s^2", "nm": fit.force_unit, "rad": fit.length_unit, "s": "s"}[unit]


def run_noise_lines(fit: FitDocument) -> list[str]:
    """A line for each channel whose noise differs between runs: lowest and highest level, and the consequence."""
    found, lines = fit.noise_by_run, list[str]()
    if found is None:
        return lines
    for name, own in found.levels.items():
        told, unit = _channel(fit, name)
        quiet, noisy = own.index(min(own)), own.index(max(own))
        lines.append(f"noise of runs differs: {told} {own[quiet]:.3g} {unit} ({found.runs[quiet]}) to {own[noisy]:.3g} "
                     f"({found.runs[noisy]}); each run is weighted by its own level")
    return lines


def friction_lines(fit: FitDocument) -> list[str]:
    """A line for each joint: share of Coulomb friction in the energy that friction takes, with its 95 % interval."""
    return [f"friction of joint {one.joint}: its Coulomb part takes {100 * one.coulomb_share:.0f} % "
            f"[{100 * one.ci95[0]:.0f}, {100 * one.ci95[1]:.0f}] of the energy that friction takes, its viscous part "
            "the rest; legid diagnose tells whether another form is missing" for one in fit.friction]


def samples_text(fit: FitDocument) -> str:
    """Number of samples used, as text, page and notebook have it."""
    return f"{fit.samples} of {fit.recorded} samples" if fit.recorded > fit.samples else f"{fit.samples} samples"


def fit_text(fit: FitDocument) -> str:
    """Text after a fit, below its first lines."""
    lines = [*([prior_sentence(fit), ""] if fit.prior else []),
             f"{fit.model}, {fit.method}, sensors {fit.sensors}: {samples_text(fit)}, "
             f"{fit.iterations} iterations, {finite(fit.wall_s):.2f} s, "
             + ("converged" if fit.converged else "NOT CONVERGED"), "",
             parameter_table(fit).text, ""]
    if fit.noise:
        lines.append("noise (1 sigma): " + ", ".join(
            f"{name} {level} {unit}".rstrip() for name, level, unit in noise_rows(fit)))
    lines += run_noise_lines(fit)
    lines.append("torque residual (rms): " + ", ".join(
        f"joint {j + 1} {finite(rms):.3g} {fit.force_unit}" for j, rms in enumerate(fit.torque_residual_rms_nm)))
    if fit.force_unit == "V":
        lines.append(VOLTS)
    if fit.prior:
        lines += ["", prior_table(fit).text, ""]
    lines += budget_lines(fit)
    lines += friction_lines(fit)
    lines += agreement_lines(fit)
    lines += opinion_lines(fit)
    lines += [f"assumed: {text}" for text in fit.assumptions]
    lines += [f"not determined by this data: {name}" for name in fit.undetermined]
    if fit.measure_next is not None and fit.measure_next.text:
        lines.append(f"for narrower intervals: {fit.measure_next.text}")
    return "\n".join(lines)


def whole_fit_text(fit: FitDocument, files: Files | None = None) -> str:
    """Everything that `legid fit` prints. The next step names `files`."""
    return f"{with_names(fit.headline.text, files)}\n\n{fit_text(fit)}"
