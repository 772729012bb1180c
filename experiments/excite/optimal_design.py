"""`legid excite`: a torque plan that tells as much as it can about all parameters, within the rig's limits.

The plan is a Fourier series of odd harmonics 1, 3, 5, ... of one over its length, so that what is even in the response
(a quadratic drag, play) stands apart. Amplitudes and phases are free, and an optimiser moves them along the gradient
of the predicted information (`fisher_information`) with the limits as a penalty. Phases alone do not do:
friction is told from viscous drag by speeds that differ, and a stationary multisine of whatever phases has Gaussian
speeds, which leave a joint's Coulomb level at 1.7 times the error it would have alone; a chirp does the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from daq import FloatArray, InputError, Limits, Rig, WorkError
from daq.recording import Plan
from estimator.model import Mechanism
from experiments.excite.fisher_information import Moved, PlanInformation
from experiments.excite.limits import as_large_as_allowed, bounds, neighbours, peaks
from experiments.models import Model, build_mechanism

RATE_HZ = 100.0
"""Of a plan."""
COARSE_HZ = 50.0
"""While it is being bettered; more where the band needs it."""
SAMPLES_A_PERIOD = 12.0
TAPER_S = 0.5
"""Torque comes and goes over this time: a step would shake the leg."""
USUAL_NOISE = {"gyro_radps": 0.005, "accel_mps2": 0.05, "torque_nm": 0.02, "encoder_rad": 4e-4}
"""Where the prior model names no level."""
MODEL_ERROR = 0.1
"""Share by which the prior's parameters may be off: models that far away must keep the limits too."""
CRITERIA = {"d": 0.5, "worst": 0.95}
"""Share of the worst relative standard error in what is made small; the rest is the mean of all of them, both as
logarithms. The mean alone is D-optimality: it gives up the worst parameter where the others gain more."""
SHARPNESS = 12.0
"""Power of the mean that stands for the largest standard error."""
INNER = 0.98
"""Penalties begin at this share of what may be used."""
PENALTY = 2.0
START_KNEE_HZ = 0.5
"""Amplitudes of a first draw fall off above this."""
START_SHARE = 0.5
"""Of its largest size: from there the optimiser has room."""
FALLEN = 1e6
"""Criterion of a plan whose motion diverges."""


@dataclass(frozen=True)
class Band:
    """Length [s] and frequencies [Hz] of a plan."""

    seconds: float
    low_hz: float
    high_hz: float


@dataclass(frozen=True)
class Search:
    """Settings of the search for a plan."""

    margin: float = 0.8
    """Share of each limit that is used."""
    criterion: str = "d"
    tries: int = 2
    """Random starts."""
    steps: int = 80
    """Of the optimiser, from each."""
    seed: int = 0


@dataclass(frozen=True)
class Candidate:
    """One plan and what is predicted of it."""

    torque_nm: FloatArray
    information: FloatArray
    """(p, p)"""
    peaks: dict[str, float]
    """Largest torque, speed and angles."""

    @property
    def std(self) -> FloatArray:
        """(p,) predicted standard errors."""
        return standard_errors(self.information)

    @property
    def condition(self) -> float:
        """See `condition_number`."""
        return condition_number(self.information)

    @property
    def plan(self) -> Plan:
        return Plan(np.arange(self.torque_nm.size) / RATE_HZ, self.torque_nm)


@dataclass(frozen=True)
class Design:
    """The best plan found, and the first draw: lines of equal amplitude and random phases."""

    first: Candidate
    best: Candidate
    names: tuple[str, ...]
    beta: FloatArray


def standard_errors(information: FloatArray) -> FloatArray:
    """(p,) of a fit with this information; infinite where it leaves any parameter open."""
    try:
        np.linalg.cholesky(information)
        variance = np.diag(np.linalg.inv(information))
    except np.linalg.LinAlgError:
        return np.full(len(information), np.inf)
    return np.sqrt(np.where(variance > 0, variance, np.inf))


def condition_number(information: FloatArray) -> float:
    """Square root of that of the parameters' correlation matrix: how well they can be told apart."""
    std = standard_errors(information)
    if not np.isfinite(std).all():
        return float("inf")
    covariance = np.linalg.inv(information)
    level = np.linalg.eigvalsh(covariance / np.outer(std, std))
    return float(np.sqrt(level[-1] / max(level[0], 1e-300)))


class Bench:
    """A prior model on a rig: where plans are tried."""

    def __init__(self, model: Model, rig: Rig, where: str, model_error: float = MODEL_ERROR) -> None:
        """`where` names the model in errors; `model_error` see `MODEL_ERROR`.

        Raises `InputError` for a model of another rig, and for a rig that no plan fits."""
        if (model.mechanism.model, model.mechanism.actuated) != (rig.mechanism.model, rig.mechanism.actuated):
            raise InputError(where, f"is of a {model.mechanism.model}, the rig is a {rig.mechanism.model} or drives "
                                    "other joints", "give a model of this rig")
        self.mechanism: Mechanism = build_mechanism(model.mechanism)
        if len(self.mechanism.actuated) != 1 or self.mechanism.n > 2 or model.mechanism.prismatic:
            raise InputError(where, "is not a mechanism of one or two rotary joints with one driven joint",
                             "give a model of such a rig")
        self.beta = np.array(model.beta)
        signed = np.array([p.term == "offset" for p in self.mechanism.parameters])
        sizes = np.where(signed, np.abs(self.beta), self.beta)
        least = int(np.argmin(sizes))
        if not sizes[least] > 0:
            raise InputError(where, f"{self.mechanism.names[least]} is {'zero' if signed[least] else 'not positive'}, "
                                    "so the model cannot be used for a design",
                             "give a model from a fit that determines it")
        self.limits: Limits = rig.limits
        self._levels = {**USUAL_NOISE, **{name: level for name, level in model.noise.items() if level > 0}}
        self._noise_hz = rig.sampling.planned_hz
        self._has_imu = model.mechanism.model == "leg2" and model.provenance.sensors == "imu"
        self.fine = self.prior(RATE_HZ)
        self.others = neighbours(self.fine, model_error)

    def prior(self, rate_hz: float) -> PlanInformation:
        """The information of plans sampled at this rate, of the fit that the rig's own rate would give."""
        scale = np.sqrt(rate_hz / self._noise_hz)
        noise = {name: scale * level for name, level in self._levels.items() if name != "passive_joint_nm"}
        return PlanInformation(self.mechanism, self.beta, noise, rate_hz, self._has_imu)

    def sized(self, shape: FloatArray, margin: float, largest_nm: float | None = None) -> Candidate | None:
        """The shape at RATE_HZ, of peak one, as large as the limits allow, judged; None where that cannot be."""
        moved = as_large_as_allowed(self.fine, shape, self.limits, margin, largest_nm, self.others)
        if moved is None:
            return None
        return Candidate(moved.torque, self.fine.eliminated(moved).information, peaks(moved))


class Series:
    """Odd harmonics of one over a plan's length, in its band, tapered at both ends."""

    def __init__(self, band: Band) -> None:
        """Raises `InputError` where the band holds fewer than three."""
        odd = np.arange(1, int(band.high_hz * band.seconds + 1e-9) + 1, 2) / band.seconds
        self.hz = odd[odd >= band.low_hz]
        if self.hz.size < 3:
            raise InputError("--high", f"leaves {self.hz.size} odd harmonics of 1/{band.seconds:.3g} s",
                             "raise it, or make the plan longer")
        self.band = band

    def basis(self, rate_hz: float) -> FloatArray:
        """(2 h, N) sines, then cosines."""
        t = np.arange(round(self.band.seconds * rate_hz)) / rate_hz
        angle = 2.0 * np.pi * self.hz[:, None] * t
        taper = np.clip(np.minimum(t, t[-1] - t) / TAPER_S, 0.0, 1.0)
        return np.asarray(np.concatenate([np.sin(angle), np.cos(angle)]) * taper)


def design(bench: Bench, band: Band, search: Search,
           progress: Callable[[float, float], None] | None = None) -> Design:
    """Best of the plans that the optimiser comes to from `search.tries` starts. Raises `InputError`, `WorkError`."""
    series = Series(band)
    rng = np.random.default_rng(search.seed)
    fine = series.basis(RATE_HZ)
    phases = rng.uniform(0.0, 2.0 * np.pi, series.hz.size)
    first = bench.sized(_unit(np.concatenate([np.cos(phases), np.sin(phases)]) @ fine), search.margin)
    best = first
    coarse = bench.prior(max(COARSE_HZ, min(SAMPLES_A_PERIOD * band.high_hz, RATE_HZ)))
    for k in range(search.tries):
        start = rng.standard_normal(2 * series.hz.size) / np.tile(1.0 + (series.hz / START_KNEE_HZ) ** 2, 2)
        found = _bettered(bench, coarse, series, start, search, partial(_tell, progress, k, search))
        if found is None:
            continue
        torque = found @ fine
        largest = float(np.abs(torque).max())
        candidate = bench.sized(torque / largest, search.margin, largest) if largest > 0 else None
        if candidate is None:
            continue
        first = first or candidate
        best = min(best or first, candidate, key=lambda c: _worth(c, bench, search))
    if first is None or best is None:
        raise WorkError("no excitation within the limits was found; widen [limits], or lower --high")
    return Design(first, best, bench.mechanism.names, bench.beta)


def _tell(progress: Callable[[float, float], None] | None, done: int, search: Search, step: int) -> None:
    """Starts done, and steps of the present one, as starts out of all."""
    if progress is not None:
        progress(done + step / search.steps, float(search.tries))


def _unit(wave: FloatArray) -> FloatArray:
    return np.asarray(wave / np.max(np.abs(wave)))


def _worth(candidate: Candidate, bench: Bench, search: Search) -> float:
    try:
        return merit(candidate.information, bench.beta, CRITERIA[search.criterion])[0]
    except np.linalg.LinAlgError:
        return np.inf


def merit(information: FloatArray, beta: FloatArray, share: float) -> tuple[float, FloatArray]:
    """Merit to be minimised, and M (p, p) with d merit = -trace(M dF).

    (1 - share) of the mean logarithm of the standard errors (in the sense of the determinant), `share` of the
    logarithm of the largest relative one, as a power mean. Raises LinAlgError where F is not positive definite.
    """
    np.linalg.cholesky(information)
    covariance = np.linalg.inv(information)
    p = len(beta)
    relative = np.sqrt(np.diag(covariance)) / np.abs(beta)
    power = (relative / relative.max()) ** SHARPNESS
    worst = float(np.log(relative.max()) + np.log(power.sum()) / SHARPNESS)
    mean = -0.5 * float(np.linalg.slogdet(information)[1]) / p - float(np.mean(np.log(np.abs(beta))))
    by_variance = 0.5 * power / power.sum() / np.diag(covariance)
    slope = (1.0 - share) * covariance / (2.0 * p) + share * (covariance * by_variance) @ covariance
    return (1.0 - share) * mean + share * worst, slope


def _bettered(bench: Bench, prior: PlanInformation, series: Series, start: FloatArray, search: Search,
              progress: Callable[[int], None]) -> FloatArray | None:
    """Coefficients (2 h,) that the optimiser comes to; None where it cannot begin."""
    from scipy.optimize import minimize

    basis = series.basis(prior.rate_hz)
    torque_most, speed_most, angle_most = bounds(bench.limits, INNER * search.margin, bench.mechanism.n)
    scale = float(np.abs(start @ basis).max())
    begin = as_large_as_allowed(prior, start @ basis / scale, bench.limits, search.margin)
    if begin is None:
        return None
    last: list[Moved] = [begin]
    steps = itertools.count(1)

    def value(x: FloatArray) -> tuple[float, FloatArray]:
        torque = x @ basis
        moved = prior.move(torque, last[0])
        if moved is None:
            return FALLEN, np.zeros_like(x)
        try:
            at = prior.eliminated(moved)
            worth, slope = merit(at.information, bench.beta, CRITERIA[search.criterion])
            weights = np.asarray(np.linalg.cholesky(slope), dtype=np.float64)
        except np.linalg.LinAlgError:
            return FALLEN, np.zeros_like(x)
        last[0] = moved
        by_q, by_v = prior.by_motion(moved, at, weights)
        over_q, over_v, over_u = (np.maximum(np.abs(a) / most - 1.0, 0.0) for a, most in
                                  ((moved.q, angle_most), (moved.v, speed_most), (torque, torque_most)))
        worth += PENALTY * float((over_q**2).sum() + (over_v**2).sum() + (over_u**2).sum())
        by_torque = prior.by_torque(at, 2 * PENALTY * over_q * np.sign(moved.q) / angle_most - by_q,
                                    2 * PENALTY * over_v * np.sign(moved.v) / speed_most - by_v)
        by_torque += 2 * PENALTY * over_u * np.sign(torque) / torque_most
        return worth, basis @ by_torque

    def count(xk: FloatArray) -> None:  # the name that minimize calls it by
        progress(next(steps))

    size = START_SHARE * float(np.abs(begin.torque).max()) / scale
    found = minimize(value, size * start, jac=True, method="L-BFGS-B", callback=count,
                     options={"maxiter": search.steps, "maxcor": 20})
    return np.asarray(found.x) if np.isfinite(found.x).all() and found.fun < FALLEN else None


def design_text(found: Design, limits: Limits) -> str:
    """Gain, prediction, and distance from the limits, for a person."""
    ratio = found.best.std / found.first.std
    relative = found.best.std / np.abs(found.beta)
    worst_before = int(np.argmax(found.first.std / np.abs(found.beta)))
    worst = int(np.argmax(relative))
    limit = ", ".join(f"{name} {value:.3g} of {getattr(limits, name):g}" for name, value in found.best.peaks.items())
    return "\n".join([
        f"condition number before {found.first.condition:.1f} (first draw: equal lines, random phases), after "
        f"{found.best.condition:.1f}",
        f"predicted standard errors: {float(np.exp(np.mean(np.log(ratio)))):.2f} of the first draw's in the mean, "
        f"{ratio[worst_before]:.2f} for its worst parameter ({found.names[worst_before]}); worst now "
        f"{found.names[worst]}, {100 * relative[worst]:.2g} % of its value",
        f"peaks by the prior model: {limit}"])
