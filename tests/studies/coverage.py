"""Do the 95 % intervals hold? Fits of an independent leg with dry friction, beside the parameters that made it.

`make coverage` writes the page. The plant is `tests.support.stick_slip_leg`: set-valued friction, reversals and rest
located by root finding, the motor driven at 1 kHz. Nothing in its rig says how the torque acts between samples.
"""

from __future__ import annotations

import argparse
import platform
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Dataset
from estimator import FitError, FitOptions, fit
from estimator.model import leg2
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.stick_slip_leg import PEAK_NM, move, sample

FRICTION = (0.02, 0.05, 0.10)
RATES = (50, 100, 250, 500)
PIVOT_NM = 0.01
"""Least Coulomb level of the pivot."""


def case(seed: int, friction: float, closed: bool, rate_hz: float, runs: int) -> tuple[Leg, list[Dataset]]:
    """A leg of which the knee's Coulomb level is this share of the peak torque, and its recorded runs."""
    rng = np.random.default_rng(seed)
    leg = replace(random_leg(rng), coulomb=(PIVOT_NM + 0.1 * friction * PEAK_NM, friction * PEAK_NM))
    return leg, [sample(move(leg, rng, closed=closed), rng, rate_hz, name=f"run{i}") for i in range(runs)]


def scores(seeds: range, friction: float, closed: bool, rate_hz: float, sensors: str, method: str,
           runs: int = 1) -> np.ndarray:
    """(fits, 9) error of each parameter over its standard deviation; rows of fits that fail are missing."""
    found = []
    for seed in seeds:
        leg, data = case(seed, friction, closed, rate_hz, runs)
        try:
            result = fit(data, leg2(lever_arm=leg.lever), FitOptions(sensors=sensors, hold="auto"), method)
        except FitError:
            continue
        if result.converged:
            found.append((result.beta - leg.beta()) / result.std)
    return np.array(found)


def rows(seeds: range, rates: tuple[int, ...]) -> Iterator[str]:
    for closed in (False, True):
        for friction in FRICTION:
            for rate in rates:
                for method, sensors in (("mle", "imu"), ("mle", "encoder"), ("wls", "imu")):
                    z = scores(seeds, friction, closed, rate, sensors, method)
                    drive = "position" if closed else "torque"
                    head = f"| {drive} | {100 * friction:g} % | {rate} | {method}-{sensors} | {len(z)}/{len(seeds)}"
                    if not len(z):
                        yield f"{head} | | | |"
                        continue
                    mean, rms = z.mean(axis=0), np.sqrt(np.mean(z**2, axis=0))
                    yield (f"{head} | {100 * np.mean(np.abs(z) < 1.96):.0f} % | {' '.join(f'{m:+.1f}' for m in mean)} "
                           f"| {' '.join(f'{r:.1f}' for r in rms)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--rates", type=int, nargs="+", default=list(RATES))
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.fits)
    text = [
        "# Do the intervals hold?", "",
        f"Made by `make coverage FITS={given.fits}`, seeds {seeds.start} to {seeds.stop - 1}, on "
        f"{platform.machine()} with Python {platform.python_version()}.", "",
        "Plant: a leg with set-valued dry friction, reversals and rest by root finding, driven at 1 kHz: an open-loop",
        "multisine of torque, or a position controller; runs of 20 s. `hold` is auto. Coverage of the 95 % intervals",
        "over all parameters, then mean and rms of error over standard deviation for beta1 to beta9. A row of few is",
        f"uncertain: a mean by {1 / np.sqrt(len(seeds)):.2f}, an rms by {1 / np.sqrt(2 * len(seeds)):.2f}.", "",
        "| drive | friction | rate [Hz] | method | fits | coverage | mean | rms |", "|---|---|---|---|---|---|---|---|"]
    for row in rows(seeds, tuple(given.rates)):
        text.append(row)
        given.out.write_text("\n".join([*text, ""]))
        print(row, flush=True)


if __name__ == "__main__":
    main()
