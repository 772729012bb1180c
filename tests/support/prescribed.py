"""Records of arms whose motion is given, and whose torque is what their equation of motion asks for: exact, cheap."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Dataset
from daq.runs import write_csv
from estimator.model import joint1, leg2

BETA = np.array([0.1, 0.02, 0.03, 0.4, 0.1, 0.02, 0.03, 0.05, 0.04])
ARM_RIG = '[mechanism]\nmodel = "leg2"\nactuated = [1, 2]\n'
SWING_RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


def _motion(rng: np.random.Generator, time: np.ndarray, joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums of sines, (n, joints) each: angle, rate, acceleration."""
    w = rng.uniform(0.7, 9.0, (5, joints))
    a, p = rng.uniform(0.1, 0.9, (5, joints)) / w, rng.uniform(0.0, 2.0 * np.pi, (5, joints))
    phase = time[:, None, None] * w + p
    return tuple(np.sum(x, axis=1) for x in (a * np.sin(phase), a * w * np.cos(phase),
                                             -a * w**2 * np.sin(phase)))


def arm_run(seed: int, *, seconds: float = 10.0, offset: Sequence[float] = (0.0, 0.0), rotor: float = 0.0,
            zero: Sequence[float] = (0.0, 0.0), beta: np.ndarray = BETA, torque: float = 0.02, encoder: float = 1e-4,
            knee: float = 1.0) -> Dataset:
    """A two-link arm with motors at both joints; `knee` is how far joint 2 moves, as a share of what it does else."""
    rng, time = np.random.default_rng(seed), np.arange(int(seconds * 100.0)) / 100.0
    model = leg2(actuated=(0, 1), rotor_inertia=(1,), torque_offset=(0, 1))
    q, v, a = (x * [1.0, knee] for x in _motion(rng, time, 2))
    tau = model.inverse_dynamics(q, v, a, np.concatenate([beta, [rotor], offset])) + torque * rng.normal(size=q.shape)
    read = q + np.asarray(zero) + encoder * rng.normal(size=q.shape)
    return Dataset(f"run{seed}.csv", 100.0, time, {"q1_rad": read[:, 0], "q2_rad": read[:, 1], "tau1_nm": tau[:, 0],
                                                     "tau2_nm": tau[:, 1]})


def swing_run(viscous: float, coulomb: float = 0.0, seed: int = 3, seconds: float = 20.0, encoder: float = 1e-5
              ) -> Dataset:
    """One driven joint with inertia 0.1 kg m^2 and gravity moment 0.3 kg m."""
    rng, time = np.random.default_rng(seed), np.arange(int(100 * seconds)) / 100.0
    q, v, a = _motion(rng, time, 1)
    tau = joint1().inverse_dynamics(q, v, a, np.array([0.1, 0.3, viscous, coulomb]))
    return Dataset("swing.csv", 100.0, time, {"q1_rad": q[:, 0] + encoder * rng.normal(size=time.size),
                                              "tau1_nm": tau[:, 0] + 0.02 * rng.normal(size=time.size)})


def negated(run: Dataset, *columns: str) -> Dataset:
    """`run` with these columns of the other sign."""
    return replace(run, columns={**run.columns, **{c: -run[c] for c in columns}})


def written(runs: Sequence[Dataset], folder: Path) -> list[str]:
    """The runs as CSV files of their names."""
    for run in runs:
        write_csv(run, folder / run.name)
    return [str(folder / run.name) for run in runs]
