"""The likelihood of a motion: normal equations, nominal and with effects, batches, free runs."""

from estimator.likelihood.batch_likelihood import BatchProblem, Point, Records
from estimator.likelihood.extended_likelihood import Candidate, ExtendedProblem, Stage
from estimator.likelihood.free_run import FreeRun, free_run
from estimator.likelihood.normal_equations import Latents
from estimator.likelihood.state import State
from estimator.likelihood.trajectory_likelihood import REST_SPREAD, TIGHT, LatentProblem, Noise

__all__ = [
    "REST_SPREAD", "TIGHT", "BatchProblem", "Candidate", "ExtendedProblem", "FreeRun", "LatentProblem", "Latents",
    "Noise", "Point", "Records", "Stage", "State", "free_run"
]
