"""Compiled normal equations against those by arrays: every mechanism, every effect, any number of columns."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator, default_rng
from numpy.testing import assert_allclose
from pytest import MonkeyPatch, approx, mark

from estimator import Effect
from estimator.effects import library
from estimator.likelihood import Candidate, LatentProblem, Latents, Linearised, Noise, Stage, latent_problem
from estimator.model import ImuPlace, Mechanism, biped3, chain, joint1, leg2
from estimator.model.regressor_numba import FastTerms
from estimator.signals import SignalSet, imu_columns
from tests.support import assembly_numpy
from tests.support.equations import normal

COUNTS = (70, 45)
BETA = np.array([0.14, 0.03, 0.05, 0.5, 0.15, 0.02, 0.03, 0.03, 0.06])
LIBRARY = library(leg2(lever_arm=0.2), True)[0]


def segments(mechanism: Mechanism, imu: bool, rng: Generator) -> list[SignalSet]:
    """Two, so that one sample begins no interval."""
    return [SignalSet(f"run{i}", 100.0, np.arange(count) / 100.0, rng.normal(size=(count, mechanism.n)),
                      rng.normal(size=(count, mechanism.n)),
                      {c: rng.normal(size=count) for k in range(len(mechanism.imus) if imu else 0)
                       for c in imu_columns(k)})
            for i, count in enumerate(COUNTS)]


def latents(mechanism: Mechanism, rng: Generator) -> Latents:
    return Latents(*(scale * rng.normal(size=(sum(COUNTS), mechanism.n)) for scale in (0.5, 1.0, 0.4)))


def noise_of(mechanism: Mechanism) -> Noise:
    count = len(mechanism.imus)
    return Noise(np.linspace(0.02, 0.05, mechanism.n), np.full(mechanism.n, 1e-3), np.linspace(0.01, 0.02, count),
                 np.outer(np.linspace(1.0, 1.5, count), [0.1, 0.07]), disturbance=np.full(mechanism.n, 0.03),
                 time_constant=np.linspace(0.05, 0.5, mechanism.n))


def both(problem: LatentProblem, x: Latents, beta: np.ndarray, monkeypatch: MonkeyPatch,
         correlation: float = 0.0) -> list[Linearised]:
    noise = replace(noise_of(problem.mechanism), accel_correlation=correlation)
    fast = problem.linearise(x, beta, noise)
    with monkeypatch.context() as patch:
        patch.setattr(latent_problem, "assembly_numba", assembly_numpy)
        return [problem.linearise(x, beta, noise), fast]


def assert_motion_alone(problem: LatentProblem, x: Latents, beta: np.ndarray) -> None:
    """A search of the motion alone has the same chain and objective, with the first right side only."""
    noise = noise_of(problem.mechanism)
    whole, alone = problem.linearise(x, beta, noise), problem.motion_equations(x, beta, noise)
    assert alone.chain.width == 1 and alone.objective == approx(whole.objective, rel=1e-12)
    for part in ("diagonal", "lower", "right"):
        mine, known = getattr(alone.chain, part), getattr(whole.chain, part)
        known = known[..., :1] if part == "right" else known
        assert_allclose(mine, known, rtol=0.0, atol=1e-12 * np.abs(known).max())
    assert np.array_equal(alone.accel, whole.accel[..., : problem.block + 1])


def assert_alike(plain: Linearised, fast: Linearised) -> None:
    assert fast.objective == approx(plain.objective, rel=1e-10)
    for name, known in normal(plain).items():
        atol = 1e-10 * np.abs(known).max(initial=0.0)
        assert_allclose(normal(fast)[name], known, rtol=0.0, atol=atol, err_msg=name)
    for name, known in plain.residuals.items():
        assert_allclose(fast.residuals[name], known, rtol=0.0, atol=1e-10 * np.abs(known).max(),
                        err_msg=name)


@mark.parametrize("imu", [False, True], ids=["encoder", "imu"])
@mark.parametrize("mechanism", [joint1(lever_arm=0.1), leg2(lever_arm=0.2, rotor_inertia=(1,),
                                                                   torque_offset=(0, 1)), biped3(), chain(3),
                                       leg2().with_imus((ImuPlace(1, 0.2), ImuPlace(0, 0.1)), (0.3,)),
                                       biped3().with_imus((ImuPlace(2, 0.1),), (0.7,)),
                                       chain(3).with_imus((ImuPlace(2, 0.1), ImuPlace(1, 0.2)), (0.3, 0.4))],
                         ids=lambda m: f"{m.name}-{m.n}-{''.join(str(i.link) for i in m.imus)}")
def test_every_mechanism(mechanism: Mechanism, imu: bool, monkeypatch: MonkeyPatch) -> None:
    rng = default_rng(11)
    problem = LatentProblem(segments(mechanism, imu, rng), mechanism, "linear")
    beta = np.abs(rng.normal(size=mechanism.p)) + np.array([2.0 * (p.term == "inertia" and p.at[0] == p.at[1])
                                                            for p in mechanism.parameters])
    x = latents(mechanism, rng)
    assert_alike(*both(problem, x, beta, monkeypatch))
    assert_motion_alone(problem, x, beta)


@mark.parametrize("imu", [False, True], ids=["encoder", "imu"])
def test_a_disturbed_leg(imu: bool, monkeypatch: MonkeyPatch) -> None:
    rng = default_rng(12)
    mechanism = leg2(lever_arm=0.2)
    problem = LatentProblem(segments(mechanism, imu, rng), mechanism, "linear").with_disturbance()
    x = latents(mechanism, rng)
    assert_alike(*both(problem, replace(x, e=0.3 * x.u[::-1]), BETA, monkeypatch))


def staged(effects: list[Effect], candidates: list[Candidate], rng: Generator) -> LatentProblem:
    stage = Stage((0, 1), (0.0, 5.0), (0.0, 0.0), np.tile([-1.0, 1.0], (2, 1)), 7.0)
    mechanism = leg2(lever_arm=0.2)
    return LatentProblem(segments(mechanism, True, rng), mechanism, "linear", stage, effects, candidates)


@mark.parametrize("effects", [[e] for e in LIBRARY], ids=lambda e: f"{e[0].name}-{e[0].joint}")
def test_every_effect(effects: list[Effect], monkeypatch: MonkeyPatch) -> None:
    assert_motion_alone(*assert_fast(effects, monkeypatch))


@mark.parametrize("correlation", [-0.9, 0.8])
def test_axes_that_correlate(correlation: float, monkeypatch: MonkeyPatch) -> None:
    assert_fast(LIBRARY[:6], monkeypatch, correlation)


def assert_fast(effects: list[Effect], monkeypatch: MonkeyPatch, correlation: float = 0.0
                ) -> tuple[LatentProblem, Latents, np.ndarray]:
    rng = default_rng(12)
    problem = staged(effects, [], rng)
    beta = np.concatenate([BETA, *([s.scale for s in e.sizes] + [s.grid[-1] for s in e.shapes] for e in effects)])
    x = latents(problem.mechanism, rng)
    assert_alike(*both(problem, x, beta, monkeypatch, correlation))
    return problem, x, beta


def test_more_columns_than_have_a_kernel(monkeypatch: MonkeyPatch) -> None:
    rng = default_rng(13)
    candidates = [Candidate(e, shape) for e in LIBRARY for shape in e.grid()]
    problem = staged([], candidates, rng)
    plain, fast = both(problem, latents(problem.mechanism, rng), BETA, monkeypatch)
    assert plain.chain.edge > 24
    assert_alike(plain, fast)


def test_cosine_and_sine_of_far_angles() -> None:
    """To the last digits of numpy's own, after many turns and close to a quarter of one."""
    angle = np.concatenate([default_rng(14).uniform(-1e5, 1e5, 5000), np.linspace(-7.0, 7.0, 5000),
                            np.arange(-40, 41) * np.pi / 4, [0.0, -0.0]])
    cosine, sine = FastTerms(joint1()).transposed(angle[None, None])
    assert_allclose(cosine[0, 0], np.cos(angle), rtol=0.0, atol=2.5e-16)
    assert_allclose(sine[0, 0], np.sin(angle), rtol=0.0, atol=2.5e-16)
    assert np.isnan(FastTerms(joint1()).transposed(np.full((1, 1, 1), np.nan))).all()
