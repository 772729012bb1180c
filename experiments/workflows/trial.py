"""`Bench`: trials of a set-up, each fitted to halves of the runs and held against the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import structs

from daq import Dataset, FloatArray, Rig
from estimator import FIT_ERRORS
from estimator.fitting import fit_admissible, fit_nominal
from estimator.model import lag
from estimator.prediction import SHORT_S, FittedModel, predict_filtered
from estimator.signals import split_signals
from experiments.session import load_runs, prepare, setup_of, with_delay

SEEN_HZ = 200.0
"""Predictions are held against the record on the grid next to this that has a whole part of its rate, whatever grid the
fit was on."""
RIGID = ("inertia", "gravity")


@dataclass(frozen=True)
class Trial:
    """One set-up, fitted to some runs and held against the others."""

    score: float
    """Mean over the joints of the log of error over that of the last velocity kept; infinite where none predicts."""
    rmse: FloatArray
    """(n,) error after up to `SHORT_S` on runs not fitted [rad]."""
    rigid: Mapping[str, float]
    """Inertias and gravity terms, mean of the fits."""
    encoder: float | None
    """The encoders' error that the fits found or took [rad]."""


class Bench:
    """Runs by grid, halves of them to fit and to hold the fit against."""

    def __init__(self, paths: Sequence[Path | str], rig: Rig, sensors: str | None, damaged: bool,
                 fixed: Mapping[str, float] | None) -> None:
        self.paths, self.sensors, self.damaged, self.fixed = list(paths), sensors, damaged, fixed
        self.grids: dict[float | None, tuple[Dataset, ...]] = {}
        self.names: frozenset[str] | None = None
        prepared = prepare(self.runs(rig), rig, sensors=sensors, fixed=fixed, choose=True)
        self.aside, self.terms = prepared.set_aside, prepared.choices
        gone = {run.run for run in self.aside}
        self.grids = {rig.sampling.rate_hz: tuple(data for data in self.runs(rig) if data.name not in gone)}
        self.paths = [p for p in self.paths if Path(p).name not in gone]
        silent = structs.replace(rig, sampling=structs.replace(rig.sampling, rate_hz=None))
        self.own_rate = self.runs(silent)[0].rate_hz
        """Of the records' own grid [Hz]."""
        self.delay = rig.timing.torque_delay_s
        """Which the runs have in them."""

    def runs(self, rig: Rig) -> tuple[Dataset, ...]:
        """On the grid of `rig`."""
        rate = rig.sampling.rate_hz
        if rate not in self.grids:
            self.grids[rate] = load_runs(self.paths, rig, self.damaged)
        return self.grids[rate]

    def seen(self, rig: Rig) -> tuple[Dataset, ...]:
        """On the grid of the comparison."""
        rate = self.own_rate / max(1, round(self.own_rate / SEEN_HZ))
        return self.runs(structs.replace(rig, sampling=structs.replace(rig.sampling, rate_hz=rate)))

    def between(self, rig: Rig) -> tuple[str, float]:
        """Hold between samples, and the delay beyond it [s], that are likeliest on the grid of `rig`."""
        setup = setup_of(self.runs(rig), rig, self.sensors, self.fixed)
        found = fit_nominal(setup.datasets, setup.mechanism, setup.options)
        return found.hold, sum(found.delays_s[:1])

    def trial(self, rig: Rig) -> Trial:
        """`rig` fitted to each half of the runs and held against the other.

        On a grid of other samples than the fit's, a torque acts as late as in the fit, and is smooth.
        """
        fitted, seen = self.runs(rig), self.seen(rig)
        delay_s = rig.timing.torque_delay_s[0] if rig.timing.torque_delay_s and self.delay is None else 0.0
        if delay_s:
            fitted = tuple(with_delay(data, delay_s) for data in fitted)
        halves = [(_half(fitted, k), _half(seen, 1 - k)) for k in (0, 1)]
        squares: list[FloatArray] = []
        plain: list[FloatArray] = []
        rigid: dict[str, list[float]] = {}
        levels: list[float] = []
        for train, held in halves:
            try:
                setup = setup_of(train, rig, self.sensors, self.fixed)
                found = fit_admissible(setup.datasets, setup.mechanism, setup.options)
                other = setup_of(held, rig, self.sensors, self.fixed, beta=found.beta)
                alike = same_rate(setup.datasets[0].rate_hz, other.datasets[0].rate_hz)
                late_s = delay_s + (0.0 if alike else lag(found.hold) / setup.datasets[0].rate_hz)
                own = [with_delay(data, late_s) for data in other.datasets] if late_s else other.datasets
                model = FittedModel(found.mechanism, found.hold if alike else "smooth", found.beta)
                signals = split_signals(own, found.mechanism, other.options)
                ahead = predict_filtered([model], signals, other.options, SHORT_S)
            except FIT_ERRORS:
                return Trial(np.inf, np.array([np.inf]), {}, None)
            if not found.converged or found.inadmissible or not np.isfinite(ahead.score(SHORT_S)):
                return Trial(np.inf, np.array([np.inf]), {}, found.noise.get("encoder_rad"))
            squares.append(np.array([ahead.rms(0, c, SHORT_S) ** 2 for c in ahead.angles]))
            plain.append(np.array([ahead.rms_kept(c, SHORT_S) ** 2 for c in ahead.angles]))
            levels += [found.noise["encoder_rad"]] if "encoder_rad" in found.noise else []
            for p, value in zip(found.mechanism.parameters, found.beta):
                if p.term in RIGID:
                    rigid.setdefault(p.name, []).append(float(value))
        rmse = np.sqrt(np.mean(squares, axis=0))
        score = float(np.mean(np.log(np.maximum(rmse, 1e-12) / np.maximum(np.sqrt(np.mean(plain, axis=0)), 1e-12))))
        return Trial(score, rmse, {name: float(np.mean(values)) for name, values in rigid.items()},
                     float(np.mean(levels)) if levels else None)


def _half(runs: Sequence[Dataset], k: int) -> list[Dataset]:
    """Every other run, from the k-th; of a single one its first or its second half."""
    if len(runs) > 1:
        return list(runs[k::2])
    middle = len(runs[0]) // 2
    return [runs[0].part(slice(0, middle) if k == 0 else slice(middle, None))]


def same_rate(one: float, other: float) -> bool:
    """Whether both grids have as many samples a second, to the jitter of a log."""
    return abs(one - other) <= 1e-3 * other


def errors_of(trial: Trial) -> str:
    """Its errors by joint, in words."""
    return "no prediction" if not np.isfinite(trial.score) else " and ".join(f"{x:.3g}" for x in trial.rmse)
