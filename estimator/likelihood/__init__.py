"""The likelihood of a motion: normal equations, nominal and with effects, batches, free runs."""

from estimator.likelihood.batch_likelihood import BatchProblem, Point, Records
from estimator.likelihood.disturbance import OFF, Process
from estimator.likelihood.dry_friction import REST_SPREAD, held_variance
from estimator.likelihood.effective_samples import effective_samples
from estimator.likelihood.free_run import LOST_RAD, FreeRun, free_run, pieces, read_motion
from estimator.likelihood.gauss_rows import GaussRows, unseen_level
from estimator.likelihood.kernels import compile_kernels
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.marginal import log_marginal, marginal_at
from estimator.likelihood.measured_runs import MeasuredRuns, slack_of
from estimator.likelihood.noise import Noise
from estimator.likelihood.noise_scale import NoiseScale, unit_scale
from estimator.likelihood.normal_equations import Latents, Linearised, add_reading
from estimator.likelihood.stage import Candidate, Stage
from estimator.likelihood.state import State
from estimator.likelihood.stiction import draw_stiction, find_smoothing, find_stiction

__all__ = [
    "LOST_RAD", "OFF", "REST_SPREAD", "BatchProblem", "Candidate", "FreeRun", "GaussRows", "LatentProblem", "Latents",
    "Linearised", "MeasuredRuns", "Noise", "NoiseScale", "Point", "Process", "Records", "Stage", "State",
    "add_reading", "compile_kernels", "draw_stiction", "effective_samples", "find_smoothing", "find_stiction",
    "free_run", "held_variance", "log_marginal", "marginal_at",
    "pieces", "read_motion", "slack_of", "unit_scale", "unseen_level",
]
