"""`fit`: one door to every estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from daq import Dataset
from estimator.errors import FitError, ScaleError
from estimator.fitting.excitation import LEAST_POWER, LEAST_POWER_MLE, undetermined_by_design
from estimator.fitting.hekf import fit_hekf
from estimator.fitting.hold_choice import FIRST
from estimator.fitting.mle import fit_mle
from estimator.fitting.motion_search import first_fit, with_hold
from estimator.fitting.prior import check_known
from estimator.fitting.profile_likelihood import knows_noise, suits
from estimator.fitting.rls import fit_rls
from estimator.fitting.scale import require_scale
from estimator.fitting.wls import fit_wls
from estimator.likelihood import State
from estimator.methods import METHODS, Method
from estimator.model import Mechanism
from estimator.options import AUTO, FitOptions
from estimator.result import FitResult
from estimator.signals import is_plain, split_signals


class NominalFit(NamedTuple):
    """The likeliest model of runs without any effect, and how torque acts between their samples."""

    hold: str
    mechanism: Mechanism
    """With the friction's smoothing velocities."""
    state: State | None = None
    """Where the fit ends; not converged where the readings of an IMU were moved. None where there is no fit."""
    delays_s: tuple[float, ...] = ()
    """See `HoldChoice`."""


Estimator = Callable[[Sequence[Dataset], Mechanism, FitOptions], FitResult]
ESTIMATORS: dict[str, Estimator] = dict(zip(METHODS, (fit_mle, fit_wls, fit_rls, fit_hekf), strict=True))


def fit(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, method: Method = "mle") -> FitResult:
    """Identify `mechanism` from `datasets` by `method`; raises `FitError` where the data cannot answer.

    The result, or the error, names undetermined parameters by the regressor's excitation (`excitation`). For `mle` with
    given noise levels the covariance decides instead.

    >>> fit([run], leg2(lever_arm=0.2), FitOptions(sensors="imu")).beta  # doctest: +SKIP
    """
    try:
        result = estimate(datasets, mechanism, options, method)
    except ScaleError:
        raise
    except FitError as error:
        names = undetermined_by_design(datasets, mechanism, options)
        if not names:
            raise
        raise FitError(f"this data does not determine {', '.join(map(str, names))}: move every joint, or give "
                       f"parameters with --fix NAME=VALUE ({error})") from None
    if result.method == "mle" and (suits(split_signals(datasets, mechanism, options), mechanism, options)
                                   or (result.converged and knows_noise(mechanism, options))):
        return result
    sound = result.method == "mle" and result.converged
    names = undetermined_by_design(datasets, mechanism, options, LEAST_POWER_MLE if sound else LEAST_POWER)
    if sound and names:  # the motion is wanting: what is weak in it was hardly seen either
        names = undetermined_by_design(datasets, mechanism, options, LEAST_POWER)
    seen = {name for found in names for name, _ in found.amounts}
    return replace(result, undetermined=(*names, *(found for found in result.undetermined
                                                   if not seen & {name for name, _ in found.amounts})))


def fit_nominal(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> NominalFit:
    """`NominalFit` of all runs, with the hold and velocities that `options` state, or the likeliest; if no fit
    converges, one without a state."""
    try:
        check_known(mechanism, options.prior)
        require_scale(datasets, mechanism, options)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a fit that diverges raises
            fitted = with_hold(first_fit(datasets, mechanism, options))
        (problem, state, *_), chosen = fitted, fitted.chosen
        state = replace(state, smoothing=None, converged=state.converged and not fitted.age_s)
        return NominalFit(problem.collocation.hold, problem.mechanism, state, chosen.delays_s if chosen else ())
    except FitError:
        return NominalFit(FIRST if options.hold == AUTO else options.hold, mechanism)


def estimate(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, method: Method) -> FitResult:
    """`fit` without a look at the excitation; for many records of one experiment."""
    if method not in ESTIMATORS:
        raise FitError(f"method {method!r} is none of {', '.join(METHODS)}")
    check_known(mechanism, options.prior)
    require_scale(datasets, mechanism, options)
    if method != "mle" or options.latent == "free":
        own = "--latent free" if method == "mle" else f"--method {method}"
        _refuse(own, mechanism, options)
        options = replace(options, hold="linear") if options.hold == AUTO else options
    run = ESTIMATORS[method]
    if method == "mle" and options.latent == "free":
        from estimator.fitting.mle_free import fit_mle_free as run  # it alone needs sparse matrices
    # matrices are small: threads that wait for one another cost a quarter of the time; a fit that diverges raises
    with threadpool_limits(1), np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return run(datasets, mechanism, options)


def _refuse(own: str, mechanism: Mechanism, options: FitOptions) -> None:
    """Raise where `own`, a method other than the default, would not use what is declared."""
    for name, given in (("accel_correlation", options.accel_correlation != 0.0 and options.sensors == "imu"),
                        ("torque_correlation", bool(options.torque_correlation))):
        if given:
            raise FitError(f"{own} takes channels' noise for independent, and [noise] declares {name}: fit by "
                           "--method mle, or take the key out")
    if options.prior:
        raise FitError(f"{own} uses no prior, and the rig file has [prior]: fit by --method mle, or take it out")
    if not is_plain(mechanism, options):
        raise FitError(f"{own} knows one IMU on link 1 and encoders of all other joints: fit by --method mle")
