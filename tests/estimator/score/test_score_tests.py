"""What score tests ask for, and what columns explain together."""

from dataclasses import replace

import numpy as np
from pytest import approx, mark

from estimator.score import NO_TESTS, least_sigmas


@mark.parametrize("tests, sigmas", [(0, 2.58), (1, 2.58), (10, 3.29), (160, 4.0)])
def test_more_tests_ask_for_more_standard_deviations(tests: int, sigmas: float) -> None:
    """Quantiles of the normal distribution at 1 % and at 0.1 % are 2.58 and 3.29."""
    assert least_sigmas(tests) == approx(sigmas, abs=0.01)


def test_what_columns_explain_together_is_a_squared_multiple_correlation() -> None:
    """Three columns of a Gaussian sample, the information of a linear model: closed form by least squares."""
    rng = np.random.default_rng(8)
    x = rng.normal(size=(400, 3))
    y = x[:, 0] - 0.5 * x[:, 1] + rng.normal(size=400)
    columns = np.column_stack([y, x])
    tests = replace(NO_TESTS, information=columns.T @ columns, before=np.sum(columns**2, axis=0))
    left = y - x @ np.linalg.lstsq(x, y)[0]
    assert tests.explained(0, np.array([1, 2, 3])) == approx(1.0 - float(left @ left) / float(y @ y))
    one = float(x[:, 0] @ y) ** 2 / float(x[:, 0] @ x[:, 0]) / float(y @ y)
    assert tests.explained(0, np.array([1])) == approx(one) and one < 0.7
    hidden = replace(tests, information=np.zeros((4, 4)))
    assert hidden.explained(0, np.array([1, 2])) == 0.0
