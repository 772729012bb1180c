"""What a model is good for: against refits, closed forms, and runs that nothing was fitted to."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from daq import FloatArray
from estimator import ENOUGH, FitOptions, fit
from estimator.free_runs import on_one_more
from estimator.model import chain, leg2
from estimator.prediction import FittedModel, predict, predict_left_out, tabulate, uses_of
from estimator.score import RunScores, Score, steps_without
from estimator.signals import split_signals
from tests.support.mujoco_leg import random_leg
from tests.support.predictions import predicted_run
from tests.support.timed_leg import Timing, record


def regression(runs: int) -> tuple[list[FloatArray], list[FloatArray], FloatArray]:
    """Rows (n, 3) and readings (n,) of each run, and the estimate by all."""
    rng = default_rng(3)
    rows = [rng.normal(size=(20, 3)) for _ in range(runs)]
    readings = [x @ [1.0, -2.0, 0.5] + rng.normal(size=20) for x in rows]
    return rows, readings, np.linalg.lstsq(np.vstack(rows), np.concatenate(readings), rcond=None)[0]


@mark.parametrize("unit", ["run", "segment"])
def test_a_step_is_the_fit_without_the_part(unit: Any) -> None:
    rows, readings, beta = regression(8)
    scores = RunScores(tuple("abcdefgh"), tuple(Score(x.T @ (y - x @ beta), x.T @ x) for x, y in zip(rows, readings)),
                       unit, tuple(slice(20 * k, 20 * k + 20) for k in range(8)))
    found = steps_without(scores, np.array([True, True, True]))
    assert len(found) == (8 if unit == "run" else 4)
    for where, step in found:
        others = [k for k in range(8) if not where.start <= 20 * k < where.stop]
        again = np.linalg.lstsq(np.vstack([rows[k] for k in others]), np.concatenate([readings[k] for k in others]),
                                rcond=None)[0]
        assert beta + step == approx(again, abs=1e-9)
    held = steps_without(scores, np.array([True, False, True]))
    assert all(step[1] == 0.0 and step[0] != 0.0 for _, step in held)
    assert steps_without(RunScores(("a",), scores.scores[:1]), np.ones(3, dtype=bool)) == []


def test_errors_are_shares_of_the_spread_and_the_longest_horizon_is_told() -> None:
    time = np.arange(6000) / 100.0
    angle = np.sin(time)
    noise = default_rng(1).normal(size=(8, time.size))
    errors = {0.1: 0.01, 1.0: 0.02, np.inf: 0.3}
    runs = [predicted_run(f"r{k}", 100.0, {"q1_rad": angle, "q1d": angle},
                          {h: size * angle.std() * one for h, size in errors.items()}) for k, one in enumerate(noise)]
    runs = [replace(run, residual_torque=0.05 * one[None, :, None]) for run, one in zip(runs, noise)]
    simulation, feedforward = uses_of(tabulate(runs, 0), chain(1, actuated=(0,)))
    assert simulation.use == "simulation" and simulation.horizon_s == 1.0 and simulation.supported
    assert simulation.figure == approx(0.02, rel=0.03) and feedforward.figure == approx(0.05, rel=0.03)
    assert simulation.ci95 is not None and simulation.ci95[0] < 0.02 < simulation.ci95[1] < ENOUGH
    # of a sine: 2, 48 and 50 % of the samples
    assert [error.speed for error in feedforward.by_speed] == ["rest", "slow", "fast"]
    for error in feedforward.by_speed:
        assert (error.joint, error.unit) == (1, "N m") and error.rms == approx(0.05, rel=0.1)
        assert error.ci95 is not None and error.ci95[0] < 0.05 < error.ci95[1]
    worse = uses_of(tabulate([replace(run, simulated=run.simulated + 1.0) for run in runs], 0), chain(1, actuated=()))
    assert len(worse) == 1 and not worse[0].supported and worse[0].horizon_s == 1.0
    few = uses_of(tabulate([replace(runs[0], residual_torque=runs[0].residual_torque[:, :200],
                                    **{name: getattr(runs[0], name)[..., :200] for name in (
                                        "time_s", "measured", "smoothed", "simulated", "starts")},
                                    torque=runs[0].torque[:200], ends=np.array([200]))], 0),
                  chain(1, actuated=(0,)))
    assert not any(one.supported or one.ci95 for one in few)


@mark.parametrize("tested", [1, 2, 8])
def test_few_test_runs_have_the_scatter_of_all_runs(tested: int) -> None:
    rng, inside = default_rng(4), []
    blocks, run = np.ones(80), np.repeat(np.arange(8), 10)
    for _ in range(400):
        level = np.exp(2.0 * 0.3 * rng.normal(size=9))  # of eight runs and one more: squared errors
        error = level[run] * rng.chisquare(20, size=80) / 20.0
        found = on_one_more(error, blocks, run, np.arange(tested))
        assert found.value == approx(np.sqrt(error[: 10 * tested].mean())) and found.ci95 is not None
        inside.append(found.ci95[0] <= np.sqrt(level[8]) <= found.ci95[1])
    assert 0.92 < np.mean(inside) < 0.98


def test_figures_of_a_fit_hold_on_a_run_that_was_not_fitted() -> None:
    rng = default_rng(12)
    leg = random_leg(rng)
    runs = [record(leg, rng, Timing(100.0), seconds=8.0, name=f"r{k}") for k in range(8)]
    mechanism, options = leg2(lever_arm=leg.lever), FitOptions(hold="zero")
    result = fit(runs[:6], mechanism, options)
    table = predict_left_out(result, split_signals(runs[:6], mechanism, options), options)
    assert table is not None and len(result.left_out) == 6
    moved = np.array([part.beta - result.beta for part in result.left_out])
    again = fit(runs[1:6], mechanism, options)
    assert moved[0] == approx(again.beta - result.beta, abs=0.3 * float(result.std.max()))
    uses = uses_of(table, mechanism)
    assert [one.use for one in uses] == ["simulation", "feedforward"] and all(one.supported for one in uses)
    new = predict([FittedModel(mechanism, "zero", result.beta)], runs[6:], options)
    fresh = {one.use: one.figure for one in uses_of(new, mechanism)}
    for one in uses:
        assert one.ci95 is not None and one.ci95[0] < fresh[one.use] < one.ci95[1]
    assert predict_left_out(result, split_signals(runs[:5], mechanism, options), options) is None
