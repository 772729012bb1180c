"""A validation whose free runs are MuJoCo's: what was exported against what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daq import FloatArray
from estimator.prediction import PredictedRun, SmoothedRun, smooth, tabulate
from experiments.console import progress
from experiments.judge import validation_trust, with_fit_trust
from experiments.models import Model, fitted_model_of
from experiments.session import Prepared
from experiments.simulators import ExportedLeg, Piece, Record, Start, rows_of
from experiments.workflows.validate import ValidationReport

STEP_S = 0.0005
LOST_RAD = 50.0
"""A simulation this far from the smoothed motion is lost, as in the estimator's free runs."""


def validate_in_mujoco(model: Model, report: ValidationReport, where: str) -> ValidationReport:
    """`report` with the free runs of the exported model in MuJoCo, from the same states, under the measured torques.

    Raises `InputError` where the model cannot be exported, or MuJoCo is absent.
    """
    leg, runs, session_s = ExportedLeg(model, where), [], 0.0
    pairs = list(zip(report.table.runs, report.smoothed, strict=True))
    for run, smoothed in progress(pairs, "simulating in MuJoCo", unit="run"):
        runs.append(_rerun(leg, run, smoothed, session_s))
        session_s += smoothed.problem.total * smoothed.problem.dt
    table = tabulate(runs, report.table.smoother)
    trust = with_fit_trust(validation_trust(table, report.seen, report.told), model.trust)
    return replace(report, table=table, trust=trust, simulator="mujoco", own=report.table)


def compared_text(report: ValidationReport) -> str:
    """Lines: each sensor's error in MuJoCo over that of legid's simulation; empty where legid has simulated."""
    own, other = report.own, report.table
    if own is None:
        return ""
    lines = [f"MuJoCo's free runs against legid's own, whole runs, {other.runs[0].run} and on:"
             if len(other.runs) > 1 else "MuJoCo's free runs against legid's own, the whole run:"]
    for channel in own.judged:
        errors = [one.rms(0, channel, np.inf) for one in (own, other)]
        lines.append(f"  {channel}: {errors[1]:.4g} against {errors[0]:.4g} rms, "
                     f"{100.0 * (errors[1] / errors[0] - 1.0):+.2f} %")
    return "\n".join(lines)


def starts_of(model: Model, prepared: Prepared) -> list[Start]:
    """First state of each prepared run by the model's smoother. Raises `FitError`."""
    starts, session_s, predictor = [], 0.0, fitted_model_of(model)
    for data in progress(prepared.setup.datasets, "smoothing", unit="run"):
        one = smooth(predictor, data, prepared.setup.options, session_s)
        session_s += one.problem.total * one.problem.dt
        starts.append(Start(data.name.split(".")[0], one.state.x.q[0].tolist(), one.state.x.v[0].tolist()))
    return starts


def _rerun(leg: ExportedLeg, run: PredictedRun, smoothed: SmoothedRun, session_s: float) -> PredictedRun:
    """The run with MuJoCo's free runs at every horizon in place of the first model's."""
    simulated, lost = run.simulated.copy(), run.lost.copy()
    known: dict[int, tuple[FloatArray, int]] = {}
    for h, (horizon, starts) in enumerate(zip(run.horizons_s, run.starts)):
        firsts = np.unique(starts)
        if firsts.size not in known:
            known[firsts.size] = _pieces(leg, run, smoothed, firsts, session_s)
        simulated[0, h], gone = known[firsts.size]
        lost[0, h] = gone
        if np.isfinite(horizon) and gone:  # a piece that diverges is replaced by its first state
            bad = np.isnan(simulated[0, h]).any(axis=0)
            simulated[0, h][:, bad] = run.smoothed[0][:, starts[bad]]
    return replace(run, simulated=simulated, lost=lost)


def _pieces(leg: ExportedLeg, run: PredictedRun, smoothed: SmoothedRun, firsts: Sequence[int] | FloatArray,
            session_s: float) -> tuple[FloatArray, int]:
    """(C, N) readings of all pieces, NaN from where one diverges, and how many do."""
    problem, x = smoothed.problem, smoothed.state.x
    out, lost = np.full((len(run.channels), problem.total), np.nan), 0
    begins = [0, *(int(end) for end in run.ends)]
    edges = [*(int(first) for first in firsts), problem.total]
    for first, last in pairwise(edges):
        segment = int(np.searchsorted(run.ends, first, side="right"))
        begin, end = begins[segment], begins[segment + 1]
        record = Record(run.time_s[begin:end], problem.torque[begin:end][:, list(problem.mechanism.actuated)],
                        float(run.time_s[begin] - run.time_s[0]), session_s)
        piece = Piece(first - begin, last - begin, x.q[first], x.v[first])
        with np.errstate(all="ignore"):
            rows = rows_of(leg.run(record, piece, STEP_S), run.channels)
        gone = ~np.isfinite(rows).all(axis=0) | (np.abs(rows[: problem.n] - x.q[first:last].T) > LOST_RAD).any(axis=0)
        if gone.any():
            lost += 1
            rows[:, int(np.argmax(gone)) :] = np.nan
        out[:, first:last] = rows
    return out, lost
