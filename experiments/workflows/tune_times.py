"""Rate, hold and delay of a rig, varied together: half a sample of a hold is a delay, and a sample is the rate's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from daq import Rig
from estimator import FitError
from estimator.model import lag, ticks_of
from experiments.documents import Time, What
from experiments.session import Choice, with_choices
from experiments.workflows.trial import Bench, Trial, errors_of

GRIDS_HZ = (25.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
MOST_SAMPLES = 60_000
"""Of all runs together, on the finest grid that is tried."""
GAIN = 0.03
"""Least relative reduction of the prediction error of held-out runs for an entry to change. Set-ups that differ by less
count as equal: then the finest grid is chosen, on it no delay, and the hold of the rig file."""
HOLDS = ("zero", "linear", "past", "average", "smooth")
"""Of `[sampling]`, tried on the best grid; those that act late or early also with a delay that makes up for it."""
UNSURE = 0.05
"""Standard deviation of a delay that is written, in samples: no model of a leg tells less."""
WHY = {"rate_hz": "the finest grid of those that predict best", "hold": "how torque acts between samples",
       "control_period_s": "the controller holds its torque for so long",
       "torque_delay_s": "how long after its stamp the torque acts, beyond its hold"}


class Times(NamedTuple):
    """When a torque was sampled and when it acts."""

    rate_hz: float
    hold: str
    """auto: as the motion makes likeliest"""
    delay_s: float
    """0: none beyond what the rig file states"""

    def entries(self) -> dict[tuple[str, str], Any]:
        """Entries of rig.toml that say so."""
        found: dict[tuple[str, str], Any] = {("sampling", "rate_hz"): self.rate_hz}
        ticks = ticks_of(self.hold)
        found["sampling", "hold"] = "auto" if ticks > 1 else self.hold
        if ticks > 1:
            found["timing", "control_period_s"] = float(f"{1.0 / (ticks * self.rate_hz):.6g}")
        if self.delay_s:
            found["timing", "torque_delay_s"] = (round(self.delay_s, 6), float(f"{UNSURE / self.rate_hz:.2g}"))
        return found


class Gain(NamedTuple):
    """Gain of one of rate, hold and delay."""

    what: What
    before: Any
    after: Any
    share: float
    """Relative reduction of the prediction error against the former value, the others as chosen; 0 where it stays"""

    @property
    def entry(self) -> Time:
        """For the document."""
        return Time(what=self.what, before=self.before, after=self.after,
                    gain=self.share if np.isfinite(self.share) else None)


class FoundTimes(NamedTuple):
    """The best times, and what was tried."""

    choices: list[Choice]
    best: Trial
    gains: tuple[Gain, ...]
    tried: list[tuple[str, str, str]]
    """Entries that differ from the rig file's, their values, and the error."""
    grids: Mapping[float, Trial]
    """With the hold and delay of the rig file, by rate."""


def vary_times(bench: Bench, rig: Rig, now: Trial, done: Callable[[float], None] = lambda share: None) -> FoundTimes:
    """Rate, hold and delay that predict held-out runs best; `now` is the trial of `rig` itself."""
    rate = rig.sampling.rate_hz
    assert rate is not None
    start = Times(rate, rig.sampling.hold, 0.0)
    tried = {start: now}

    def attempt(times: Times) -> Trial:
        if times not in tried:
            tried[times] = bench.trial(_rig(rig, times))
        return tried[times]

    late: dict[float, tuple[str, float]] = {}
    grids = _grids(bench, rig)
    for k, grid in enumerate(grids):
        done(0.5 * k / len(grids))
        attempt(start._replace(rate_hz=grid))
        late[grid] = _between(bench, _rig(rig, Times(grid, "auto", 0.0)))
        if not late[grid][1] and start.hold == "auto":
            continue  # that is what the first trial found
        attempt(Times(grid, late[grid][0], late[grid][1] if _delay_is_open(rig) else 0.0))
        if _delay_is_open(rig):  # a step of a slow log can be a smooth torque that its device has averaged
            attempt(_as_late("smooth", grid, *late[grid]))
    best = _chosen(tried, start)
    more = _holds(best.rate_hz, *late.get(best.rate_hz, ("smooth", 0.0)), _delay_is_open(rig))
    for k, times in enumerate(more):
        done(0.5 + 0.5 * k / len(more))
        attempt(times)
    best = _chosen(tried, start)
    gains = (_gain("rate", "rate_hz", best, start, attempt), _gain("hold", "hold", best, start, attempt),
             _gain("delay", "delay_s", best, start, attempt))
    return FoundTimes(_choices(best, start, tried), tried[best], gains, _rows(tried, start),
                      {t.rate_hz: trial for t, trial in tried.items() if t[1:] == start[1:]})


def _grids(bench: Bench, rig: Rig) -> list[float]:
    """Rates that the records have samples for, and that are no longer than what can be tried."""
    seconds = sum(len(d) / d.rate_hz for d in bench.runs(rig))
    own, now = float(f"{bench.own_rate:.6g}"), rig.sampling.rate_hz or 0.0
    rates = [g for g in (*GRIDS_HZ, own) if g <= 1.001 * own and g * seconds <= MOST_SAMPLES]
    return sorted({g for g in rates if abs(g - now) > 1e-3 * now} | {now})


def _delay_is_open(rig: Rig) -> bool:
    return rig.timing.torque_delay_s is None and rig.servo is None and bool(rig.mechanism.actuated)


def _between(bench: Bench, rig: Rig) -> tuple[str, float]:
    try:
        hold, delay_s = bench.between(rig)
        return hold, round(delay_s, 6)
    except (FitError, np.linalg.LinAlgError):
        return "smooth", 0.0


def _holds(rate_hz: float, hold: str, delay_s: float, open_delay: bool) -> list[Times]:
    """The likeliest hold and the others, and a held torque that is as late as the likeliest with its delay."""
    found = [Times(rate_hz, each, 0.0) for each in dict.fromkeys((hold, *HOLDS))]
    if open_delay and delay_s:
        found.append(_as_late("zero", rate_hz, hold, delay_s))
    return found


def _as_late(other: str, rate_hz: float, hold: str, delay_s: float) -> Times:
    """The hold `other` with the delay by which its torque acts as late as with `hold` and `delay_s`."""
    return Times(rate_hz, other, round(delay_s + (lag(hold) - lag(other)) / rate_hz, 6))


def _rig(rig: Rig, times: Times) -> Rig:
    return with_choices(rig, [Choice(table, key, value, "", "") for (table, key), value in times.entries().items()])


def _chosen(tried: Mapping[Times, Trial], start: Times) -> Times:
    """Of those that predict as well as the best the one on the finest grid, with no delay and the rig's hold.

    Hold and delay of the rig file stay where another gains too little on that grid.
    """
    least = min(trial.score for trial in tried.values())
    if not np.isfinite(least):
        return start
    good = [times for times, trial in tried.items() if trial.score <= least - np.log(1.0 - GAIN)]
    best = max(good, key=lambda t: (t.rate_hz, t.delay_s == 0.0, t.hold == start.hold, -tried[t].score))
    same = start._replace(rate_hz=best.rate_hz)
    return same if same in tried and tried[same].score <= tried[best].score - np.log(1.0 - GAIN) else best


def _gain(what: What, name: str, best: Times, start: Times, attempt: Callable[[Times], Trial]) -> Gain:
    """Of one part of `best`, against its value at the `start`."""
    before, after = getattr(start, name), getattr(best, name)
    if before == after:
        return Gain(what, before, after, 0.0)
    score = attempt(best._replace(**{name: before})).score
    return Gain(what, before, after, float(1.0 - np.exp(attempt(best).score - score)))


def _rows(tried: Mapping[Times, Trial], start: Times) -> list[tuple[str, str, str]]:
    """`FoundTimes.tried`"""
    found, before = [], start.entries()
    for times, trial in tried.items():
        other = {key: value for key, value in times.entries().items() if value != before.get(key)}
        if other:
            values = [f"{v:g}" if isinstance(v, float) else str(list(v) if isinstance(v, tuple) else v)
                      for v in other.values()]
            found.append((", ".join(f"[{table}] {key}" for table, key in other), ", ".join(values), errors_of(trial)))
    return found


def _choices(best: Times, start: Times, tried: Mapping[Times, Trial]) -> list[Choice]:
    """Entries of `best` that differ from those of the `start`, with what each changes."""
    parts = {"rate_hz": "rate_hz", "hold": "hold", "control_period_s": "hold", "torque_delay_s": "delay_s"}
    before = start.entries()
    found = []
    for (table, key), value in best.entries().items():
        if value == before.get((table, key)):
            continue
        back = tried.get(best._replace(**{parts[key]: getattr(start, parts[key])}), tried[start])
        found.append(Choice(table, key, value, WHY[key],
                            f"error of held-out runs {errors_of(back)} -> {errors_of(tried[best])}"))
    return found
