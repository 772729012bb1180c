"""Physically impossible parameters: which are fixed at zero, and which are reported as faults.

- A negative friction level or rotor inertia is fixed at zero; the other parameters are fitted again.
- A mass matrix that is not positive definite, negative gravity terms and impossible link lengths are faults.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr, ndtri

from daq import Dataset, FloatArray
from estimator.errors import FitError
from estimator.fitting.fit import fit
from estimator.methods import Method
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import TWO_SIDED, Finding, FitResult

NOT_NEGATIVE = ("viscous", "coulomb", "rotor")
"""Terms whose parameters are levels."""
SURE_STD = 3.0
"""Standard deviations by which a value must be on the wrong side to be more than scatter."""
LENGTHS_M = (0.005, 10.0)
"""Lengths that a link and its equivalent pendulum may have."""
ANGLES = 500
"""Samples of a motion at which the mass matrix is looked at."""


def faults(mechanism: Mechanism, beta: FloatArray, std: FloatArray, q: FloatArray) -> tuple[str, ...]:
    """Faults of `beta` (p,) over the angles q (N, n), one sentence each.

    A value is wrong if it is so by more than `SURE_STD` standard deviations `std` (p,), infinite where undetermined.
    """
    found = []
    step = max(1, len(q) // ANGLES)
    masses = [k for k, p in enumerate(mechanism.parameters) if p.term in ("inertia", "rotor")]
    known = bool(len(q)) and bool(np.isfinite(std[masses]).all())
    least = _sure_least(mechanism, beta, std, q[::step]) if known else np.ones(1)
    if least.min() <= 0.0:
        where = q[::step][int(np.argmin(least))]
        at = ", ".join(f"q{j + 1} = {x:.2f} {mechanism.length_unit}" for j, x in enumerate(where))
        found.append(f"the mass matrix is not positive definite (at {at}): no masses move like this")
    gravity = [k for k, p in enumerate(mechanism.parameters) if p.term == "gravity"]
    lifted = [k for k in gravity if beta[k] < -SURE_STD * std[k]]
    heavy = any(beta[k] > SURE_STD * std[k] for k in masses)  # one frequency alone cannot tell gravity from inertia
    if lifted and heavy and not any(beta[k] > SURE_STD * std[k] for k in gravity):
        found.append(f"gravity acts upwards ({_values(mechanism, beta, std, lifted)})")
    return (*found, *(text for text, motor in strange_lengths(mechanism, beta, std) if not motor))


def _sure_least(mechanism: Mechanism, beta: FloatArray, std: FloatArray, q: FloatArray) -> FloatArray:
    """(N,) upper limit of the mass matrix's smallest eigenvalue at the angles q (N, n): v' M v plus `SURE_STD` standard
    deviations, for the worst correlation of the parameters."""
    values, vectors = np.linalg.eigh(mechanism.inertia_matrix(q, beta))
    v = vectors[:, :, 0]
    slack = np.zeros(len(q))
    for k in np.flatnonzero(std > 0.0):
        if mechanism.parameters[k].term in ("inertia", "rotor"):
            one = mechanism.inertia_matrix(q, np.eye(mechanism.p)[k])
            slack += SURE_STD * std[k] * np.abs(np.einsum("ni,nij,nj->n", v, one, v))
    return values[:, 0] + slack


def strange_lengths(mechanism: Mechanism, beta: FloatArray, std: FloatArray) -> list[tuple[str, bool]]:
    """Lengths in `beta` (p,) that no link has, one clause each, and whether a motor's rotor may account for it.

    Inertia over gravity moment of a link is a length, and so is a product of inertia over the next link's moment. The
    rotor of a motor, by its gear ratio squared, adds to the inertia of its joint where no parameter stands for it.
    """
    if mechanism.length_unit == "m" or mechanism.gravity < 0.0:  # on a slide, or with g inside the parameters
        return []
    moment = {p.at[0]: k for k, p in enumerate(mechanism.parameters) if p.term == "gravity"}
    motors = set(mechanism.actuated) - {p.at[0] for p in mechanism.parameters if p.term == "rotor"}
    found = []
    for k, p in enumerate(mechanism.parameters):
        over = moment.get(max(p.at))
        if p.term != "inertia" or over is None or not all(
                beta[i] > SURE_STD * std[i] for i in (over, k)):
            continue
        length = float(beta[k] / beta[over])
        if not LENGTHS_M[0] <= length <= LENGTHS_M[1]:
            found.append((f"{p.name} over {mechanism.parameters[over].name} makes a length of {length:.2g} m",
                          length > LENGTHS_M[1] and len(set(p.at)) == 1 and p.at[0] in motors))
    return found


def fit_admissible(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, method: Method = "mle"
                   ) -> FitResult:
    """`fit` with levels that may not be negative held at zero where they come out so, and its findings.

    One level is held at a time, that of the most standard deviations below zero first. Its interval then reaches from
    zero to `upper_end`. Judged is by the noise alone: what runs disagree about excuses no set-up that is
    wrong. Raises `FitError` as `fit` does.
    """
    result = fit(datasets, mechanism, options, method)
    limits: dict[str, float] = {}
    findings: list[Finding] = []
    while (k := _most_negative(result)) is not None:
        name, value, std = mechanism.names[k], float(result.beta[k]), float(result.own_std[k])
        upper = upper_end(value, float(result.half_width[k]) / TWO_SIDED)
        low = f"{name} ({mechanism.parameters[k].meaning}) is {value:.2g} +- {std:.1g}, below its physical limit"
        if result.undetermined:  # a level in its place would pass for knowledge of the rest
            findings.append(Finding("warning", "level_at_zero", low))
            break
        sure = value < -SURE_STD * std
        scatter = ". That is not scatter: the model or the set-up is wrong" if sure else ""
        findings.append(Finding("warning", "level_negative" if sure else "level_at_zero",
                                f"{low}: fixed at 0, the others fitted again{scatter}"))
        held = replace(options, fixed={**options.fixed, **dict.fromkeys([*limits, name], 0.0)})
        try:
            result = fit(datasets, mechanism, held, method)
        except FitError as error:
            findings[-1] = Finding("warning", "level_at_zero", f"{low}; with 0 in its place there is no fit ({error})")
            break
        limits[name] = upper
    fixed = {name: value for name, value in result.fixed.items() if name not in limits}
    closed = np.where([name in result.open_parameters for name in mechanism.names], np.inf, result.own_std)
    q = np.concatenate([t.q for t in result.trajectories]) if result.trajectories else np.zeros((0, mechanism.n))
    impossible = faults(mechanism, result.beta, closed, q) if result.converged else ()
    findings += [Finding("warning", "length", f"{text}, which is impossible for a link: the inertia may include the "
                         "motor's rotor times the gear ratio squared, or a counterweight lowers the gravity term")
                 for text, motor in strange_lengths(mechanism, result.beta, closed) if motor and result.converged]
    return replace(result, fixed=fixed, at_bound=limits,
                   findings=(*findings, *(Finding("fault", "impossible", text) for text in impossible)))


def upper_end(value: float, std: float) -> float:
    """Upper end of the one-sided 95 % interval of a level that cannot be negative and came out at `value` +- `std`.

    Of the normal likelihood of levels from zero up, that share lies below it: it is never zero.
    """
    below = -value / max(std, 1e-300)
    above = 0.05 * ndtr(-below)
    if above > 0.0:
        return float(value - std * ndtri(above))
    return std * float(-np.log(0.05)) / below  # far out the likelihood falls like exp(-below x / std)


def _most_negative(result: FitResult) -> int | None:
    """The free level that lies most of its standard deviations below zero; None where none does."""
    share = [(float(value) / max(float(std), 1e-300), k) for k, (p, value, std) in
             enumerate(zip(result.mechanism.parameters, result.beta, result.own_std))
             if p.term in NOT_NEGATIVE and value < 0.0 and p.name not in {*result.fixed, *result.open_parameters}]
    return min(share)[1] if share and result.converged else None


def _values(mechanism: Mechanism, beta: FloatArray, std: FloatArray, which: Sequence[int]) -> str:
    return ", ".join(f"{mechanism.names[k]} = {beta[k]:.3g} +- {std[k]:.1g}" for k in which)
