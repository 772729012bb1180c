"""Do the 95 % intervals hold? Fits of an independent leg with dry friction, beside the parameters that made it.

`make coverage PLANT=...` writes a page. Nothing in a rig says how the torque acts between samples. Plants: `stickslip`,
`tests.support.stick_slip_leg`, set-valued friction, reversals and rest located by root finding, the motor driven at
1 kHz; and `mujoco`, the leg of `evidence.blind.servo` under its position servo, whose solver takes a joint
through rest with a time constant of its own. `wander` is `tests.support.ornstein_uhlenbeck`, MuJoCo's leg with a
coloured disturbance torque at the knee.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.random import default_rng

from daq import Dataset, FloatArray
from estimator import TWO_SIDED, FitError, FitOptions, Method, fit
from estimator.model import leg2
from evidence.blind import servo
from evidence.frame import Lines, program, table, tell
from evidence.kept import kept
from evidence.registry import Evidence, shares
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.ornstein_uhlenbeck import disturbed_record
from tests.support.stick_slip_leg import PEAK_NM, move, sample

FRICTION = (0.02, 0.05, 0.10)
RATES = (50, 100, 250, 500)
PIVOT_NM = 0.01
"""Least Coulomb level of the pivot."""
WANDER, SHUNT_NM = (0.3, 1.0), 0.02
"""Levels of a disturbance torque over the shunt's noise, and that noise."""
TIME_CONSTANTS_S = (0.02, 0.1, 0.5)
MUJOCO_NM = (0.03, 0.12)
"""Coulomb levels of the knee of MuJoCo's legs; their pivots have a tenth."""
Case = Callable[[int], tuple[Leg, list[Dataset]]]
Row = tuple[str, Sequence[int], Case, Method, str]
"""Drive, friction and rate; seeds, case of a seed, method, sensors"""


def case(seed: int, friction: float, closed: bool, rate_hz: float, runs: int = 1, scatter: float | None = None
         ) -> tuple[Leg, list[Dataset]]:
    """A leg of which the knee's Coulomb level is this share of the peak torque, and its recorded runs, between which
    both levels scatter by this share of themselves."""
    rng = default_rng(seed)
    leg = replace(random_leg(rng), coulomb=(PIVOT_NM + 0.1 * friction * PEAK_NM, friction * PEAK_NM))
    found = []
    for i in range(runs):
        worn = [1.0, 1.0] if scatter is None else [max(1.0 + scatter * rng.normal(), 0.1) for _ in leg.coulomb]
        own = replace(leg, coulomb=(leg.coulomb[0] * worn[0], leg.coulomb[1] * worn[1]))
        found.append(sample(move(own, rng, closed=closed), rng, rate_hz, name=f"run{i}"))
    return leg, found


def mujoco_case(seed: int, rate_hz: int, runs: int) -> tuple[Leg, list[Dataset]]:
    """Of a leg's recorded runs at 1 kHz every so many samples, with the sensors' noise on them."""
    leg, fine = _recorded(seed, runs)
    rng = default_rng([seed, rate_hz])
    found = []
    for k, columns in enumerate(fine):
        kept = {name: values[:: 1000 // rate_hz].copy() for name, values in columns.items() if name != "time_s"}
        for name, sigma in servo.NOISE.items():
            kept[name] += sigma * rng.normal(size=kept[name].size)
        kept["q2_rad"] = servo.counted(kept["q2_rad"])
        found.append(Dataset(f"run{k}", float(rate_hz), np.arange(kept["q2_rad"].size) / rate_hz, kept))
    return leg, found


@cache
def _recorded(seed: int, runs: int) -> tuple[Leg, list[dict[str, FloatArray]]]:
    servo.RATE_HZ = 1000.0
    rng = default_rng(seed)
    leg, dry = replace(random_leg(rng), coulomb=(0.0, 0.0)), rng.uniform(*MUJOCO_NM)
    fine = [servo.record(leg, servo.Plant(), dry, rng, k, 25.0 * k) for k in range(runs)]
    return replace(leg, coulomb=(0.1 * dry, dry)), fine


def wandering_case(seed: int, ratio: float, constant_s: float) -> tuple[Leg, list[Dataset]]:
    """A leg whose knee feels a disturbance of so many times the shunt's noise."""
    rng = default_rng(seed)
    leg = random_leg(rng)
    return leg, [disturbed_record(leg, rng, ratio * SHUNT_NM, constant_s)]


@kept
def scores(seeds: Sequence[int], made: Case, sensors: str, method: Method) -> FloatArray:
    """(fits, 9) error of each parameter over half its interval, times 1.96; rows of fits that fail are missing."""
    found = []
    for seed in seeds:
        leg, data = made(seed)
        options = FitOptions(sensors=sensors, hold="auto", smoothing_velocity="auto")
        try:
            result = fit(data, leg2(lever_arm=leg.lever), options, method)
        except FitError:
            continue
        if result.converged:
            found.append((result.beta - leg.beta()) / (result.half_width / TWO_SIDED))
    return np.array(found)


def mujoco_rows(seeds: range, rates: Sequence[int]) -> Iterator[Row]:
    for runs, some in ((1, seeds), (8, seeds[: len(seeds) // 2])):
        for rate in rates if runs == 1 else (100,):
            for method in ("mle", "wls"):
                yield (f"position, {runs} run{'s' * (runs > 1)} | 0.03 to 0.12 N m | {rate}", some,
                       partial(mujoco_case, rate_hz=rate, runs=runs), method, "imu")


def stickslip_rows(seeds: range, rates: Sequence[int]) -> Iterator[Row]:
    ways: tuple[tuple[Method, str], ...] = (("mle", "imu"), ("mle", "encoder"), ("wls", "imu"))
    for closed in (False, True):
        for friction in FRICTION:
            for rate in rates:
                head = f"{'position' if closed else 'torque'} | {100 * friction:g} % | {rate}"
                yield from ((head, seeds, partial(case, friction=friction, closed=closed, rate_hz=rate), *way)
                            for way in ways)


def wandering_rows(seeds: range, rates: Sequence[int]) -> Iterator[Row]:
    """A knee motor that wanders, by level over the shunt's noise and by time constant, at 100 Hz."""
    for ratio in (0.0, *WANDER) if 100 in rates else ():
        for constant_s in TIME_CONSTANTS_S if ratio else (1.0,):
            name = f"{ratio:g} times the shunt's noise over {1e3 * constant_s:g} ms" if ratio else "no disturbance"
            yield (f"torque, {name} | 0.03 and 0.04 to 0.06 N m | 100", seeds,
                   partial(wandering_case, ratio=ratio, constant_s=constant_s), "mle", "imu")


def _row(head: str, seeds: Sequence[int], made: Case, method: Method, sensors: str) -> str:
    z = scores(seeds, made, sensors, method)
    told = f"{head} | {method}-{sensors} | {len(z)}/{len(seeds)} | "
    if len(z):
        mean, rms = z.mean(axis=0), np.sqrt(np.mean(z**2, axis=0))
        told += (f"{100 * np.mean(np.abs(z) < 1.96):.0f} % | {' '.join(f'{m:+.1f}' for m in mean)} | "
                 f"{' '.join(f'{r:.1f}' for r in rms)}")
    tell(told)
    return told


PLANTS = {
    "wander": (wandering_rows, "MuJoCo's leg under a multisine of torque; an Ornstein-Uhlenbeck torque disturbs the "
                               "knee, which its shunt does not read."),
    "mujoco": (mujoco_rows, "MuJoCo's leg, its friction that of MuJoCo's solver, under a position servo at 1 kHz."),
    "stickslip": (stickslip_rows, "a leg with set-valued dry friction, reversals and rest by root finding, driven at "
                                  "1 kHz by an open-loop multisine of torque, or a position controller.")}


def page(plant: str = "stickslip", fits: int = 200, seed: int = 1000, rates: Sequence[int] = RATES) -> Lines:
    rows, told = PLANTS[plant]
    yield from [
        f"# Do the intervals hold? {plant}", f"Seeds {seed} to {seed + fits - 1}. Plant: {told} "
        "Runs of 20 s; the torque hold and the friction smoothing velocity are chosen by the fit, as is the default. "
        "Coverage of the 95 % intervals over all parameters, then mean and rms of error over standard deviation for "
        f"beta1 to beta9. Each row is uncertain by its number of fits: a mean by {fits**-0.5:.2f}, "
        f"an rms by {(2 * fits) ** -0.5:.2f}."]
    yield table("drive | friction | rate [Hz] | method | fits | coverage | mean | rms",
                (_row(*row) for row in rows(range(seed, seed + fits), rates)))


HELD = (shares(r"mle-\S+ \| \d+/\d+ \| (\d+) %", "% of the intervals of mle hold, by row"), r"[Ss]eeds (\d+ to \d+)")
EVIDENCE = (
    Evidence("Do the 95 % intervals of a fit hold under set-valued dry friction?",
             "make coverage PLANT=stickslip FITS=16 SEED=2300 RATES=\"100 250\"", "coverage-stickslip.md", 6,
             "95 % in every row of mle", *HELD),
    Evidence("Do the 95 % intervals of a fit hold on MuJoCo's leg under a position servo?",
             "make coverage PLANT=mujoco FITS=16 SEED=3300 RATES=\"50 100 250\"", "coverage-mujoco.md", 4,
             "95 % in every row of mle", *HELD),
    Evidence("Do the 95 % intervals of a fit hold where a coloured torque disturbs the knee?",
             "make coverage PLANT=wander FITS=16 RATES=100 SEED=1300", "coverage-wander.md", 2,
             "93 to 97 % in every row", *HELD))
main = program(page)
