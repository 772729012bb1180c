"""Whoever uses the table of terms knows each of them, and all get the same from it."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark

from estimator.model import Collocation, Mechanism, Motion, Parameter, biped3, chain, joint1, leg2
from estimator.model.terms import TERMS
from tests.support.assembly_numpy import evaluate

EVERY = leg2(rotor_inertia=(1,), torque_offset=(0, 1))
MECHANISMS = [EVERY, biped3(), chain(4), joint1()]


def random(mechanism: Mechanism, seed: int) -> tuple[Motion, np.ndarray]:
    rng = np.random.default_rng(seed)
    return Motion(*rng.normal(size=(5, mechanism.n, 2, 130))), rng.normal(size=mechanism.p)


def test_the_leg_that_stands_for_all_has_every_term() -> None:
    assert {parameter.term for parameter in EVERY.parameters} == set(TERMS)


@mark.parametrize("mechanism", MECHANISMS, ids=lambda m: m.name)
def test_inertia_matrix_and_bias_make_the_regressor(mechanism: Mechanism) -> None:
    q, qd, qdd = np.random.default_rng(3).normal(size=(3, 6, mechanism.n))
    beta = np.linspace(0.5, 1.5, mechanism.p)
    parts = np.einsum("kij,kj->ki", mechanism.inertia_matrix(q, beta), qdd) + mechanism.bias_torque(q, qd, beta)
    assert mechanism.inverse_dynamics(q, qd, qdd, beta) == approx(parts, rel=1e-12)


@mark.parametrize("mechanism", MECHANISMS, ids=lambda m: m.name)
def test_collocation_has_the_regressor_where_the_rate_is_constant(mechanism: Mechanism) -> None:
    motion, _ = random(mechanism, 5)
    z = Collocation(mechanism, 0.01, "linear")
    found = z.to_joint(z.terms(motion._replace(rate_from=motion.rate, rate_to=motion.rate))[0])
    known = mechanism.regressor(*(np.moveaxis(x, 0, -1) for x in motion[:3]))  # (2, K, n, p)
    assert_allclose(found, known.transpose(3, 2, 0, 1), atol=1e-12)


@mark.parametrize("mechanism", MECHANISMS, ids=lambda m: m.name)
def test_slopes_are_the_derivatives(mechanism: Mechanism) -> None:
    motion, beta = random(mechanism, 6)
    motion = Motion(*(np.where(np.abs(x) < 0.1, 0.1, x) for x in motion))  # of the sign by its slowest scale, 0.005
    c, step = Collocation(mechanism, 0.01, "linear"), 1e-5
    slopes = evaluate(c, motion, beta)[1]
    for f in range(5):
        for j in range(mechanism.n):
            values = []
            for way in (step, -step):
                moved = [x.copy() for x in motion]
                moved[f][j] += way
                values.append(np.tensordot(beta, evaluate(c, Motion(*moved), beta)[0], axes=1))
            assert_allclose(slopes[:, :, f, j], (values[0] - values[1]) / (2 * step), atol=1e-5)


def kernels_are_right(mechanism: Mechanism, seed: int) -> np.ndarray:
    """Z of the kernels, as the table of terms has it."""
    motion, beta = random(mechanism, seed)
    c = Collocation(mechanism, 0.01, "linear")
    fast = c.fast(*motion, beta)
    for known, found in zip(evaluate(c, motion, beta), fast):
        assert_allclose(found, known, rtol=0.0, atol=1e-10)
    return fast[0]


@mark.parametrize("mechanism", MECHANISMS, ids=lambda m: m.name)
def test_kernels_have_the_terms_of_the_table(mechanism: Mechanism) -> None:
    kernels_are_right(mechanism, 4)


@mark.parametrize("term", TERMS)
def test_kernels_know_each_term_by_itself(term: str) -> None:
    """A code that no kernel asks for would leave its row empty."""
    parameters = Parameter("a", "", "", "inertia", (0, 0)), Parameter("b", "", "", term, (1, 1))
    pair = Mechanism("pair", np.tril(np.ones((2, 2))), parameters, 9.81, (1,))
    assert np.abs(kernels_are_right(pair, 7)[1]).max() > 0.1
