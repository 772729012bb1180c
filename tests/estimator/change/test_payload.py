"""A body on a link: its change of the parameters, the bounds of physics, the interval of a ratio."""

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from estimator.change.payload import body_basis, fieller, fit_body, link_lengths
from estimator.model import biped3, joint1, leg2
from estimator.score import Score
from tests.support.changed_leg import loaded
from tests.support.mujoco_leg import random_leg


@mark.parametrize("link", [1, 2])
def test_a_body_moves_the_parameters_as_physics_says(link: int) -> None:
    leg = random_leg(default_rng(3))
    mass, distance, inertia = 0.1, 0.17, 0.0004
    before, after = leg.beta(), loaded(leg, link, mass, distance, inertia).beta()
    lengths = link_lengths(leg2(), before, np.zeros((9, 9)))
    assert lengths == {0: (approx(leg.l1), 0.0)}
    basis = body_basis(leg2(), link - 1, {0: leg.l1})
    assert basis is not None
    body = np.array([mass, mass * distance, mass * distance**2 + inertia])
    assert basis @ body == approx(after - before, abs=1e-12)


def test_a_length_is_as_uncertain_as_the_parameters_whose_ratio_it_is() -> None:
    beta = random_leg(default_rng(3)).beta()
    covariance = np.diag((0.01 * beta) ** 2)
    length, std = link_lengths(leg2(), beta, covariance)[0]
    assert std == approx(length * 0.01 * 2**0.5)
    draws = default_rng(0).multivariate_normal(beta, covariance, 4000)
    assert std == approx(np.std(draws[:, 2] / draws[:, 4]), rel=0.1)


def test_other_mechanisms_have_bodies_too_but_not_a_drive_in_volts() -> None:
    basis = body_basis(joint1(), 0, {})
    assert basis is not None and basis[:2] == approx(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]))
    upright = body_basis(biped3(), 1, {0: 0.5})
    assert upright is not None and upright[5:7, :2] == approx(9.8 * np.array([[0.5, 0.0], [0.0, 1.0]]))
    assert body_basis(leg2(), 1, {}) is None
    assert link_lengths(joint1(voltage=True), np.ones(4), np.eye(4)) == {}


def test_a_body_has_a_mass_and_an_inertia_that_physics_allows() -> None:
    """Against a search of all bodies on a grid."""
    rng = default_rng(1)
    for _ in range(5):
        rows = rng.normal(size=(6, 3))
        information, size = rows.T @ rows, np.array([0.5, 1.0, 1.5]) + 0.3 * rng.normal(size=3)  # m J < h^2, mostly
        found, gain = fit_body(Score(information @ size, information))
        m, h, j = found
        assert m * j >= h * h * (1.0 - 1e-6)
        a, b, d = np.meshgrid(np.linspace(0, 2, 81), np.linspace(-2, 2, 161), np.linspace(0, 2, 81), indexing="ij")
        grid = np.stack([a * a, a * b, b * b + d * d]).reshape(3, -1)
        values = 2.0 * (information @ size) @ grid - np.einsum("ik,ij,jk->k", grid, information, grid)
        assert gain >= values.max() - 1e-3 * abs(values.max())
        assert gain == approx(2.0 * found @ information @ size - found @ information @ found, rel=1e-6)


def test_the_interval_of_a_ratio_covers_it_and_is_open_where_the_denominator_may_be_zero() -> None:
    rng = default_rng(2)
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    draws = rng.multivariate_normal([1.0, 2.0], covariance, 2000)
    intervals = [fieller(x, covariance, 1.96) for x in draws]
    assert np.mean([i is None or i[0] < 0.5 < i[1] for i in intervals]) == approx(0.95, abs=0.015)
    assert fieller(np.array([1.0, 0.3]), covariance, 1.96) is None
