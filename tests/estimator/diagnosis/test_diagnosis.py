"""Effects and the diagnosis's statistics; whole diagnoses by hundreds are `make evidence`."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import t as student

from daq import Dataset
from estimator import Diagnosis, FitError, FitOptions, diagnose
from estimator.diagnosis import account
from estimator.diagnosis import model as models
from estimator.diagnosis.account import base
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.model import nominal_model
from estimator.effects import library
from estimator.effects.load_dependent_friction import LoadDependentFriction
from estimator.fitting import iterate
from estimator.likelihood import LatentProblem, Latents, Stage, State
from estimator.likelihood.effect_columns import braked
from estimator.model import joint1, leg2
from estimator.score import Score, own_inflation, project
from estimator.signals import SignalSet, split_signals
from tests.support.mujoco_leg import Leg, record

CHOSEN = FitOptions(sensors="imu", hold="auto", smoothing_velocity="auto")


@pytest.fixture(scope="module")
def runs() -> tuple[Leg, list[Dataset]]:
    leg = Leg()
    return leg, [record(leg, default_rng(600 + k), seconds=10.0, name=f"r{k + 1}") for k in range(4)]


@pytest.fixture(scope="module")
def healthy(runs: tuple[Leg, list[Dataset]]) -> Diagnosis:
    """Of runs in which nothing is hidden, hold and rounding chosen."""
    leg, data = runs
    return diagnose(data, leg2(lever_arm=leg.lever), CHOSEN, seed=1)


def test_what_effects_take_brakes_the_view_as_a_view_of_the_braked_motion(runs: tuple[Leg, list[Dataset]]) -> None:
    leg, data = runs
    mechanism = leg2(lever_arm=leg.lever)
    signals = split_signals(data[:1], mechanism, FitOptions())
    stage = Stage((0,), (0.0,), (0.0,), np.array([[-1.0, 1.0], [-1.5, 1.5]]), 50.0)
    problem = LatentProblem(signals, mechanism, "linear", stage)
    q = np.stack([data[0]["q1_rad"], data[0]["q2_rad"]], axis=-1)
    x, taken = Latents(q, np.gradient(q, 0.01, axis=0), problem.torque), 0.1 * np.sin(q).T
    free, whole = problem.view(x, leg.beta()), problem.view(x, leg.beta(), taken)
    mobility = np.asarray(np.linalg.inv(mechanism.inertia_matrix(q, leg.beta())), float)
    found = braked(free, np.moveaxis(mobility, 0, -1), taken)
    assert_allclose(found.samples.a, whole.samples.a, rtol=1e-9, atol=1e-9)
    assert np.abs(whole.samples.a - free.samples.a).max() > 1.0


@pytest.mark.parametrize("voltage", [False, True])
def test_friction_by_load_follows_what_the_joint_passes_on(voltage: bool) -> None:
    mechanism = joint1(voltage=voltage)
    n = 40
    at = np.linspace(0.0, 1.0, n)
    signals = SignalSet("r", 50.0, at, np.zeros((n, 1)), np.zeros((n, 1)), {})
    problem = LatentProblem([signals], mechanism, "linear", Stage((0,), (0.0,), (0.0,), np.array([[-1.0, 1.0]])))
    q, u = np.sin(3.0 * at)[:, None], (5.0 * np.cos(4.0 * at))[:, None]
    beta = np.array([0.08, 0.55, 0.4, 0.3])
    view = problem.view(Latents(q, 3.0 * np.cos(3.0 * at)[:, None], u), beta)
    s = view.samples
    if voltage:
        more = 0.4 * np.abs(u[:, 0] - beta[2] * s.v[0] - beta[3] * s.sign[0])  # less friction and EMF
    else:
        whole = np.full(n, beta[3])
        for _ in range(100):  # F = Fc + mu |tau - F|, by iteration
            whole = beta[3] + 0.4 * np.abs(u[:, 0] * s.sign[0] - whole)
        more = whole - beta[3]
    torque = LoadDependentFriction(0).perturb(view, np.array([0.4])).torque_at_samples
    assert torque is not None
    assert_allclose(torque[0], more * s.sign[0], atol=2e-3)


def test_a_slide_has_its_own_units_and_shapes() -> None:
    slide = joint1(prismatic=True, gravity_mps2=0.0)
    units = ["N m s/rad", "1/(N m)^2", "rad/(N m)", "s"]
    assert [slide.unit(u) for u in units] == ["N s/m", "1/N^2", "m/N", "s"]
    assert [leg2().unit(u) for u in units] == units
    assert joint1(voltage=True).unit("N m s^2/rad^2") == "V s^2/rad^2"
    (stribeck,), (rotary,) = ([e for e in library(m, False)[0] if e.name == "stribeck_friction"]
                              for m in (slide, joint1()))
    assert_allclose(stribeck.grid(), np.array(rotary.grid()) * [0.05, 1.0])  # an exponent has no unit
    assert stribeck.clipped(np.array([1.0, 0.01, 2.0]))[1] == 0.01


def test_the_order_of_files_changes_nothing(runs: tuple[Leg, list[Dataset]]) -> None:
    leg, data = runs
    fits = []
    for order in ([0, 1, 2, 3], [2, 0, 3, 1], [3, 2, 1, 0]):
        split = split_runs([data[k] for k in order], leg2(lever_arm=leg.lever), FitOptions(sensors="imu"))
        parts = [[split.names[i] for i in part] for part in (split.train, split.test)]
        fits.append((parts, nominal_model(split).state.beta.tolist()))
    assert fits[0] == fits[1] == fits[2]
    assert sorted(name for part in fits[0][0] for name in part) == [run.name for run in data]


def test_hold_and_smoothing_do_not_depend_on_the_order(runs: tuple[Leg, list[Dataset]], healthy: Diagnosis) -> None:
    leg, data = runs
    one, other = healthy, diagnose([data[k] for k in (2, 0, 3, 1)], leg2(lever_arm=leg.lever), CHOSEN, seed=1)
    assert one.hold == other.hold != "" and one.mechanism is not None and other.mechanism is not None
    assert one.mechanism.velocity_scale == other.mechanism.velocity_scale
    assert one.verdict == other.verdict and one.nominal == other.nominal


def test_nothing_hidden_is_never_named(healthy: Diagnosis) -> None:
    assert healthy.verdict == "none", healthy.sentence
    assert all(r.smallest_detectable > 0 for r in healthy.candidates)


def test_what_the_tolerances_hold_together_with_the_terms_of_a_fit_is_no_fault(
        runs: tuple[Leg, list[Dataset]], monkeypatch: pytest.MonkeyPatch) -> None:
    """A bias was named, and lay within its tolerance with the torque's offset: the diagnosis ended in a traceback."""
    leg, data = runs
    tilted = [replace(run, columns=dict(run.columns) | {"accel_x_mps2": run["accel_x_mps2"] + 0.5}) for run in data]
    monkeypatch.setattr(account, "with_terms", lambda context, one, terms: replace(one, within=one.keys))
    found = diagnose(tilted, leg2(lever_arm=leg.lever), FitOptions(sensors="imu"), seed=1)
    assert (found.verdict, found.causes) == ("none", ())
    assert found.sentence.startswith("No fault beyond the tolerances of the rig. Within them, accelerometer bias")
    assert [cause.effect for cause in found.immaterial] == ["accelerometer_bias"] and found.in_library is None


def test_torque_that_is_mostly_noise_allows_no_verdict_that_nothing_is_wrong(runs: tuple[Leg, list[Dataset]]) -> None:
    leg, data = runs
    rng = default_rng(31)
    spoiled = []
    for run in data:
        torque = run["tau2_nm"]
        drowned = torque + rng.normal(0.0, 1.5 * float(np.std(torque)), torque.size)
        spoiled.append(replace(run, columns=dict(run.columns) | {"tau2_nm": drowned}))
    found = diagnose(spoiled, leg2(lever_arm=leg.lever), FitOptions(sensors="imu"), seed=1)
    assert found.verdict in ("fit_failed", "unexplained")
    assert "40 % of the torque of joint 2 to noise" in found.sentence and "rate_hz" in found.sentence


def test_too_little_data_is_refused_in_words() -> None:
    run = record(Leg(), default_rng(9), seconds=3.0)
    found = diagnose([run], leg2(lever_arm=0.2), FitOptions(sensors="imu"))
    assert found.verdict == "fit_failed"
    assert "record" in found.sentence


def test_what_the_parameters_imitate_has_no_smallest_size() -> None:
    rng = default_rng(3)
    runs = []
    for _ in range(4):  # column 1 is column 0 twice, column 2 is its own
        rows = rng.normal(size=(50, 2))
        jacobian = np.column_stack([rows[:, 0], 2.0 * rows[:, 0], rows[:, 1]])
        runs.append(Score(jacobian.T @ rng.normal(size=50), jacobian.T @ jacobian))
    tests = project(runs, 1)
    assert tests.detectable(0, 0.01, 0.0) == np.inf
    assert 0.0 < tests.detectable(1, 0.01, 0.0) < 1.0


def test_intervals_hold_where_noise_lasts_longer_than_a_sample() -> None:
    """Least squares of a slow and a fast column under noise of ten samples' memory, taken for white."""
    rng, missed, narrow = default_rng(5), np.zeros(2), np.zeros(2)
    samples, cases = 400, 300
    t = np.arange(samples)
    for _ in range(cases):
        phases = 2 * np.pi * rng.random((6, 2))
        rows = np.array([np.column_stack([np.sin(0.03 * t + a), np.sin(1.5 * t + b)]) for a, b in phases])
        noise = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], rng.normal(size=(6, samples + 100)))[:, 100:]
        information = np.einsum("rki,rkj->rij", rows, rows)
        inverse = np.linalg.inv(information.sum(axis=0))
        error = inverse @ np.einsum("rki,rk->i", rows, noise)
        left = noise - rows @ error
        scores = [Score(rows[r].T @ left[r], information[r]) for r in range(6)]
        inflation = own_inflation(scores, np.ones(2, dtype=bool), 1.0)
        std = np.sqrt(np.diag(inverse))
        missed += np.abs(error) > student.isf(0.025, 13.0) * np.sqrt(inflation) * std
        narrow += np.abs(error) > 1.96 * std
    assert missed[0] / cases < 0.15
    assert missed[1] / cases < 0.05
    assert narrow[0] / cases > 0.4


def test_a_nominal_fit_that_does_not_converge_has_no_intervals(runs: tuple[Leg, list[Dataset]],
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    leg, data = runs
    split = split_runs(data, leg2(lever_arm=leg.lever), FitOptions(sensors="imu"))

    def stuck(problem: LatentProblem, state: State, free: NDArray[np.bool_], *rest: Any) -> State:
        if free.any():
            raise FitError("does not settle")
        return iterate(problem, state, free, *rest)

    monkeypatch.setattr(models, "iterate", stuck)
    nominal = nominal_model(split)
    assert np.isinf(nominal.std()[:9]).all() and np.isfinite(nominal.state.beta).all()
    assert any("no intervals" in warning for warning in base(nominal, {}, None).warnings)
