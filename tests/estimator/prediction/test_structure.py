"""What repeats from run to run is structure; what does not is a disturbance."""

import numpy as np
from numpy.random import Generator, default_rng

from daq import FloatArray
from estimator.prediction import driven_columns, repeated_share, state_columns
from tests.support.ornstein_uhlenbeck import draw

RUNS, SAMPLES = 6, 1000


def motion(rng: Generator) -> tuple[FloatArray, FloatArray]:
    """(N, 2) angle and rate of six multisines of three tones each."""
    t = np.arange(SAMPLES) * 0.01
    f = np.array([0.3, 0.7, 1.1])[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (RUNS, 3, 1))
    q = np.sin(2.0 * np.pi * f * t + phase).sum(axis=1).ravel()
    v = (2.0 * np.pi * f * np.cos(2.0 * np.pi * f * t + phase)).sum(axis=1).ravel()
    return q, v


def share(residual: FloatArray, q: FloatArray, v: FloatArray, torque: FloatArray | None = None) -> float:
    ends = np.arange(1, RUNS + 1) * SAMPLES
    others = np.zeros((q.size, 0)) if torque is None else torque
    columns = state_columns(q[:, None], v[:, None], others, ends)
    both = repeated_share(np.column_stack([np.zeros_like(residual), residual]), columns,
                          np.repeat(np.arange(RUNS), SAMPLES))
    assert both[0] == 0.0
    return float(both[1])


def test_functions_of_the_state_repeat() -> None:
    rng = default_rng(1)
    q, v = motion(rng)
    noise = 0.1 * rng.normal(size=q.size)
    assert share(0.5 * q**3 + noise, q, v) > 0.95
    assert share(np.sign(v) * (1.0 + np.sin(3.0 * q)) + noise, q, v) > 0.85
    assert share(q * v + noise, q, v) > 0.95


def test_hysteresis_repeats() -> None:
    """A spring of play: its force depends on the way since the last turn, not on angle and rate."""
    rng = default_rng(2)
    q, v = motion(rng)
    force, now = np.empty_like(q), 0.0
    for k, step in enumerate(np.diff(q, prepend=q[0])):
        now = float(np.clip(now + (0.0 if k % SAMPLES == 0 else step), -0.3, 0.3))
        force[k] = now
    assert share(force, q, v) > 0.9


def test_a_disturbance_does_not_repeat() -> None:
    rng = default_rng(3)
    q, v = motion(rng)
    for time_constant_s in (0.05, 0.3, 2.0):
        wandering = np.concatenate([draw(rng, SAMPLES, 1.0, time_constant_s, 0.01) for _ in range(RUNS)])
        assert share(wandering, q, v) < 0.1
    of_one_run = np.repeat(np.tile([-1.0, 1.0], RUNS // 2), SAMPLES) * q
    assert share(of_one_run, q, v) < 0.3


def test_nothing_has_no_structure() -> None:
    q, v = motion(default_rng(4))
    assert share(np.zeros_like(q), q, v) == 0.0


def test_what_a_late_torque_leaves_repeats() -> None:
    """3 ms of a torque that does not follow from the state: of another multisine in each run."""
    rng = default_rng(4)
    q, v = motion(rng)
    torque, rate = motion(rng)
    left, ends = 0.003 * rate + 0.002 * rng.normal(size=q.size), np.arange(1, RUNS + 1) * SAMPLES
    measured = torque[:, None] + 0.01 * rng.normal(size=(q.size, 1))
    assert share(left, q, v, measured) < 0.3 < 0.8 < share(left, q, v, driven_columns(measured, ends))
    wandering = np.concatenate([draw(rng, SAMPLES, 1.0, 0.07, 0.01) for _ in range(RUNS)])
    assert share(wandering, q, v, driven_columns(measured, ends)) < 0.1
