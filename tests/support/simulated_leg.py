"""A leg with one effect as our own simulation moves it, as the record of that run, and the likelihood of the record."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray, Loop
from estimator import Effect
from estimator.effects import GearEffect
from estimator.likelihood import Candidate, LatentProblem, Latents, Noise, Stage, State, free_run
from estimator.model import leg2
from estimator.signals import Commands, SignalSet, encoder_of, imu_channels, imu_columns, torque_of

MECHANISM = leg2(lever_arm=0.2)
FOLLOWER = replace(MECHANISM, followers=(1,))
"""The same, its knee behind a position loop."""
BETA = np.array([0.14, 0.03, 0.05, 0.5, 0.15, 0.02, 0.03, 0.02, 0.03])
COUNT = 300
TIME_S = np.arange(COUNT) / 100.0
NOISE = Noise(np.full(2, 0.02), np.array([np.inf, 2e-4]), np.array([0.005]), np.full((1, 2), 0.05))
STAGE = Stage((0,), (5.0,), (0.0,), np.array([[-0.5, 0.5], [-1.0, 1.0]]), 3.0)
FRICTION = [6, 8]
"""Of the knee, in BETA."""
LOOP = Loop(gain=8.0, damping=0.1, feedforward=0.5, limit=2.0, delay_s=0.004, period_s=0.01, supply=7.4,
            per_volt=0.15, braking=0.02)
"""Of the knee, for effects of a position loop."""


@dataclass(frozen=True)
class SimulatedLeg:
    """A run of 3 s without noise."""

    effect: Effect
    beta: FloatArray
    """BETA, then the effect's size."""
    signals: SignalSet
    motion: Latents
    """Where the record's likelihood has it: the torque behind a gear is what comes through it."""
    torque: FloatArray
    """(N, n) of the motors"""
    hold: str = "linear"

    @property
    def size(self) -> FloatArray:
        return self.beta[BETA.size :]

    def problem(self, effects: Sequence[Effect] | None = None, candidates: Sequence[Candidate] = ()) -> LatentProblem:
        """Likelihood of the record, by default with the effect."""
        own = [self.effect] if effects is None else effects
        return LatentProblem([self.signals], MECHANISM, self.hold, STAGE, own, candidates)


def commands_to(angle: FloatArray) -> Commands:
    """The knee follows `angle` (N,)."""
    both = np.column_stack([np.zeros(COUNT), angle])
    return Commands((None, LOOP), both, np.gradient(both, TIME_S, axis=0), np.full((COUNT, 2), LOOP.supply))


def simulate_leg(effect: Effect, size: FloatArray, link_friction: bool = False) -> SimulatedLeg:
    """The knee is driven by two sines. The motor of a geared knee has all friction of the joint, or else the link."""
    beta = np.append(BETA, size)
    if isinstance(effect, GearEffect):
        beta[FRICTION] = BETA[FRICTION] if link_friction else 0.0
        effect.motor(beta[BETA.size :])[:2] = 0.0 if link_friction else BETA[FRICTION]
    tau = 0.5 * np.sin(2.0 * np.pi * 0.6 * TIME_S) + 0.3 * np.sin(2.0 * np.pi * 1.4 * TIME_S + 1.0)
    torque, still = np.column_stack([np.zeros(COUNT), tau]), np.zeros((COUNT, 2))
    commands = commands_to(tau) if effect.per_loop else None
    signals = SignalSet("r", 100.0, TIME_S, still, torque, {c: np.zeros(COUNT) for c in imu_columns(0)},
                        commands=commands)
    blank = LatentProblem([signals], MECHANISM, "linear", STAGE, [effect])
    run = free_run(blank, State(Latents(still, still, torque), beta, NOISE, np.eye(beta.size)), torque)
    assert run is not None and np.abs(run.q).max() > 0.5
    read = run.readings
    angles = np.column_stack([np.full(COUNT, np.nan), read[encoder_of(1)]])
    shown = np.column_stack([read[torque_of(j)] for j in range(2)])
    signals = SignalSet("r", 100.0, TIME_S, angles, shown, dict(zip(imu_columns(0), (read[c] for c in imu_channels(0)))
                                                                ), commands=commands)
    torque = shown if commands is not None else torque  # what the stated law gives
    found = SimulatedLeg(effect, beta, signals, Latents(run.q, run.v, torque), torque,
                         "linear" if commands is None else "smooth")
    lost = found.problem().motor_torque(found.motion, beta) - torque
    return replace(found, motion=Latents(run.q, run.v, torque - lost))
