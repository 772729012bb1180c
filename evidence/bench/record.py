"""The one record of a leg that all peers get, and the problem that the default estimator makes of it."""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from daq import Dataset
from estimator import FitOptions
from estimator.fitting import free_mask, iterate, noise_floors, start_state
from estimator.likelihood import LatentProblem, State
from estimator.model import Mechanism, leg2
from estimator.signals import split_signals

RATE_HZ = 100.0
SEED = 506
OPTIONS = FitOptions(sensors="imu")


class Watch:
    """Seconds since it was made: on the clock, or of the processor where those are fewer.

    Processor seconds leave out what other work on the machine takes; a peer that works on several cores at once has
    more of them than the clock shows.
    """

    def __init__(self) -> None:
        self.clock, self.processor = time.perf_counter(), time.process_time()

    def seconds(self) -> float:
        return min(time.perf_counter() - self.clock, time.process_time() - self.processor)


def write_record(path: Path, samples: int) -> None:
    """Let MuJoCo move a leg with IMU, knee encoder and torque sensor; shorter records are its beginning."""
    from tests.support.mujoco_leg import random_leg, record

    rng = np.random.default_rng(SEED)
    leg = random_leg(rng)
    data = record(leg, rng, seconds=samples / RATE_HZ, rate_hz=RATE_HZ)
    arrays: dict[str, Any] = {"time_s": data.time_s, "lever": leg.lever, "truth": leg.beta(),
                              "masses": [leg.m1, leg.m2], "length": leg.l1, **data.columns}
    np.savez(path, **arrays)


class Recorded(NamedTuple):
    """The first samples of the record, and the leg behind it."""

    data: Dataset
    mechanism: Mechanism
    truth: np.ndarray
    """(9,) beta of the leg"""
    masses: tuple[float, float]
    """of both links [kg], as a balance would show them"""
    length: float
    """of the upper link [m], as a ruler would show it"""


def read_record(path: Path, samples: int) -> Recorded:
    with np.load(path) as file:
        names = [n for n in file.files if n.endswith(("_rad", "_nm", "_radps", "_mps2"))]
        columns = {n: np.ascontiguousarray(file[n][:samples]) for n in names}
        return Recorded(Dataset("bench", RATE_HZ, file["time_s"][:samples], columns),
                        leg2(lever_arm=float(file["lever"])), file["truth"],
                        (float(file["masses"][0]), float(file["masses"][1])), float(file["length"]))


class Posed(NamedTuple):
    """The likelihood's problem, where a search begins, and the noise levels at its end."""

    problem: LatentProblem
    start: State
    end: State


def pose(recorded: Recorded) -> Posed:
    """What the default estimator solves, solved once."""
    mechanism = recorded.mechanism
    signals = split_signals([recorded.data], mechanism, OPTIONS)
    problem = LatentProblem(signals, mechanism, OPTIONS.hold)
    free, beta = free_mask(mechanism, OPTIONS)
    start = start_state(problem, signals, mechanism, OPTIONS, free, beta)
    end = iterate(problem, start, free, OPTIONS, noise_floors(problem, mechanism, start.beta))
    return Posed(problem, start, end)
