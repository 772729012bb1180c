"""`noise_floor`: the noise that a rig really has: a coloured disturbance torque of each joint, and friction near rest.

Free runs of replicates with this noise show how large an error is unavoidable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.diagnosis.model import Model
from estimator.fitting import Disturbance, MarginalLikelihood, disturbance_likelihood, find_disturbance, of_noise
from estimator.likelihood import LatentProblem
from estimator.options import FitOptions
from estimator.prediction import FloorNoise, driven_columns, repeated_share, state_columns, taken, white_noise
from estimator.signals import SignalSet

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares that are compared of the most that dry friction leaves open near rest."""


def noise_floor(model: Model) -> FloorNoise:
    """The noise of a fitted model, of which a coloured disturbance torque and friction near rest take their parts.

    All are the most likely ones at the fitted motion (`estimator.fitting.disturbance`). Where the equations cannot be
    solved the noise is the fit's own, white.
    """
    try:
        return _coloured(model)
    except np.linalg.LinAlgError:
        return white_noise(model.state.noise)


def _coloured(model: Model) -> FloorNoise:
    split, state = model.split, model.state
    signals = split.signals(split.train)

    def disturbed(parts: Sequence[SignalSet]) -> LatentProblem:
        return split.problem(split.train, model.problem.stage.angle_range, model.effects, signals=parts,
                             disturbed=True)

    likelihood = disturbance_likelihood(signals, model.problem, state, disturbed)
    options: FitOptions = replace(split.options, noise=dict(split.known))
    found = find_disturbance(likelihood, of_noise(state.noise), options)
    rest, likelihood = _share_near_rest(likelihood, found)
    found = find_disturbance(likelihood, found, options)
    repeated = np.zeros_like(found.level)
    if found.level.any():
        repeated = _repeated(model, disturbance_likelihood(signals, model.problem, state, disturbed, np.inf), found)
    found = found._replace(level=found.level * np.sqrt(1.0 - repeated))
    return FloorNoise(found.put(state.noise), rest, repeated)


def _repeated(model: Model, whole: MarginalLikelihood, disturbance: Disturbance) -> FloatArray:
    """(n,) share of each joint's disturbance that is a function of the state, or of how fast its torque changes, and
    repeats from run to run: a listed effect, or structure, is no noise."""
    problem, x = model.problem, model.state.x
    e = whole.smoothed(disturbance)
    lengths = np.diff(problem.ends, prepend=0)
    run = np.repeat(problem.stage.run, lengths)
    time = (np.arange(problem.total) - np.repeat(problem.ends - lengths, lengths)) * problem.dt
    torques = driven_columns(problem.torque[:, list(problem.mechanism.actuated)], problem.ends)
    columns, which = state_columns(x.q, x.v, np.column_stack([torques, time]), problem.ends), taken(problem.total)
    return repeated_share(np.where(disturbance.level > 0.0, e[which], 0.0), columns, run[which])


def _share_near_rest(likelihood: MarginalLikelihood, disturbance: Disturbance) -> tuple[FloatArray, MarginalLikelihood]:
    """(n,) of SHARES the likeliest, joint after joint; and the likelihood that has them."""
    n = likelihood.problem.n
    rest, most = np.zeros(n), likelihood.problem.stiction(likelihood.noise)
    if most is None:
        return rest, likelihood
    now = most.copy()
    for j in range(n):
        values = []
        for share in SHARES:
            now[:, 0, j] = share**2 * most[:, 0, j]
            values.append(likelihood.with_stiction(now.copy())(disturbance))
        rest[j] = SHARES[int(np.argmax(values))]
        now[:, 0, j] = rest[j] ** 2 * most[:, 0, j]
    return rest, likelihood.with_stiction(now)
