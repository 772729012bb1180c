"""Student's t against SciPy's."""

import numpy as np
import pytest
from scipy.special import stdtrit

from estimator.numerics import student_half_width


@pytest.mark.parametrize("share", [0.5, 0.95, 0.99])
def test_half_widths_are_those_of_scipy(share: float) -> None:
    freedom = [1, 2, 3, 4, 5, 6, 79, 500, 1001]
    found = [student_half_width(share, nu) for nu in freedom]
    np.testing.assert_allclose(found, stdtrit(freedom, 0.5 + 0.5 * share), rtol=1e-12)
