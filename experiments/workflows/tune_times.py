"""Rate, hold and delay of a rig, varied together: half a sample of a hold is a delay, and a sample is the rate's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from daq import Rig
from estimator import FIT_ERRORS
from estimator.model import lag, ticks_of
from experiments.documents import Time, What
from experiments.session import Choice, with_choices
from experiments.workflows.trial import Bench, Trial, errors_of, same_rate

PARTS, LEAST_HZ = (1, 2, 4, 8, 16, 32), 20.0
"""Grids have these parts of the record's own rate, and no less than this: on others readings lie between samples."""
AUTO = "auto"
"""Hold of a rig file that states none."""
MOST_SAMPLES = 60_000
"""Of all runs together, on the finest grid that is tried."""
GAIN = 0.03
"""Least relative reduction of the prediction error of held-out runs for an entry to change. Set-ups that differ by less
count as equal: then the finest grid is chosen, on it the likeliest hold if it needs no delay, else that of the rig
file."""
HOLDS = ("zero", "linear", "past", "average", "smooth")
"""Of `[sampling]`, tried on the best grid; those that act late or early also with a delay that makes up for it."""
UNSURE = 0.05
"""Standard deviation of a delay that is written, in samples: no model of a leg tells less."""
DELAYS, NO_PREDICTION = 8, 1e3
"""Delays that are tried about the chosen one, and what counts as the score of one without a prediction."""
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
        found["sampling", "hold"] = AUTO if ticks > 1 else self.hold
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
        late[grid] = _between(bench, _rig(rig, Times(grid, AUTO, 0.0)))
        if not late[grid][1] and start.hold == AUTO:
            continue  # that is what the first trial found
        attempt(Times(grid, late[grid][0], late[grid][1] if _delay_is_open(rig) else 0.0))
        if _delay_is_open(rig):  # a step of a slow log can be a smooth torque that its device has averaged
            attempt(_as_late("smooth", grid, *late[grid]))
    best = _chosen(tried, start, {})
    more = _holds(best.rate_hz, *late.get(best.rate_hz, ("smooth", 0.0)), _delay_is_open(rig))
    for k, times in enumerate(more):
        done(0.5 + 0.5 * k / len(more))
        attempt(times)
    best = _refined(_chosen(tried, start, late), attempt)
    gains = (_gain("rate", "rate_hz", best, start, attempt), _gain("hold", "hold", best, start, attempt),
             _gain("delay", "delay_s", best, start, attempt))
    return FoundTimes(_choices(best, start, tried), tried[best], gains, _rows(tried, start),
                      {t.rate_hz: trial for t, trial in tried.items() if t[1:] == start[1:]})


def _grids(bench: Bench, rig: Rig) -> list[float]:
    """Rates that the records have samples for, and that are no longer than what can be tried."""
    seconds = sum(len(d) / d.rate_hz for d in bench.runs(rig))
    now = rig.sampling.rate_hz or 0.0
    rates = [rate for part in PARTS
             if (rate := bench.own_rate / part) * seconds <= MOST_SAMPLES and (rate >= LEAST_HZ or part == 1)]
    return sorted({g for g in rates if not same_rate(g, now)} | {now})


def _delay_is_open(rig: Rig) -> bool:
    return rig.timing.torque_delay_s is None and rig.servo is None and bool(rig.mechanism.actuated)


def _between(bench: Bench, rig: Rig) -> tuple[str, float]:
    """The likeliest hold and delay [s], as a rig file states them."""
    try:
        hold, delay_s = bench.between(rig)
    except FIT_ERRORS:
        return "smooth", 0.0
    if hold in HOLDS or ticks_of(hold):
        return hold, round(delay_s, 6)
    return "smooth", round(delay_s + lag(hold) / bench.runs(rig)[0].rate_hz, 6)


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


def _chosen(tried: Mapping[Times, Trial], start: Times, late: Mapping[float, tuple[str, float]]) -> Times:
    """Of those that predict as well as the best the one on the finest grid: without a delay, by the likeliest hold.

    Hold and delay of the rig file stay where another gains too little on that grid, unless the likeliest hold, `late`
    by grid, needs no delay: likelihoods on one grid tell holds apart that predict alike.
    """
    least = min(trial.score for trial in tried.values())
    if not np.isfinite(least):
        return start
    good = [times for times, trial in tried.items() if trial.score <= least - np.log(1.0 - GAIN)]
    best = max(good, key=lambda t: (t.rate_hz, t.delay_s == 0.0, t.hold == start.hold, -tried[t].score))
    hold, delay_s = late.get(best.rate_hz, ("", 0.0))
    likeliest, same = Times(best.rate_hz, hold, 0.0), start._replace(rate_hz=best.rate_hz)
    if start.hold != AUTO and not delay_s and likeliest in good:
        return likeliest
    return same if same in tried and tried[same].score <= tried[best].score - np.log(1.0 - GAIN) else best


def _refined(best: Times, attempt: Callable[[Times], Trial]) -> Times:
    """`best` with the delay by which it predicts better than by its own, up to half a sample away.

    In a loop the steps between samples are the controller's answer to noise, and the likelihood of a held torque may
    follow them instead of the motion.
    """
    if not best.delay_s:
        return best
    from scipy.optimize import minimize_scalar

    def of(delay_s: float) -> Times:
        return best._replace(delay_s=round(float(delay_s), 6))

    half = 0.5 / best.rate_hz
    found = of(minimize_scalar(lambda delay_s: min(attempt(of(delay_s)).score, NO_PREDICTION), method="bounded",
                               bounds=(best.delay_s - half, best.delay_s + half),
                               options={"xatol": UNSURE / best.rate_hz, "maxiter": DELAYS}).x)
    return found if attempt(found).score < attempt(best).score + np.log(1.0 - GAIN) else best


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
    choices = []
    for (table, key), value in best.entries().items():
        if value == before.get((table, key)):
            continue
        back = tried.get(best._replace(**{parts[key]: getattr(start, parts[key])}), tried[start])
        choices.append(Choice(table, key, value, WHY[key],
                              f"error of held-out runs {errors_of(back)} -> {errors_of(tried[best])}"))
    return choices
