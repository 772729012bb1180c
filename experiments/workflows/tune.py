"""`legid tune`: the set-up that predicts best what a fit has not seen, chosen entry by entry of rig.toml."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from msgspec import structs

from daq import Rig, input_errors, set_values, write_file
from estimator.prediction import SHORT_S
from experiments.documents import Entry, Tried, TuningDocument
from experiments.session import Choice, SetAside, load_runs, with_choices
from experiments.workflows.fit import LEVELS
from experiments.workflows.trial import Bench, Trial, errors_of
from experiments.workflows.tune_times import GAIN, Gain, vary_times

D = TypeVar("D", bound=TuningDocument)
DISAGREE = 0.05
"""Share of itself by which a parameter may differ between grids without a word."""


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
    gains: tuple[Gain, ...] = ()
    """Of rate, hold and delay, which are varied together."""

    @property
    def predicts(self) -> bool:
        """Whether any fit to half of the runs predicts the other half; if none does, nothing is chosen."""
        return self.after is not None and bool(np.isfinite(self.after.score))

    def as_document(self, kind: type[D]) -> D:
        """`legid.tuning/1` as `kind`, the struct or one derived from it, without its provenance."""
        before, after = (None if one is None else tuple(one.rmse.tolist()) for one in (self.before, self.after))
        return kind(chosen=tuple(Entry(**choice.document) for choice in self.choices),
                    times=tuple(g.entry for g in self.gains) if self.predicts else (),
                    tried=tuple(Tried(entry=entry, value=value, error=error) for entry, value, error in self.tried),
                    error_before=before, error_after=after, horizon_s=SHORT_S, flags=tuple(self.flags),
                    set_aside=self.aside)


def tune_runs(paths: Sequence[Path | str], rig: Rig, sensors: str | None = None, damaged: bool = False,
              done: Callable[[str, float], None] = lambda what, share: None,
              fixed: Mapping[str, float] | None = None) -> Tuning:
    """Entries of `rig` for these runs; those of `[terms]` that it states are kept, and parameters in `fixed` are given.

    An entry changes only where a fit with it predicts runs not fitted: a finite error. Raises `InputError`, `FitError`.
    """
    own = load_runs(paths, rig, damaged)[0].rate_hz  # where a stated rate is too fast for the record, its own
    rig = structs.replace(rig, sampling=structs.replace(rig.sampling, rate_hz=own))
    bench = Bench(paths, rig, sensors, damaged, fixed)
    out = Tuning(aside=bench.aside)
    done("terms", 0.05)
    out.choices += bench.terms
    best_rig = with_choices(rig, out.choices)
    out.before = bench.trial(rig)
    best = bench.trial(best_rig) if out.choices else out.before
    if best.score > out.before.score + np.log(1.0 + GAIN):
        out.flags.append("the chosen terms predict the other runs worse than no terms: left out")
        out.choices, best_rig, best = [], rig, out.before
    times = vary_times(bench, best_rig, best, lambda share: done("rate, hold and delay", 0.1 + 0.6 * share))
    out.gains, best = times.gains, times.best
    out.tried += times.tried
    out.choices += times.choices
    best_rig = with_choices(best_rig, times.choices)
    entries = _entries(rig)
    for k, (table, key, values, why) in enumerate(entries):
        done(f"{table}.{key}", 0.7 + 0.25 * k / len(entries))
        now, start = getattr(getattr(best_rig, table), key), best
        chosen: Any = None
        for value in values(best):
            if value == now:
                continue
            trial = bench.trial(with_choices(best_rig, [Choice(table, key, value, "", "")]))
            out.tried.append((f"[{table}] {key}", _text(value), errors_of(trial)))
            if trial.score < best.score + np.log(1.0 - GAIN):
                best, chosen = trial, value
        if chosen is not None:
            change = f"error of held-out runs {errors_of(start)} -> {errors_of(best)}"
            out.choices.append(Choice(table, key, chosen, why, change))
            best_rig = with_choices(best_rig, out.choices[-1:])
    out.after = best
    if not out.predicts:
        out.choices = []
    out.flags += _disagreement(times.grids)
    return out


Open = tuple[str, str, Callable[[Trial], Sequence[Any]], str]


def _entries(rig: Rig) -> list[Open]:
    """Table, key, values to try given the best trial so far, and what they are for; entries stated stay."""
    entries: list[Open] = []
    if rig.noise.encoder_rad is None:
        entries.append(("noise", "encoder_rad", lambda best: [float(f"{times * best.encoder:.1g}") for times in LEVELS]
                        if best.encoder else [], "angles that err by more than their encoder shows"))
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


def write_choices(choices: Sequence[Entry], path: Path | str) -> None:
    """Put the choices into the rig file at `path`, whole or not at all, comments kept. Raises `InputError`."""
    tables: dict[str, dict[str, object]] = {}
    for choice in choices:
        tables.setdefault(choice.table, {})[choice.key] = choice.value
    with input_errors(path, "give a rig file that can be written"):
        text = Path(path).read_text(encoding="utf-8")
    write_file(path, set_values(text, tables, str(path)).encode(), changed=True)
