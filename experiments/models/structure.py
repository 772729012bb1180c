"""The structure of a model: checked, turned into torques of the estimator, and held against a motion's range."""

from __future__ import annotations

import math

import numpy as np

from daq import Dataset, FloatArray
from estimator.effects import Points, StateTorque, Table, Variable
from estimator.model import Mechanism
from estimator.prediction import Structure, outside_range
from estimator.signals import angle_column, torque_column
from experiments.models.mechanism_settings import build_mechanism
from experiments.models.schema import JointTorque, Model, StructureValues, TableInput, TorqueTable


def structure_fault(model: Model) -> str:
    """Faults of the model's structure; empty without any."""
    if model.structure is None:
        return ""
    joints = build_mechanism(model.mechanism).n
    for torque in model.structure.torques:
        tables = [v.joint for table in torque.tables for v in table.inputs]
        if max([torque.joint, *tables]) > joints:
            return f"`structure` names joint {max([torque.joint, *tables])}, the mechanism has {joints}"
        if not math.isfinite(torque.constant):
            return f"`structure` gives joint {torque.joint} a constant that is not finite"
        for table in torque.tables:
            count = math.prod(map(len, table.knots))
            if len(table.inputs) not in (1, 2) or len(table.knots) != len(table.inputs):
                return "`structure` has a table without one list of knots for each of one or two inputs"
            if any(len(k) < 2 or not (np.diff(k) > 0.0).all() or not np.isfinite(k).all() for k in table.knots):
                return "`structure` has knots that do not increase"
            if len(table.values) != count or len(table.std) != count or not np.isfinite(table.values).all():
                return f"`structure` has a table of {len(table.values)} values for {count} knots, or not finite ones"
    return ""


def laws_of(model: Model) -> tuple[StateTorque, ...]:
    """Torque laws of the model's structure, one a joint; empty without one."""
    if model.structure is None:
        return ()
    return tuple(StateTorque(torque.joint - 1, [_table(t) for t in torque.tables], torque.constant)
                 for torque in model.structure.torques)


def _table(values: TorqueTable) -> Table:
    shape = tuple(map(len, values.knots))
    return Table(tuple(Variable(v.variable, v.joint - 1) for v in values.inputs),
                 tuple(np.array(k) for k in values.knots), np.array(values.values).reshape(shape),
                 np.array(values.std).reshape(shape), values.directed)


def structure_values(structure: Structure) -> StructureValues:
    """The structure as a model file holds it."""
    return StructureValues(
        torques=tuple(JointTorque(joint=(one.law.joint or 0) + 1, constant=one.law.constant, noise_nm=one.noise_nm,
                                  tables=tuple(map(_values, one.law.tables))) for one in structure.torques),
        removed=structure.removed, removed_ci95=structure.removed_ci95 or (-math.inf, math.inf))


def _values(table: Table) -> TorqueTable:
    return TorqueTable(inputs=tuple(TableInput(variable=v.kind, joint=v.joint + 1) for v in table.variables),
                       directed=table.directed, knots=tuple(tuple(map(float, k)) for k in table.knots),
                       values=tuple(map(float, table.values.ravel())), std=tuple(map(float, table.std.ravel())))


def range_note(model: Model, q: FloatArray, v: FloatArray, u: FloatArray) -> str:
    """Words about a motion q, v (N, n) under torques u (N, n) that leaves the range of the structure; else empty."""
    nothing = np.zeros(len(q))
    at = Points(q.T, v.T, np.zeros_like(q.T), u.T, np.sign(v.T), nothing, nothing, nothing)
    found = outside_range(laws_of(model), at)
    if not found:
        return ""
    told = ", ".join(f"{words} in {share:.1%} of the samples" for words, share in found.items())
    return f"the motion leaves the range of the model's structure, which keeps its edge value there: {told}"


def range_note_of(model: Model, run: Dataset) -> str:
    """The same about a simulated run."""
    mechanism: Mechanism = build_mechanism(model.mechanism)
    q = np.stack([run[angle_column(mechanism, j)] for j in range(mechanism.n)], axis=-1)
    u = np.stack([_column(run, torque_column(mechanism, j)) for j in range(mechanism.n)], axis=-1)
    return range_note(model, q, np.gradient(q, run.time_s, axis=0), u)


def _column(run: Dataset, name: str) -> FloatArray:
    return run[name] if name in run else np.zeros(len(run))
