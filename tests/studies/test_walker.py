"""The study's walker: its parameters, its impact, its controller and its record."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, fixture

from estimator.model import biped3
from studies import walker
from studies.rk4_free_run import advance, free_runs


@fixture(scope="module")
def step() -> walker.Step:
    return walker.one_step()


def test_parameters_are_those_of_the_paper() -> None:
    # (57) put into (58) by hand
    assert_allclose(walker.true_parameters(), [31.25, 1.25, 2.5, 2.5, 5.0, 318.5, 24.5, 49.0], rtol=1e-12)


def test_record_is_068_s_at_100_hz_and_obeys_the_model(step: walker.Step) -> None:
    assert len(step.time_s) == 69
    assert step.time_s[-1] == approx(0.68)
    tau = biped3().inverse_dynamics(step.q, step.qd, step.qdd, walker.true_parameters())
    assert_allclose(tau, step.torque, atol=1e-9)
    assert np.all(step.torque[:, 0] == 0.0)


def test_integration_error_is_below_1e_10(step: walker.Step) -> None:
    q, qd = step.q[0], step.qd[0]
    for k in range(68):
        q, qd = advance(biped3(), walker.true_parameters(), q, qd, step.torque[k], walker.PERIOD_S, 80)
    assert_allclose(q, step.q[-1], atol=1e-10)


def test_controller_drives_the_virtual_constraints_to_zero(step: walker.Step) -> None:
    y = step.q @ walker.CONSTRAINTS.T - walker.TARGETS
    assert np.max(np.abs(y)) > 0.01  # the impact throws the posture off
    assert_allclose(y[-1], 0.0, atol=0.02)


def test_gait_repeats_itself() -> None:
    rate = walker.periodic_rate()
    assert 1.55 < rate < 1.65
    q, qd = walker.after_impact(rate)
    mechanism, beta = biped3(), walker.true_parameters()
    while q[0] < walker.IMPACT_RAD:
        last = q, qd
        q, qd = advance(mechanism, beta, q, qd, walker.control(mechanism, beta, q, qd), walker.PERIOD_S, 2)
    share = (walker.IMPACT_RAD - last[0][0]) / (q[0] - last[0][0])
    assert last[1][0] + share * (qd[0] - last[1][0]) == approx(rate, abs=1e-5)


def test_impact_loses_energy_and_keeps_momentum_about_the_new_foot() -> None:
    before = 1.6 * walker.CONSTRAINT_TANGENT
    q, after = walker.impact(before)
    mechanism, beta = biped3(), walker.true_parameters()
    landing = np.array([walker.IMPACT_RAD, np.pi - 2 * walker.IMPACT_RAD, walker.TORSO_RAD - walker.IMPACT_RAD])

    def energy(at: np.ndarray, rates: np.ndarray) -> float:
        return float(0.5 * rates @ mechanism.inertia_matrix(at, beta) @ rates)

    assert energy(q, after) < energy(landing, before)
    assert momentum(q, after, np.zeros(2)) == approx(momentum_before(before), rel=1e-9)


def masses(theta: np.ndarray, rates: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """(mass, position, velocity) of the four point masses, from vectors; foot at the origin."""
    along = np.stack([np.sin(theta), np.cos(theta)], axis=1)
    across = np.stack([np.cos(theta), -np.sin(theta)], axis=1) * rates[:, None]
    hip, hip_v = along[0], across[0]
    return [(5.0, 0.5 * along[0], 0.5 * across[0]), (15.0, hip, hip_v),
            (5.0, hip + 0.5 * along[1], hip_v + 0.5 * across[1]),
            (10.0, hip + 0.5 * along[2], hip_v + 0.5 * across[2])]


def momentum(q: np.ndarray, qd: np.ndarray, about: np.ndarray) -> float:
    absolute = biped3().transform
    found = masses(absolute @ q, absolute @ qd)
    return sum(m * float((p - about)[0] * v[1] - (p - about)[1] * v[0]) for m, p, v in found)


def momentum_before(qd: np.ndarray) -> float:
    theta = np.array([walker.IMPACT_RAD, np.pi - walker.IMPACT_RAD, walker.TORSO_RAD])
    rates = biped3().transform @ qd
    landing = np.array([np.sin(theta[:2]).sum(), np.cos(theta[:2]).sum()])
    return sum(m * float((p - landing)[0] * v[1] - (p - landing)[1] * v[0]) for m, p, v in masses(theta, rates))


def test_motor_angles_describe_the_same_motion(step: walker.Step) -> None:
    motors = step.in_motor_angles()
    tau = walker.motor_mechanism().inverse_dynamics(motors.q, motors.qd, motors.qdd, walker.true_parameters())
    assert_allclose(tau, motors.torque, atol=1e-9)
    b = np.array([[0, 0], [0, -1], [1, 1]])  # B of the paper: tau = B u
    assert_allclose(motors.torque[:, 1:] @ b.T, step.torque, atol=1e-12)


def test_free_runs_repeat_the_record_and_notice_failure(step: walker.Step) -> None:
    beta = np.tile(walker.true_parameters(), (3, 1))
    beta[1, 0] = 10.0  # positive definite at first, singular once the legs pass
    beta[2] = np.nan
    runs = free_runs(biped3(), beta, step.q[0], step.qd[0], step.torque, walker.PERIOD_S)
    assert_allclose(runs.q[0], step.q, atol=1e-7)
    assert runs.failed.tolist() == [False, True, True]
