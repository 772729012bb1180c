"""`legid tune`: the set-up that predicts best what a fit has not seen, chosen entry by entry of rig.toml."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from daq import Dataset, FloatArray, InputError, Rig, set_values, write_file
from daq.runs import read_csv
from estimator import FitError
from estimator.fitting import fit_admissible
from estimator.prediction import SHORT_S, FittedModel, predict_filtered
from estimator.signals import split_signals
from experiments.console import text_table
from experiments.session import Choice, SetAside, load_runs, prepare, setup_of, with_choices
from experiments.workflows.fit import LEVELS

GRIDS_HZ = (25.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
MOST_SAMPLES = 60_000
"""Of all runs together, on the finest grid that is tried."""
FINEST_SEEN_HZ = 200.0
"""Grid on which predictions are held against the record, whatever grid the fit was on."""
GAIN = 0.03
"""Least relative reduction of the prediction error of held-out runs for an entry to change."""
SAME = 0.01
"""Relative difference of prediction errors below which grids count as equal; then the finest is chosen."""
DISAGREE = 0.05
"""Share of itself by which a parameter may differ between grids without a word."""
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


@dataclass
class Tuning:
    """Chosen entries, tried values and flags."""

    choices: list[Choice] = field(default_factory=list)
    aside: tuple[SetAside, ...] = ()
    before: Trial | None = None
    after: Trial | None = None
    tried: list[tuple[str, str, str]] = field(default_factory=list)
    """Entry, value, error on runs not fitted."""
    flags: list[str] = field(default_factory=list)

    @property
    def predicts(self) -> bool:
        """Whether any fit to half of the runs predicts the other half; if none does, nothing is chosen."""
        return self.after is not None and bool(np.isfinite(self.after.score))


def tune_runs(paths: Sequence[Path | str], rig: Rig, sensors: str | None = None, damaged: bool = False,
              done: Callable[[str, float], None] = lambda what, share: None,
              fixed: Mapping[str, float] | None = None) -> Tuning:
    """Entries of `rig` for these runs; those of `[terms]` that it states are kept, and parameters in `fixed` are given.

    An entry changes only where a fit with it predicts runs not fitted: a finite error. Raises `InputError`, `FitError`.
    """
    if rig.sampling.rate_hz is None:
        own = load_runs(paths, rig, damaged)[0].rate_hz
        rig = structs.replace(rig, sampling=structs.replace(rig.sampling, rate_hz=own))
    bench = _Bench(paths, rig, sensors, damaged, fixed)
    out = Tuning(aside=bench.aside)
    done("terms", 0.05)
    out.choices += bench.terms
    best_rig = with_choices(rig, out.choices)
    out.before = bench.trial(rig)
    best = bench.trial(best_rig) if out.choices else out.before
    if best.score > out.before.score + np.log(1.0 + GAIN):
        out.flags.append("the chosen terms predict the other runs worse than no terms: left out")
        out.choices, best_rig, best = [], rig, out.before
    entries = _entries(bench, rig, best)
    grids: dict[float, Trial] = {}
    for k, (table, key, values, why) in enumerate(entries):
        done(f"{table}.{key}", 0.1 + 0.85 * k / len(entries))
        now, start = getattr(getattr(best_rig, table), key), best
        chosen: Any = None
        for value in values(best):
            if value == now:
                continue
            candidate = with_choices(best_rig, [Choice(table, key, value, "", "")])
            trial = bench.trial(candidate)
            out.tried.append((f"[{table}] {key}", _text(value), _errors(trial)))
            if key == "rate_hz":
                grids[value] = trial
            if trial.score < best.score + np.log(1.0 - GAIN):
                best, chosen = trial, value
        if key == "rate_hz":
            grids[now] = start
            finest = _finest(grids, best.score, now)
            best, chosen = grids[finest], finest if finest != now else None
        if chosen is not None:
            change = f"error of held-out runs {_errors(start)} -> {_errors(best)}"
            out.choices.append(Choice(table, key, chosen, why, change))
            best_rig = with_choices(best_rig, out.choices[-1:])
    out.after = best
    if not out.predicts:
        out.choices = []
    out.flags += _disagreement(grids)
    return out


class _Bench:
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
        self.own_rate = _own_rate(self.paths, rig)

    def runs(self, rig: Rig) -> tuple[Dataset, ...]:
        """On the grid of `rig`."""
        rate = rig.sampling.rate_hz
        if rate not in self.grids:
            self.grids[rate] = load_runs(self.paths, rig, self.damaged)
        return self.grids[rate]

    def seen(self, rig: Rig) -> tuple[Dataset, ...]:
        """On the grid of the comparison."""
        rate = min(FINEST_SEEN_HZ, self.own_rate)
        return self.runs(structs.replace(rig, sampling=structs.replace(rig.sampling, rate_hz=rate)))

    def trial(self, rig: Rig) -> Trial:
        """`rig` fitted to each half of the runs and held against the other."""
        fitted, seen = self.runs(rig), self.seen(rig)
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
                signals = split_signals(other.datasets, found.mechanism, other.options)
                ahead = predict_filtered([FittedModel(found.mechanism, "linear", found.beta)], signals, other.options,
                                         SHORT_S)
            except (FitError, np.linalg.LinAlgError):
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


def _finest(grids: Mapping[float, Trial], least: float, now: float) -> float:
    """Of the grids that predict as well as the best, whose score is `least`, the finest; `now` where none predicts."""
    return max((rate for rate, trial in grids.items()
                if np.isfinite(trial.score) and trial.score <= least + np.log(1.0 + SAME)), default=now)


def _half(runs: Sequence[Dataset], k: int) -> list[Dataset]:
    """Every other run, from the k-th; of a single one its first or its second half."""
    if len(runs) > 1:
        return list(runs[k::2])
    middle = len(runs[0]) // 2
    return [runs[0].part(slice(0, middle) if k == 0 else slice(middle, None))]


def _own_rate(paths: Sequence[Path | str], rig: Rig) -> float:
    """Samples a second of the first run as it was recorded [Hz]."""
    path = Path(paths[0])
    if path.name.lower().endswith((".csv", ".csv.gz")):
        return float(1.0 / np.median(np.diff(read_csv(path, rig).time_s)))
    return rig.devices.controller.rate_hz if rig.devices.controller is not None else FINEST_SEEN_HZ


Entry = tuple[str, str, Callable[[Trial], Sequence[Any]], str]


def _entries(bench: _Bench, rig: Rig, first: Trial) -> list[Entry]:
    """Table, key, values to try given the best trial so far, and what they are for; entries stated stay."""
    runs = bench.runs(rig)
    seconds = sum(len(d) / d.rate_hz for d in runs)
    grids = [g for g in GRIDS_HZ if g <= 1.001 * bench.own_rate and g * seconds <= MOST_SAMPLES]
    entries: list[Entry] = [("sampling", "rate_hz", lambda best: grids, "the finest grid of those that predict best")]
    if rig.noise.encoder_rad is None:
        entries.append(("noise", "encoder_rad", lambda best: [float(f"{times * best.encoder:.1g}") for times in LEVELS]
                        if best.encoder else [], "angles that err by more than their encoder shows"))
    entries.append(("sampling", "hold", lambda best: ("linear", "average", "smooth", "zero"),
                    "how torque acts between samples"))
    if rig.filter.cutoff_hz is None:
        entries.append(("filter", "cutoff_hz", lambda best: (3.0, 5.0), "the band of starting values and wls"))
    return entries


def _disagreement(grids: Mapping[float, Trial]) -> list[str]:
    """Rigid parameters that depend on the grid, one sentence."""
    sound = {rate: t for rate, t in grids.items() if np.isfinite(t.score)}
    if len(sound) < 2:
        return []
    spread = {name: float(np.ptp([t.rigid[name] for t in sound.values()])
                          / max(abs(float(np.mean([t.rigid[name] for t in sound.values()]))), 1e-300))
              for name in next(iter(sound.values())).rigid}
    off = {name: share for name, share in spread.items() if share > DISAGREE}
    if not off:
        return []
    told = ", ".join(f"{name} by {100 * share:.0f} %" for name, share in off.items())
    return [f"parameters differ between grids of {min(sound):g} and {max(sound):g} Hz: {told}. "
            "The model lacks fast dynamics; the intervals do not include this difference"]


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(list(value) if isinstance(value, tuple) else value)


def _errors(trial: Trial) -> str:
    return "no prediction" if not np.isfinite(trial.score) else " and ".join(f"{x:.3g}" for x in trial.rmse)


def tuning_rows(found: Tuning) -> list[list[str]]:
    """Entry, what was chosen, why and what it changes."""
    return [[f"[{c.table}] {c.key}", _text(c.value), c.why, c.changes] for c in found.choices]


def tuning_text(found: Tuning) -> str:
    """Text for a person: the gain first, then one table."""
    rows = tuning_rows(found)
    what = f"rms prediction error over {SHORT_S:g} s on held-out runs, by joint"
    if not found.predicts or found.before is None or found.after is None:
        lines = ["nothing is chosen: no fit to half of the runs predicts the other half.",
                 "Run legid fit on the same runs: its first lines say what is wrong."]
    elif rows:
        lines = [f"{len(rows)} {'entry' if len(rows) == 1 else 'entries'} of rig.toml chosen; {what}: "
                 f"{_errors(found.before)} before, {_errors(found.after)} after",
                 "", text_table(["entry", "chosen", "why", "what it changes"], rows, set())]
    else:
        lines = [f"no change: rig.toml predicts best as it is; {what}: {_errors(found.after)}"]
    lines += [f"warning: {run}" for run in found.aside]
    lines += [f"warning: {flag}" for flag in found.flags]
    return "\n".join(lines)


def tuning_document(found: Tuning) -> dict[str, Any]:
    """`legid.tuning/1`."""
    return {"schema": "legid.tuning/1",
            "chosen": [choice.document for choice in found.choices],
            "tried": [{"entry": entry, "value": value, "error": error} for entry, value, error in found.tried],
            "error_before": None if found.before is None else found.before.rmse.tolist(),
            "error_after": None if found.after is None else found.after.rmse.tolist(),
            "horizon_s": SHORT_S, "doubts": found.flags,
            "set_aside": [run.document for run in found.aside]}


def write_choices(choices: Sequence[Choice], path: Path | str) -> None:
    """Put the choices into the rig file at `path`, whole or not at all, comments kept. Raises `InputError`."""
    tables: dict[str, dict[str, object]] = {}
    for choice in choices:
        tables.setdefault(choice.table, {})[choice.key] = choice.value
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "give a rig file that can be written") from None
    write_file(path, set_values(text, tables, str(path)).encode(), changed=True)
