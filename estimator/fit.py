"""`fit`: one door to every estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from daq.dataset import Dataset
from estimator.errors import FitError
from estimator.hekf import fit_hekf
from estimator.mechanism import Mechanism
from estimator.mle import fit_mle
from estimator.mle_free import fit_mle_free
from estimator.options import FitOptions
from estimator.result import FitResult
from estimator.rls import fit_rls
from estimator.wls import fit_wls

Estimator = Callable[[Sequence[Dataset], Mechanism, FitOptions], FitResult]
ESTIMATORS: dict[str, Estimator] = {"mle": fit_mle, "wls": fit_wls, "rls": fit_rls, "hekf": fit_hekf}
METHODS = ("mle", "wls", "rls", "hekf")


def fit(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, method: str = "mle") -> FitResult:
    """Identify `mechanism` from `datasets` by `method`; raises `FitError` where the data cannot answer.

    >>> fit([run], leg2(lever_arm=0.2), FitOptions(sensors="imu")).beta  # doctest: +SKIP
    """
    if method not in ESTIMATORS:
        raise FitError(f"method {method!r} is none of {', '.join(ESTIMATORS)}")
    if method == "mle" and options.latent == "free":
        return fit_mle_free(datasets, mechanism, options)
    return ESTIMATORS[method](datasets, mechanism, options)
