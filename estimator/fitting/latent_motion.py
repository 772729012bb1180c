"""`converge_motion`: the most likely motion of a record with parameters and noise levels held.

Full Gauss-Newton steps alternate between two motions where a joint reverses close to a sample. So a step that raises
the objective is followed by a shorter one. (Measured with dry friction: full steps end 20 to 9,000 above the optimum.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimator.fitting.damping import FallDamping
from estimator.fitting.gauss_newton import Policies, descend
from estimator.fitting.newton_step import Taken
from estimator.fitting.noise_update import REST_STEPS
from estimator.fitting.stopping import SmallFall
from estimator.likelihood import LatentProblem, State, find_stiction, log_marginal

CONVERGE_STEPS = 15
"""Most steps from the motion of a fit, whose noise levels still move and whose objective is compared."""


@dataclass
class StictionAlone:
    """Renewal of what dry friction leaves open at rest, where neither the problem nor the state knows it."""

    anew: bool = False
    change: float = 0.0
    _finds: bool = False

    def before(self, problem: LatentProblem, state: State, iteration: int) -> None:
        """Update it in the first steps."""
        self._finds = problem.stiction(state.noise) is None if iteration == 0 else self._finds
        self.anew = self._finds and iteration < REST_STEPS
        if self.anew:
            state.noise = replace(state.noise, stiction=find_stiction(problem, state.x.v, state.beta))

    def after(self, problem: LatentProblem, state: State, taken: Taken, iteration: int) -> LatentProblem:
        """The problem as it is."""
        return problem


def converge_motion(problem: LatentProblem, state: State, limit: int = CONVERGE_STEPS) -> State:
    """`state` with the likeliest motion, sought from its own in up to `limit` steps.

    Where neither the problem nor the state knows what dry friction leaves open at rest, it is found on the way. Raises
    `FitError` where the equations become singular.
    """
    stop, held = SmallFall(state.x, limit), np.zeros(state.beta.size, bool)
    by = Policies(StictionAlone(), stop, FallDamping())
    found = descend(problem, replace(state, smoothing=None), held, by, limit + 1)
    return replace(state, x=stop.best, noise=found.noise)


def marginal_of(problem: LatentProblem, state: State) -> float:
    """`log_marginal` at the likeliest motion. Raises `FitError`.

    A fit ends with its parameters, and its motion can be half way: -2 log p was then 490,000 too large.
    """
    return log_marginal(problem, converge_motion(problem, state))
