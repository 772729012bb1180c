"""The coloured disturbance: its rows against dense matrices, its innovations, its share of the degrees of freedom."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark

from estimator.likelihood import LatentProblem, Latents, Noise, Process
from estimator.model import Mechanism, joint1, leg2
from estimator.numerics import BlockTridiagonal, eliminate
from estimator.signals import SignalSet, imu_columns

DT, ENDS = 0.01, np.array([70, 115])
NOISE = Noise(np.array([0.02, 0.05]), np.full(2, 1e-3), np.array([0.01]), np.array([[0.1, 0.1]]),
              disturbance=np.array([0.03, 0.0]), time_constant=np.array([0.08, 1.0]))


def covariance(level: float, constant: float, ends: np.ndarray) -> np.ndarray:
    """(N, N) of the process, stretches independent, by its definition s^2 exp(-|t| / T)."""
    at = np.arange(ends[-1])
    which = np.searchsorted(ends, at, side="right")
    apart = np.abs(at[:, None] - at) * DT
    return level**2 * np.exp(-apart / constant) * (which[:, None] == which)


def test_rows_are_the_inverse_covariance() -> None:
    e = default_rng(1).normal(size=(115, 2))
    process = Process.of(NOISE, DT)
    chain = BlockTridiagonal.zeros(115, 2, 1)
    process.add(chain, e, ENDS)
    for j, level in enumerate((0.03, 0.05e-3)):
        known = covariance(level, NOISE.time_constant[j], ENDS)
        precision = np.linalg.inv(known)
        assert_allclose(chain.diagonal[:, j, j], np.diag(precision), rtol=1e-8)
        assert_allclose(chain.lower[:, j, j], np.diag(precision, -1), rtol=1e-8, atol=1e-6)
        assert_allclose(chain.right[:, j, 0], precision @ e[:, j], rtol=1e-6)
        assert process.squares(e, ENDS)[j] == approx(e[:, j] @ precision @ e[:, j], rel=1e-9)
    both = sum(np.linalg.slogdet(covariance(level, NOISE.time_constant[j], ENDS))[1]
               for j, level in enumerate((0.03, 0.05e-3)))
    assert process.log_determinant(ENDS) == approx(both, rel=1e-9)


def test_share_is_the_trace_of_the_smoother() -> None:
    level, constant, white = 0.03, 0.08, 0.02
    c = covariance(level, constant, np.array([1500]))
    known = np.trace(c @ np.linalg.inv(c + white**2 * np.eye(1500))) / 1500
    assert Process.of(NOISE, DT).share(np.array([white**2, 1.0]))[0] == approx(known, rel=5e-3)


def test_innovations_are_white() -> None:
    rng = default_rng(3)
    count, white = 20_000, 0.02
    d, a = np.empty(count), np.exp(-DT / 0.08)
    d[0] = 0.03 * rng.normal()
    for k in range(1, count):
        d[k] = a * d[k - 1] + 0.03 * np.sqrt(1.0 - a * a) * rng.normal()
    error = d + white * rng.normal(size=count)
    found = Process.of(NOISE, DT).innovations(error, 0, white)
    lags = [np.corrcoef(found[k:], found[: count - k])[0, 1] for k in range(1, 11)]
    assert np.corrcoef(error[1:], error[:-1])[0, 1] > 0.5
    assert np.max(np.abs(lags)) < 4.0 / count**0.5
    assert np.var(found) < 0.75 * np.var(error)


@mark.parametrize("mechanism", [joint1(lever_arm=0.1), leg2(lever_arm=0.2)], ids=["joint1", "leg2"])
@mark.parametrize("imu", [False, True], ids=["encoder", "imu"])
def test_a_disturbance_that_is_off_changes_nothing(mechanism: Mechanism, imu: bool) -> None:
    """The same least squares and information as without its latents, up to the level that stands for none."""
    rng, n = default_rng(11), mechanism.n
    signals = [SignalSet(f"run{i}", 10.0, np.arange(count) / 10.0, rng.normal(size=(count, n)),
                         rng.normal(size=(count, n)), {c: rng.normal(size=count) for c in imu_columns(0) if imu})
               for i, count in enumerate((70, 45))]
    beta = np.array([3.0 if p.term == "inertia" and p.at[0] == p.at[1] else 0.1 for p in mechanism.parameters])
    q, v, u = rng.normal(size=(3, 115, n))
    plain = Noise(NOISE.torque[:n], NOISE.encoder[:n], NOISE.gyro, NOISE.accel)
    off = replace(plain, disturbance=np.zeros(n), time_constant=np.full(n, 0.1))
    found = []
    for x, noise in ((Latents(q, v, u), plain), (Latents(q, v, u, np.zeros_like(u)), off)):
        problem = LatentProblem(signals, mechanism, "linear")
        problem = problem if x.e is None else problem.with_disturbance()
        point = problem.linearise(x, beta, noise)
        assert point.chain.block == (4 if problem.disturbed else 3) * n
        product = eliminate(point.chain).product()
        found.append((point.objective, point.objective - product[0, 0], point.corner - product[1:, 1:]))
    for known, value in zip(*found, strict=True):
        assert_allclose(value, known, rtol=2e-5, atol=2e-5 * np.max(np.abs(known)))
