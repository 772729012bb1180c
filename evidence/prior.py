"""`make prior`: do intervals hold where two of nine parameters are known from elsewhere, on legs that swing little?

Legs of MuJoCo, one record each, torque so small that the links swing by some tenths of a radian. Of beta4 and beta5 the
fit is given a value drawn about the truth, with its standard deviation; counted are the other seven. Called again it
goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np

from estimator import FitError, FitOptions, fit
from estimator.model import leg2
from evidence.kept import kept
from evidence.page_file import write_page
from evidence.registry import Evidence, shares
from studies import machine
from tests.support.mujoco_leg import random_leg, record

KNOWN, ACCURACY = ("beta4", "beta5"), 0.02
SECONDS, TORQUE_NM, HIGH_HZ = 10.0, 0.3, 2.0


@kept
def one(seed: int) -> tuple[list[bool], list[bool], list[float], float] | None:
    """Whether the intervals of the other parameters hold without and with the prior, their widths with it as a share of
    those without, and the larger swing [rad]; None where a fit is none."""
    rng = np.random.default_rng([41, seed])
    leg = random_leg(rng)
    run = record(leg, rng, seconds=SECONDS, amplitude=TORQUE_NM, high=HIGH_HZ)
    mechanism, truth = leg2(lever_arm=leg.lever), leg.beta()
    prior = {}
    for name in KNOWN:
        true = float(truth[mechanism.column(name)])
        prior[name] = true * (1.0 + ACCURACY * float(rng.normal())), ACCURACY * true
    try:
        alone, known = (fit([run], mechanism, FitOptions(sensors="imu", hold="auto", smoothing_velocity="auto",
                                                          prior=p))
                        for p in ({}, prior))
    except FitError:
        return None
    if not alone.converged or not known.converged:
        return None
    others = [k for k, name in enumerate(mechanism.names) if name not in KNOWN]
    holds = [[bool(abs(f.beta[k] - truth[k]) < f.half_width[k]) for k in others] for f in (alone, known)]
    swing = max(float(np.ptp(run[c])) for c in ("q1_rad", "q2_rad"))
    return holds[0], holds[1], [float(known.half_width[k] / alone.half_width[k]) for k in others], swing


def page(fits: int) -> Iterator[str]:
    """The page, line by line."""
    found = [row for seed in range(fits) if (row := one(seed)) is not None]
    without, with_prior, widths = (np.array([row[k] for row in found], dtype=float) for k in range(3))
    chance = 100 * np.sqrt(0.95 * 0.05 / len(found))
    yield from [
        "# Known values in a fit", "",
        f"Made by `make prior FITS={fits}`, seeds 0 to {fits - 1}, {datetime.now(UTC):%Y-%m-%d}, {machine()}.", "",
        f"Emulated legs, one record of {SECONDS:g} s each under at most {TORQUE_NM:g} N m. The links swing by "
        f"{np.median([row[3] for row in found]):.2f} rad (median).",
        f"The table `[prior]` gives beta4 and beta5 to {100 * ACCURACY:g} % (1 sigma), drawn about the truth.",
        "Counted are the 95 % intervals of the other seven parameters.",
        f"By chance a share of one parameter scatters by {chance:.1f} % (1 sigma); the seven are correlated.", "",
        "Target: 93 to 97 % of these intervals hold, all seven together.",
        f"{len(found)} of {fits} fits converged.", "",
        "| parameter | coverage without prior | coverage with prior | width with prior |", "|---|---|---|---|"]
    names = [name for name in leg2().names if name not in KNOWN]
    for k, name in enumerate(names):
        yield (f"| {name} | {100 * without[:, k].mean():.1f} % | {100 * with_prior[:, k].mean():.1f} % | "
               f"{100 * np.median(widths[:, k]):.0f} % |")
    yield (f"| all seven | {100 * without.mean():.1f} % | {100 * with_prior.mean():.1f} % | "
           f"{100 * np.median(widths):.0f} % |")
    yield ""


EVIDENCE = (
    Evidence("Two known values of nine: coverage of the other seven on legs that swing little", "make prior FITS=60",
             "prior.md", 3, "93 to 97 % of all",
             shares(r"\| all seven \| [\d.]+ % \| ([\d.]+) % \|", "% of the intervals hold")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, fits=(60, "records"))
