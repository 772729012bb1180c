"""`legid excite`: a torque plan that tells as much as it can about all parameters, within the rig's limits.

The plan is an odd random-phase multisine: harmonics 1, 3, 5, ... of one over its length, so that what is even in the
response (a quadratic drag, play) stands apart. Its information is that of the fit
itself: the plan is run on a prior model with that model's noise, fitted, and the inverse of the fit's covariance is F.
D-optimal is the largest det F. (A regressor's own Z'Z ranks plans otherwise than refits do: it takes noise of the
accelerations for white, where a fit knows that they integrate to the angles.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np

from daq.dataset import FloatArray
from daq.errors import InputError, WorkError
from daq.plan import Plan
from daq.rig import Limits
from estimator.errors import FitError
from estimator.fit import fit
from estimator.mechanism import Mechanism
from estimator.options import FitOptions
from estimator.simulation import simulate
from experiments.model_file import Model
from experiments.rigs import build_mechanism
from experiments.simulated_run import simulate_run

RATE_HZ = 100.0
TAPER_S = 0.5
"""Torque comes and goes over this time: a step would shake the leg."""
SHRINK = 0.85
SHRINKS = 24
GROW = 1.5
"""A plan is not tried with more than this many times the best one's torque: most would leave the limits."""
NOISE_SEED = 1
"""One draw for all plans, so that they differ by their motion only."""
USUAL_NOISE = {"gyro_radps": 0.005, "accel_mps2": 0.05, "torque_nm": 0.02, "encoder_rad": 4e-4}
"""Where the prior model names no level."""
RANDOM_SHARE = 0.5
"""Share of the tries that are fresh draws; the others change the best so far."""


@dataclass(frozen=True)
class Band:
    """Length [s] and frequencies [Hz] of a plan."""

    seconds: float
    low_hz: float
    high_hz: float


@dataclass(frozen=True)
class Candidate:
    """One plan and what is predicted of it."""

    torque_nm: FloatArray
    log_det: float
    condition: float
    """Square root of that of the parameters' correlation matrix: how well they can be told apart."""
    std: FloatArray
    """(p,) predicted standard errors."""
    peaks: dict[str, float]
    """Largest torque, speed and angles."""


@dataclass(frozen=True)
class Design:
    """The best plan found, beside the first draw."""

    plan: Plan
    first: Candidate
    best: Candidate
    tries: int
    names: tuple[str, ...]


def design(model: Model, limits: Limits, band: Band, margin: float, tries: int, seed: int, where: str,
           progress: Callable[[float, float], None] | None = None) -> Design:
    """Best of `tries` plans, half drawn, half bettered. Raises `InputError` or `WorkError`."""
    mechanism = build_mechanism(model.mechanism)
    if len(mechanism.actuated) != 1 or mechanism.n > 2 or model.mechanism.prismatic:
        raise InputError(where, "is no mechanism of one or two rotary joints of which one is driven",
                         "give a model of such a rig")
    harmonics = _harmonics(band)
    rng = np.random.default_rng(seed)
    first = best = None
    best_x = np.zeros((2, harmonics.size))
    for k in range(tries):
        if best is None or k < RANDOM_SHARE * tries:
            x = np.stack([rng.uniform(0, 2 * np.pi, harmonics.size), rng.uniform(0.2, 1.0, harmonics.size)])
        else:
            x = best_x + np.array([[0.5], [0.15]]) * rng.standard_normal(best_x.shape)
            x[1] = np.clip(x[1], 0.05, 1.0)
        largest: float | None = None if best is None else GROW * best.peaks["torque_nm"]
        found = within_limits(model, mechanism, _shape(x, harmonics, band), limits, margin, largest)
        if progress is not None:
            progress(float(k + 1), float(tries))
        if found is None:
            continue
        first = first or found
        if best is None or found.log_det > best.log_det:
            best, best_x = found, x
    if first is None or best is None:
        raise WorkError("no excitation within the limits was found; widen [limits], or lower --high")
    time_s = np.arange(best.torque_nm.size) / RATE_HZ
    return Design(Plan(time_s, best.torque_nm), first, best, tries, mechanism.names)


def _harmonics(band: Band) -> FloatArray:
    """Odd multiples of 1 / seconds within the band [Hz]."""
    base = 1.0 / band.seconds
    odd = base * np.arange(1, int(band.high_hz / base) + 1, 2)
    chosen = odd[odd >= band.low_hz]
    if chosen.size < 3:
        raise InputError("--high", f"leaves {chosen.size} odd harmonics of 1/{band.seconds:g} s",
                         "raise it, or make the plan longer")
    return np.asarray(chosen, dtype=float)


def _shape(x: FloatArray, harmonics: FloatArray, band: Band) -> FloatArray:
    """Multisine of peak one with phases x[0] and amplitudes x[1], tapered at both ends."""
    t = np.arange(round(band.seconds * RATE_HZ)) / RATE_HZ
    wave = (x[1][:, None] * np.sin(2 * np.pi * harmonics[:, None] * t + x[0][:, None])).sum(axis=0)
    wave *= np.clip(np.minimum(t, t[-1] - t) / TAPER_S, 0.0, 1.0)
    return np.asarray(wave / np.max(np.abs(wave)))


def within_limits(model: Model, mechanism: Mechanism, shape: FloatArray, limits: Limits, margin: float,
                  largest_nm: float | None = None) -> Candidate | None:
    """The shape as large as the simulated motion allows; None where no size does.

    `margin`: share of each limit that is used. `largest_nm`: where to begin, if below that share of the torque limit.
    """
    angles = np.array([limits.q1_rad, limits.q2_rad][: mechanism.n])
    beta, driven = np.array(model.beta), mechanism.actuated[0]
    size = margin * limits.torque_nm if largest_nm is None else min(margin * limits.torque_nm, largest_nm)
    for _ in range(SHRINKS):
        tau = np.zeros((shape.size, mechanism.n))
        tau[:, driven] = size * shape
        zero = np.zeros(mechanism.n)
        q, v, _ = simulate(mechanism, beta, zero, zero, tau, 1.0 / RATE_HZ, "zero")
        if np.isfinite(q).all() and (np.abs(q) <= margin * angles).all() \
                and np.abs(v).max() <= margin * limits.speed_radps:
            peaks = {"torque_nm": float(np.abs(tau).max()), "speed_radps": float(np.abs(v).max()),
                     **{f"q{j + 1}_rad": float(np.abs(q[:, j]).max()) for j in range(mechanism.n)}}
            return _judged(tau[:, driven], covariance(model, mechanism, tau[:, driven]), peaks)
        size *= SHRINK
    return None


def covariance(model: Model, mechanism: Mechanism, torque_nm: FloatArray) -> FloatArray | None:
    """(p, p) of a fit to the plan's run on the model; None where that fit fails."""
    levels = {**USUAL_NOISE, **{name: level for name, level in model.noise.items() if level > 0}}
    plan = Plan(np.arange(torque_nm.size) / RATE_HZ, torque_nm)
    nominal = msgspec.structs.replace(model, noise=levels, hold="zero", effects=())
    options = FitOptions(sensors="imu" if model.mechanism.model == "leg2" else "encoder", hold="zero", noise=levels)
    try:
        data = simulate_run(nominal, plan, "the prior model", RATE_HZ, noise_seed=NOISE_SEED)
        return fit([data], mechanism, options).covariance
    except (FitError, WorkError):
        return None


def _judged(torque: FloatArray, cover: FloatArray | None, peaks: dict[str, float]) -> Candidate | None:
    if cover is None or not np.isfinite(cover).all() or not (np.diag(cover) > 0).all():
        return None
    std = np.sqrt(np.diag(cover))
    level = np.linalg.eigvalsh(cover / np.outer(std, std))
    if level[0] <= 0:
        return None
    return Candidate(torque, -float(np.log(level).sum() + 2 * np.log(std).sum()),
                     float(np.sqrt(level[-1] / level[0])), std, peaks)


def design_text(found: Design, limits: Limits) -> str:
    """What was gained, and how near the limits it goes."""
    ratio = found.best.std / found.first.std
    worst = int(np.argmax(ratio))
    peaks = ", ".join(f"{name} {value:.3g} of {getattr(limits, name):g}" for name, value in found.best.peaks.items())
    gain = np.exp(-(found.best.log_det - found.first.log_det) / (2 * len(found.names)))
    return "\n".join([
        f"condition number before {found.first.condition:.1f} (first draw), after {found.best.condition:.1f} "
        f"(best of {found.tries})",
        f"predicted standard errors: {gain:.2f} of the first draw's in the mean, {ratio[worst]:.2f} at worst "
        f"({found.names[worst]})",
        f"peaks by the prior model: {peaks}"])
