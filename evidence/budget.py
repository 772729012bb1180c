"""Is the budget of a fit right? One leg, its readings wrong by faults that are drawn from their tolerances.

One MuJoCo run without noise; each draw changes its readings by faults of the sensors and adds noise, and is fitted as
`legid fit` does with these tolerances alone. The errors over all draws are held against the budget.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from typing import NamedTuple

import numpy as np

from daq import Dataset
from estimator import FitOptions, FitResult, fit
from estimator.model import leg2
from estimator.score import ONLY, default_tolerances
from evidence.kept import kept
from evidence.lab_legs import drawn, plant_of
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from studies import machine
from tests.support.mujoco_leg import Leg, record

SEED, SECONDS = 7300, 5.0
FAULTS = ("torque_gain", "torque_offset", "gyro_scale", "gyro_bias", "accelerometer_bias", "imu_misalignment",
          "imu_lever_arm", "encoder_offset", "encoder_scale", "encoder_eccentricity")
NOISE = {"gyro_radps": 0.005, "accel_x_mps2": 0.05, "accel_y_mps2": 0.05, "tau2_nm": 0.02, "q2_rad": 3e-4}
SHOWN = 5
"""Sources of a row of the budget."""


class Draw(NamedTuple):
    """One fit of five rigid parameters."""

    error: np.ndarray
    """(5,) over the true value"""
    std: np.ndarray
    """(5,) likewise"""
    plain: np.ndarray
    """(5,) whether the interval without a budget holds the truth"""


@cache
def clean() -> tuple[Leg, Dataset]:
    """The leg, and its run without noise."""
    leg = Leg()
    return leg, record(leg, np.random.default_rng(SEED), seconds=SECONDS, gyro=0.0, accel=0.0, torque=0.0,
                       counts=2**24)


def fitted(number: int, tolerances: bool = True) -> FitResult:
    """The fit of a draw; number 0 has no fault."""
    leg, run = clean()
    rng = np.random.default_rng([SEED, number])
    columns = {"time_s": run.time_s, **{name: np.array(run[name]) for name in NOISE}}
    faults = drawn(rng, float(number > 0))
    plant_of({name: sizes if name in FAULTS else 0.0 * sizes for name, sizes in faults.items()}, rng).logged(columns)
    seen = {name: columns[name] + sigma * rng.normal(size=len(run)) for name, sigma in NOISE.items()}
    stated = {name: sizes for name, sizes in default_tolerances().items() if name in FAULTS}
    options = FitOptions(tolerances={ONLY: (), **stated} if tolerances else None)
    return fit([replace(run, columns={**run.columns, **seen})], leg2(lever_arm=leg.lever), options)


@kept
def draw(number: int) -> Draw:
    """Errors of one draw."""
    truth = clean()[0].beta()[:5]
    found, plain = fitted(number), fitted(number, False)
    low, high = plain.ci95()[:5].T
    return Draw(found.beta[:5] / truth - 1.0, found.std[:5] / truth, (low <= truth) & (truth <= high))


def page(draws: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    found = [draw(number) for number in within(minutes, range(1, draws + 1))]
    error, std = (np.array([getattr(one, name) for one in found]) for name in ("error", "std"))
    held, plain = np.abs(error) < 1.96 * std, np.array([one.plain for one in found])
    budget, truth = fitted(0).budget, clean()[0].beta()[:5]
    assert budget is not None
    parts = sorted(budget.parts, key=lambda part: -float(np.mean(part.std[:5] / truth)))
    yield from [
        "# Is the budget of a fit right?", "",
        f"Made by `python -m evidence budget` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, {machine()}.", "",
        f"One leg in MuJoCo, one run of {SECONDS:g} s, fitted {len(found)} times. Each time its readings have other "
        f"faults, drawn from the default tolerances of {', '.join(FAULTS)}, and other noise. The budget knows these "
        "tolerances alone.", "",
        "| | beta1 | beta2 | beta3 | beta4 | beta5 |", "| --- | ---: | ---: | ---: | ---: | ---: |",
        *(_row(f"budget: {part.source}, 1 sigma", part.std[:5] / truth) for part in parts[:SHOWN]),
        _row("budget: all, 1 sigma", np.median(std, axis=0)),
        _row("rms error of the draws", np.sqrt(np.mean(error**2, axis=0))),
        _row("within 95 % intervals", np.mean(held, axis=0)),
        _row("within, without a budget", np.mean(plain, axis=0)), "",
        f"In all {100 * np.mean(held):.1f} % of the parameters lie within, {100 * np.mean(plain):.1f} % without a "
        "budget.", ""]


def _row(name: str, shares: np.ndarray) -> str:
    return f"| {name} | {' | '.join(f'{100 * share:.2f} %' for share in shares)} |"


EVIDENCE = (
    Evidence("Is the budget of a fit what its errors are?", "python -m evidence budget", "budget.md", 6,
             "95 % within", (r"In all .*",)),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, draws=(500, "of the faults"), minutes=(30.0, "after which no other is begun"))
