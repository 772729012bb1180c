"""`FIT_ERRORS`, apart from the errors themselves: a command's help loads no numpy."""

from __future__ import annotations

import numpy as np

from estimator.errors import FitError

FIT_ERRORS = FitError, np.linalg.LinAlgError
"""What a fit raises that cannot be done, or whose equations have no solution."""
