"""`compile_kernels`: those that fits of the usual rigs need, so that no fit has to wait for the compiler."""

from __future__ import annotations

import numpy as np

from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents
from estimator.model import Mechanism, biped3, joint1, leg2
from estimator.numerics import eliminate
from estimator.parallel import cores, parallel_map
from estimator.signals import IMU_COLUMNS, SignalSet

COUNT = 60
"""Samples of the record that is made up for each."""


def usual() -> list[Mechanism]:
    """One for each number of joints and width of the equations: the second leg's is that of a leg with effects."""
    return [leg2(lever_arm=0.2), leg2(lever_arm=0.2, rotor_inertia=(0, 1), torque_offset=(0, 1)), biped3(),
            joint1(lever_arm=0.1), joint1(lever_arm=0.1, torque_offset=(0,))]


def compile_kernels(workers: int | None = None) -> None:
    """Compile those that Numba's cache does not have yet, by default on all cores."""
    mechanisms = usual()
    each = [*((m, False) for m in mechanisms), *((m, True) for m in (mechanisms[0], mechanisms[3]))]
    parallel_map(lambda i: _use(*each[i]), len(each), cores() if workers is None else workers)


def _use(mechanism: Mechanism, disturbed: bool) -> None:
    """One step of a fit at any point, and of a search for the motion alone."""
    rng = np.random.default_rng(0)
    shape = (COUNT, mechanism.n)
    imu = {name: rng.normal(size=COUNT) for name in IMU_COLUMNS} if mechanism.lever_arm else {}
    signals = SignalSet("made up", 100.0, np.arange(COUNT) / 100.0, rng.normal(size=shape), rng.normal(size=shape), imu)
    problem = LatentProblem([signals], mechanism, "linear")
    problem = problem.with_disturbance() if disturbed else problem
    beta = np.array([3.0 if p.term == "inertia" and p.at[0] == p.at[1] else 0.1 for p in mechanism.parameters])
    ones = np.ones(mechanism.n)
    x = Latents(*rng.normal(size=(3 + disturbed, *shape)))
    noise = Noise(ones, ones, np.ones(problem.imu_count), np.ones((problem.imu_count, 2)), disturbance=ones,
                  time_constant=ones)
    eliminate(problem.motion_equations(x, beta, noise).chain).product()
    solved = eliminate(problem.linearise(x, beta, noise).chain)
    solved.solution(np.zeros(1 + mechanism.p))
    solved.inverse_diagonal()
