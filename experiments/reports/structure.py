"""The structure of a residual: in words, as a table, and its curves with their bands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from daq import FloatArray
from estimator import TWO_SIDED
from estimator.effects import Table as TorqueTable
from estimator.prediction import LearntTorque, Structure, words_of
from experiments.documents import DiagnosisDocument, Learnt, finite
from experiments.reports.figures import BLUE, HEIGHT_IN, INK, ORANGE, draw, finish
from experiments.reports.html import Picture, Section, Table

BINS = 40
UNITS = {"angle": "rad", "rate": "rad/s", "motor torque": "N m"}
NOT_COVERED = ("The bands are 95 % by the scatter of samples and between runs. They do not cover the model's "
               "parameters, the friction near rest and errors common to all runs.")
USE = "--model-out saves it under `structure`; simulate, validate and compare use it."


def structure_words(learnt: Learnt) -> str:
    """Sentences about the share of the error that the structure removes, with its interval, and its place."""
    low, high = map(finite, learnt.removed_ci95 or (None, None))
    return (f"A function of the state that repeats in all runs removes {100.0 * learnt.removed:.0f} % "
            f"[{100.0 * low:.0f}, {100.0 * high:.0f}] of the free-run error on left-out runs. It is largest at joint "
            f"{learnt.where[0].joint}, as a function of {learnt.where[0].depends_on}.")


def structure_table(learnt: Learnt, unit: str) -> Table:
    """One row a torque, the largest first."""
    return Table(["joint", "function of", "rms torque", "noise level"],
                 [[str(one.joint), one.depends_on, f"{one.rms_nm:.3g} {unit}", f"{one.noise_nm:.3g} {unit}"]
                  for one in learnt.where], {2, 3}, "rms over the samples")


def structure_section(found: DiagnosisDocument, kept: Structure | None) -> Section | None:
    """The structure on the page of a diagnosis, its curves where they are `kept`; None without one."""
    if found.structure is None:
        return None
    pictures = [] if kept is None else [
        Picture(_curve(one, table, kept), f"Torque that joint {(one.law.joint or 0) + 1} takes in addition, as a "
                f"function of {words_of(table, one.law.joint or 0)}.") for one, table in _curves(kept)]
    return Section("Structure without a listed cause", [structure_words(found.structure), USE],
                   [structure_table(found.structure, found.force_unit)], pictures, [NOT_COVERED] if pictures else [])


def _curves(structure: Structure) -> Iterator[tuple[LearntTorque, TorqueTable]]:
    """Tables of one variable."""
    for one in structure.torques:
        yield from ((one, table) for table in one.law.tables if len(table.variables) == 1)


def _curve(torque: LearntTorque, table: TorqueTable, structure: Structure) -> str:
    """The table over its variable with its band, and the residuals less the other tables."""
    joint, (variable,), (knots,) = torque.law.joint or 0, table.variables, table.knots
    at = structure.samples.at
    alone = structure.samples.residual[:, joint] - torque.law.torque(at) + table.torque(at, joint)
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
        unit = structure.mechanism.unit
        finish(axes, 3, f"{variable.kind} of joint {variable.joint + 1} [{unit(UNITS[variable.kind])}]",
               f"torque{sense} [{unit('N m')}]")

    return draw(f"structure {joint} {words_of(table, joint)}", HEIGHT_IN + 0.4, paint)


def _binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres, means and standard errors of y over bins of equally many samples."""
    parts = np.array_split(np.argsort(x), min(BINS, max(1, x.size // 20)))
    return (np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts]),
            np.array([y[p].std() / np.sqrt(p.size) for p in parts]))
