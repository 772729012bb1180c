"""The likelihood of a motion: normal equations, nominal and with effects, batches, free runs."""

from estimator.likelihood.batch_likelihood import BatchProblem, Point, Records
from estimator.likelihood.disturbance import Process
from estimator.likelihood.dry_friction import REST_SPREAD, held_variance
from estimator.likelihood.effective_samples import effective_samples
from estimator.likelihood.extended_likelihood import Candidate, ExtendedProblem, Stage
from estimator.likelihood.free_run import LOST_RAD, FreeRun, free_run, pieces, read_motion
from estimator.likelihood.kernels import compile_kernels
from estimator.likelihood.noise import Noise
from estimator.likelihood.noise_scale import NoiseScale, unit_scale
from estimator.likelihood.normal_equations import Latents, Linearised
from estimator.likelihood.state import State
from estimator.likelihood.stiction import draw_stiction, find_smoothing, find_stiction
from estimator.likelihood.trajectory_likelihood import LatentProblem, slack_of
from estimator.likelihood.weighted_residuals import weighted_residuals_after

__all__ = [
    "LOST_RAD", "REST_SPREAD", "BatchProblem", "Candidate", "ExtendedProblem", "FreeRun", "LatentProblem",
    "Latents", "Linearised", "Noise", "NoiseScale", "Point", "Process", "Records", "Stage", "State", "compile_kernels",
    "draw_stiction", "effective_samples", "find_smoothing", "find_stiction", "free_run", "held_variance", "pieces",
    "read_motion", "slack_of", "unit_scale", "weighted_residuals_after",
]
