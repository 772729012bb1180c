"""`make seven-links`: Fig. 1's chain of seven links, fitted from a noisy absolute angle; do its intervals hold?

The plant is MuJoCo's. The first joint is a passive pivot whose absolute angle is measured with noise, as by a distance
meter or a tilt; the six others are driven and have encoders. 49 parameters a chain: 28 of the inertia matrix, 7 first
moments, 7 viscous and 7 Coulomb levels.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import combinations_with_replacement
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from daq import Dataset, FloatArray
from estimator import FitError, FitOptions, FitResult, fit
from estimator.model import Mechanism, chain
from evidence.kept import kept
from evidence.registry import Evidence
from studies import machine
from tests.support.mujoco_leg import GRAVITY, multisine

LINKS, SECONDS, RATE_HZ, SUB = 7, 5.0, 250.0, 8
ABSOLUTE_RAD, ENCODER_RAD, TORQUE_NM = 1e-3, 1e-4, 0.02
SHARE = 0.35
"""Peak of a joint's torque over what would hold the links beyond it out level."""
FRICTION_RADPS = 0.05
"""Speed over which dry friction turns, of the plant and declared to the fit: what is asked is whether the intervals of
a right model hold, and dry friction between samples has a page of its own."""


class Chain(NamedTuple):
    """Masses and lengths of the links, base first [SI]."""

    mass: FloatArray
    length: FloatArray
    centre: FloatArray
    inertia: FloatArray
    """About each link's centre."""
    viscous: FloatArray
    coulomb: FloatArray

    def beta(self, mechanism: Mechanism) -> FloatArray:
        """Entries of the inertia matrix in absolute angles, first moments, friction, by hand from the bodies."""
        beyond = np.append(np.cumsum(self.mass[::-1])[::-1][1:], 0.0)  # mass carried by each link's end
        moment = self.mass * self.centre + beyond * self.length
        own = self.inertia + self.mass * self.centre**2 + beyond * self.length**2
        pairs = [(i, i) for i in range(LINKS)] + [(i, j) for i in range(LINKS) for j in range(i + 1, LINKS)]
        rigid = [own[i] if i == j else self.length[i] * moment[j] for i, j in pairs]
        beta = np.concatenate([rigid, moment, self.viscous, self.coulomb])
        assert beta.size == mechanism.p and len(list(combinations_with_replacement(range(LINKS), 2))) == len(pairs)
        return beta

    def model(self) -> mujoco.MjModel:
        """MuJoCo's chain, hanging."""
        text, end = "", ""
        for k in range(LINKS):
            at = 0.0 if k == 0 else -self.length[k - 1]
            text += (f'<body pos="0 0 {at}"><joint type="hinge" axis="0 -1 0" damping="{self.viscous[k]}"/>'
                     f'<inertial pos="0 0 {-self.centre[k]}" mass="{self.mass[k]}" diaginertia="'
                     f'{self.inertia[k]} {self.inertia[k]} {self.inertia[k]}"/>')
            end += "</body>"
        step = 1.0 / RATE_HZ / SUB
        return mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{step}" gravity="0 0 -{GRAVITY}" integrator="RK4"/><worldbody>{text}{end}'
            "</worldbody></mujoco>")


def random_chain(rng: np.random.Generator) -> Chain:
    """Links of a walker's size, each of its own."""
    length = 0.3 * rng.uniform(0.8, 1.25, LINKS)
    mass = 1.0 * rng.uniform(0.7, 1.4, LINKS)
    return Chain(mass, length, 0.5 * length * rng.uniform(0.8, 1.2, LINKS), mass * length**2 / 10.0,
                 0.3 * rng.uniform(0.8, 1.25, LINKS), 0.1 * rng.uniform(0.5, 1.5, LINKS))


def record(body: Chain, rng: np.random.Generator) -> Dataset:
    """One run: torques linear between samples, noise on every reading."""
    model = body.model()
    data = mujoco.MjData(model)
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    peak = SHARE * GRAVITY * 0.15 * (LINKS - np.arange(LINKS)) ** 2
    tau = np.column_stack([multisine(rng, time, peak[k], high=2.5) if k else 0.0 * time for k in range(LINKS)])
    after, q = np.vstack([tau[1:], tau[-1:]]), np.empty((time.size, LINKS))
    for k in range(time.size):
        q[k] = data.qpos
        for i in range(SUB):
            data.qfrc_applied[:] = tau[k] + (after[k] - tau[k]) * (i + 0.5) / SUB
            data.qfrc_applied[:] -= body.coulomb * data.qvel / np.hypot(data.qvel, FRICTION_RADPS)
            mujoco.mj_step(model, data)
    columns = {f"q{j + 1}_rad": q[:, j] + (ENCODER_RAD if j else ABSOLUTE_RAD) * rng.normal(size=time.size)
               for j in range(LINKS)}
    columns |= {f"tau{j + 1}_nm": tau[:, j] + TORQUE_NM * rng.normal(size=time.size) for j in range(1, LINKS)}
    return Dataset("chain", RATE_HZ, time, columns)


@kept
def fit_chain(seed: int) -> tuple[FitResult, FloatArray]:
    """(fit, true beta) of one chain. Raises `FitError`."""
    rng = np.random.default_rng(seed)
    body = random_chain(rng)
    mechanism = chain(LINKS, velocity_scale=FRICTION_RADPS)
    options = FitOptions(sensors="encoder", noise={"encoder1_rad": ABSOLUTE_RAD})
    return fit([record(body, rng)], mechanism, options), body.beta(mechanism)


def page(seeds: range) -> str:
    """The study as Markdown."""
    scores, errors, failed = [], [], 0
    for seed in seeds:
        try:
            found, truth = fit_chain(seed)
        except FitError as error:
            print(seed, error, flush=True)
            failed += 1
            continue
        if not found.converged:
            failed += 1
            continue
        scores.append((found.beta - truth) / found.std)
        errors.append(np.abs(found.beta[:35] / truth[:35] - 1.0))
        print(f"{seed}: {np.mean(np.abs(scores[-1]) < 1.96):.3f} inside, {np.median(errors[-1]):.2e}, "
              f"{found.iterations} steps, {found.wall_s:.1f} s", flush=True)
    z = np.array(scores)
    share = 100.0 * np.mean(np.abs(z) < 1.96)
    groups = {"inertia matrix (28)": slice(0, 28), "first moments (7)": slice(28, 35), "viscous friction (7)":
              slice(35, 42), "Coulomb friction (7)": slice(42, 49)}
    rows = [f"| {name} | {100.0 * np.mean(np.abs(z[:, part]) < 1.96):.1f} % | {np.mean(z[:, part]):+.2f} "
            f"| {np.sqrt(np.mean(z[:, part] ** 2)):.2f} |" for name, part in groups.items()]
    chance = 100.0 * np.std(np.mean(np.abs(z) < 1.96, axis=1)) / np.sqrt(len(z))
    return "\n".join([
        "# Seven links from an absolute angle", "",
        f"Made by `make seven-links FITS={len(seeds)}`, seeds {seeds.start} to {seeds.stop - 1}, "
        f"{datetime.now(UTC):%Y-%m-%d}, {machine()}.", "",
        f"The chain of Fig. 1 with {LINKS} links and 49 parameters, simulated by MuJoCo: one run of {SECONDS:g} s at "
        f"{RATE_HZ:g} Hz a fit. The passive pivot's absolute angle has noise of {ABSOLUTE_RAD:g} rad. Six driven "
        f"joints have encoders ({ENCODER_RAD:g} rad) and torques ({TORQUE_NM:g} N m). All levels but the "
        "absolute angle's are estimated.", "",
        f"{len(z)} of {len(seeds)} fits converged. {share:.1f} % of the 95 % intervals hold the truth (by chance "
        f"+- {chance:.1f}, 1 sigma over chains). Inertias and first moments are off by "
        f"{100.0 * np.median(errors):.2g} % in the median.", "",
        "| parameters | coverage | mean of error / deviation | rms |", "| --- | ---: | ---: | ---: |", *rows, ""])


EVIDENCE = (
    Evidence("Seven links from the absolute angle of the first: do the intervals hold?", "make seven-links FITS=16",
             "seven-links.md", 2, "every fit converges, 95 % of the intervals hold",
             (r"\d+ of \d+ fits converged", r"\S+ % of the 95 % intervals hold the truth")),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=50)
    parser.add_argument("--seed", type=int, default=3000)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    given.out.write_text(page(range(given.seed, given.seed + given.fits)), encoding="utf-8")
