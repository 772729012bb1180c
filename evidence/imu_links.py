"""`make imu-links`: legs, a walker and chains fitted from IMUs on any links and a few encoders; do intervals hold?

The plants are MuJoCo's, dynamics and sensors. All noise levels are estimated, no angle is known beforehand, and the
torque acts in straight lines between samples.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng

from daq import Dataset, FloatArray
from estimator import FitError, FitOptions, fit
from estimator.model import ImuPlace, Mechanism, biped3, chain, leg2
from evidence.frame import Lines, program, table, tell
from evidence.kept import kept
from evidence.registry import Evidence, shares
from tests.support.mujoco_leg import GRAVITY
from tests.support.mujoco_tree import FRICTION_RADPS, Motion, Noise, Sensor, Tree, disturbed, move, random_tree, torques

WALKER_HZ, STEPS, STEP_S = 500.0, 8, 0.7
WALKER_NOISE = Noise(torque=0.1)
"""Its motors give a hundred times the torque of the others'."""


class Rig(NamedTuple):
    """A plant drawn at random, and a record of it."""

    tree: Tree
    mechanism: Mechanism
    runs: list[Dataset]


Draw = Callable[[Generator, list[Sensor]], Rig]


class Row(NamedTuple):
    """One line of the table."""

    title: str
    draw: Draw
    sensors: list[Sensor]
    encoders: tuple[int, ...]
    """0-based joints"""


def placed(mechanism: Mechanism, sensors: list[Sensor], tree: Tree) -> Mechanism:
    """The mechanism with these IMUs, link lengths as declared in a rig file."""
    return mechanism.with_imus(tuple(ImuPlace(*sensor) for sensor in sensors), tuple(tree.length.tolist()))


def hanging(links: int, seconds: float, rate_hz: float, share: float, viscous: float, coulomb: float) -> Draw:
    """A chain (a leg, of two links) that hangs from a passive pivot, driven at all other joints."""

    def draw(rng: Generator, sensors: list[Sensor]) -> Rig:
        tree = random_tree(rng, range(-1, links - 1), viscous=viscous, coulomb=coulomb)
        mechanism = leg2(velocity_scale=FRICTION_RADPS) if links == 2 else chain(links, velocity_scale=FRICTION_RADPS)
        driven = range(1, links)
        motion = move(tree, torques(tree, rng, seconds, rate_hz, share, driven), rate_hz, sensors)
        return Rig(tree, placed(mechanism, sensors, tree), [disturbed(motion, driven, rate_hz, rng)])

    return draw


def walker(rng: Generator, sensors: list[Sensor]) -> Rig:
    """Steps of a walker over its passive stance foot: torso held up, swing leg brought forward, multisines on top."""
    tree = random_tree(rng, (-1, 0, 0), length=0.6, mass=5.0, viscous=0.0, coulomb=0.0, upright=True)
    runs = [disturbed(one_step(tree, rng, sensors), (1, 2), WALKER_HZ, rng, WALKER_NOISE, f"step {step + 1}")
            for step in range(STEPS)]
    return Rig(tree, placed(biped3(gravity_mps2=GRAVITY), sensors, tree), runs)


def one_step(tree: Tree, rng: Generator, sensors: list[Sensor]) -> Motion:
    """From behind the foot over it, as long as one step takes."""
    lean, rate, ticks = -0.28 + 0.05 * rng.normal(), 1.6 + 0.2 * rng.normal(), iter(range(10**6))

    def feedback(q: FloatArray, qd: FloatArray) -> FloatArray:
        swing = np.pi - 0.3 + 0.6 * (next(ticks) + 1) / WALKER_HZ / STEP_S  # absolute angle wanted of the swing leg
        return np.array([0.0, -150.0 * (q[0] + q[1]) - 15.0 * (qd[0] + qd[1]),
                         100.0 * (swing - q[0] - q[2]) + 10.0 * (0.6 / STEP_S - qd[0] - qd[2])])

    start = [lean, -lean, np.pi - 0.3 - lean], [rate, -rate, 1.0 - rate]
    return move(tree, torques(tree, rng, STEP_S, WALKER_HZ, 0.25, (1, 2), 4.0), WALKER_HZ, sensors, start, feedback)


LEG = hanging(2, 10.0, 200.0, 0.35, 0.03, 0.04)
THREE = hanging(3, 10.0, 200.0, 0.8, 0.3, 0.1)
SEVEN = hanging(7, 5.0, 250.0, 0.35, 0.3, 0.1)
ROWS = {
    "leg-shank": Row("leg, IMU on the shank, knee encoder", LEG, [Sensor(1, 0.1)], (1,)),
    "leg-two": Row("leg, IMUs on thigh and shank, no encoder", LEG, [Sensor(0, 0.2), Sensor(1, 0.1)], ()),
    "walker-one": Row("walker, IMU on the stance leg, encoders of both other joints", walker, [Sensor(0, 0.3)], (1, 2)),
    "walker-two": Row("walker, IMUs on stance leg and torso, encoder of the swing leg", walker,
                      [Sensor(0, 0.3), Sensor(1, 0.2)], (2,)),
    "three-two": Row("3 links, IMUs on links 1 and 3, encoder of joint 2", THREE, [Sensor(0, 0.1), Sensor(2, 0.1)],
                     (1,)),
    "three-outer": Row("3 links, IMU on link 3, encoders of joints 2 and 3", THREE, [Sensor(2, 0.1)], (1, 2)),
    "seven-three": Row("7 links, IMUs on links 1, 4 and 7, encoders of joints 2, 3, 5 and 6", SEVEN,
                       [Sensor(0, 0.1), Sensor(3, 0.1), Sensor(6, 0.1)], (1, 2, 4, 5)),
    "seven-outer": Row("7 links, IMU on link 4, encoders of joints 2 to 7", SEVEN, [Sensor(3, 0.1)],
                       (1, 2, 3, 4, 5, 6)),
}


class Outcome(NamedTuple):
    """One fit against the truth."""

    score: FloatArray
    """(p,) error over standard deviation"""
    error: FloatArray
    """(p,) relative error"""
    undetermined: tuple[str, ...]
    iterations: int
    wall_s: float


@kept
def fit_row(name: str, seed: int) -> Outcome | str:
    """One rig of a row fitted; a fit that fails says why."""
    row = ROWS[name]
    rig = row.draw(default_rng(seed), row.sensors)
    truth = rig.tree.beta(rig.mechanism)
    try:
        found = fit(rig.runs, rig.mechanism, FitOptions(sensors="imu", encoders=row.encoders))
    except FitError as error:
        return str(error)
    if not found.converged:
        return "not converged"
    return Outcome((found.beta - truth) / found.std, found.beta / truth - 1.0,
                   tuple(map(str, found.undetermined)), found.iterations, found.wall_s)


def line(name: str, seeds: range) -> tuple[str, list[str]]:
    """The row of the table, and what failed or was left open."""
    row, found, troubles = ROWS[name], list[Outcome](), list[str]()
    for seed in seeds:
        outcome = fit_row(name, seed)
        tell(name, seed, outcome)
        here = f"{row.title}, seed {seed}: "
        if isinstance(outcome, str):
            troubles.append(here + outcome)
        else:
            found.append(outcome)
            troubles += [f"{here}not determined {text}" for text in outcome.undetermined]
    z = np.array([outcome.score for outcome in found])
    inside = np.mean(np.abs(z) < 1.96, axis=1)
    return (f"{row.title} | {z.shape[1]} | {len(found)} of {len(seeds)} "
            f"| {100.0 * inside.mean():.1f} % +- {100.0 * inside.std() / np.sqrt(len(z)):.1f} "
            f"| {np.mean(z):+.2f} | {np.sqrt(np.mean(z**2)):.2f} "
            f"| {100.0 * np.median([np.abs(outcome.error) for outcome in found]):.2g} % "
            f"| {sum(bool(outcome.undetermined) for outcome in found)} "
            f"| {np.median([outcome.iterations for outcome in found]):.0f}"), troubles


def page(fits: int = 24, seed: int = 4000, rows: Sequence[str] = tuple(ROWS)) -> Lines:
    found = [line(name, range(seed, seed + fits)) for name in rows]
    yield from [
        "# IMUs on any link",
        f"Seeds {seed} to {seed + fits - 1} in every row. "
        "MuJoCo simulates dynamics and sensors of random plants. Legs and chains hang from a passive pivot (10 s at "
        "200 Hz, seven links 5 s at 250 Hz). A walker takes eight steps of 0.7 s at 500 Hz. Noise: gyro 0.005 rad/s, "
        "accelerometer 0.05 m/s2, encoders 0.1 mrad, torques 0.02 N m (walker 0.1). Nothing else is read and no noise "
        "level is declared. Link lengths and the IMUs' places are exact."]
    yield table("rig | parameters | fits | 95 % intervals that hold | mean of error / deviation | rms | median "
                "error | fits with anything undetermined | steps", (row for row, _ in found))
    yield from ["+- is the scatter by chance (1 sigma over plants).",
                *(f"- {text}" for _, troubles in found for text in troubles)]


EVIDENCE = Evidence(
    "IMUs on any links and a subset of encoders: do the intervals hold?", "make imu-links FITS=24",
    "imu-links.md", 12, "95 % in every row",
    shares(r"\| (\d+\.\d) % \+-", "% of the intervals hold, by row"), r"[Ss]eeds (\d+ to \d+)")
main = program(page)
