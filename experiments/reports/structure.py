"""The structure of a residual: in words, as rows, and its curves with their bands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from daq import FloatArray
from estimator import TWO_SIDED
from estimator.effects import Table as TorqueTable
from estimator.prediction import LearntTorque, Structure, where_of, words_of
from experiments.reports.diagnosis_figures import draw
from experiments.reports.figures import BLUE, HEIGHT_IN, INK, ORANGE, finish
from experiments.reports.html import Picture, Section, Table

HEADER = ["joint", "function of", "rms torque", "noise level"]
BINS = 40
UNITS = {"angle": "rad", "rate": "rad/s", "motor torque": "N m"}
NOT_COVERED = ("The bands are 95 % by the scatter of samples and between runs. They do not cover the model's "
               "parameters, the friction near rest and errors common to all runs.")
USE = "--model-out saves it under `structure`; simulate, validate and compare use it."


def structure_words(found: Structure) -> str:
    """Sentences about the share of the error that the structure removes, with its interval, and its place."""
    low, high = found.removed_ci95 or (np.nan, np.nan)
    (joint, inputs), *_ = where_of(found)
    return (f"A function of the state that repeats in all runs removes {100.0 * found.removed:.0f} % "
            f"[{100.0 * low:.0f}, {100.0 * high:.0f}] of the free-run error on left-out runs. It is largest at joint "
            f"{joint}, as a function of {inputs}.")


def structure_rows(found: Structure) -> list[list[str]]:
    """One row of HEADER a table of the structure, the largest torque first."""
    noise = {(one.law.joint or 0) + 1: one.noise_nm for one in found.torques}
    unit = found.mechanism.unit("N m")
    return [[str(joint), inputs, f"{rms:.3g} {unit}", f"{noise[joint]:.3g} {unit}"]
            for (joint, inputs), rms in where_of(found).items()]


def structure_section(found: Structure | None) -> Section:
    """The structure on the page of a diagnosis; empty without one."""
    title = "Structure without a listed cause"
    if found is None:
        return Section(title)
    return Section(title, [structure_words(found), USE],
                   [Table(HEADER, structure_rows(found), "rms over the samples", frozenset({2, 3}))],
                   [Picture(_curve(one, table, found), f"Torque that joint {(one.law.joint or 0) + 1} takes in "
                            f"addition, as a function of {words_of(table, one.law.joint or 0)}.")
                    for one, table in _curves(found)], [NOT_COVERED])


def _curves(found: Structure) -> Iterator[tuple[LearntTorque, TorqueTable]]:
    """Tables of one variable."""
    for one in found.torques:
        yield from ((one, table) for table in one.law.tables if len(table.variables) == 1)


def _curve(one: LearntTorque, table: TorqueTable, found: Structure) -> str:
    """The table over its variable with its band, and the residuals less the other tables."""
    joint, (variable,), (knots,) = one.law.joint or 0, table.variables, table.knots
    at = found.samples.at
    alone = found.samples.residual[:, joint] - one.law.torque(at) + table.torque(at, joint)
    x, y = variable.of(at), alone * np.sign(at.sign[joint]) if table.directed else alone
    centres, means, errors = _binned(x, y)

    def paint(axes: Any) -> None:
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.errorbar(centres, means, errors, fmt="o", color=BLUE, markersize=3.5, linewidth=1.0,
                      label="residual", zorder=3)
        half = TWO_SIDED * table.std
        axes.fill_between(knots, table.values - half, table.values + half, color=ORANGE, alpha=0.35, linewidth=0.0,
                          label="95 % band", zorder=2)
        axes.plot(knots, table.values, color=ORANGE, linewidth=1.6, label="structure", zorder=4)
        sense = " in the direction of motion" if table.directed else ""
        unit = found.mechanism.unit
        finish(axes, 3, f"{variable.kind} of joint {variable.joint + 1} [{unit(UNITS[variable.kind])}]",
               f"torque{sense} [{unit('N m')}]")

    return draw(f"structure {joint} {words_of(table, joint)}", HEIGHT_IN + 0.4, paint)


def _binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres, means and standard errors of y over bins of equally many samples."""
    parts = np.array_split(np.argsort(x), min(BINS, max(1, x.size // 20)))
    return (np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts]),
            np.array([y[p].std() / np.sqrt(p.size) for p in parts]))
