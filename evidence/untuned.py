"""`make untuned`: real records without a specialist, before and after, and spoilt ones; writes a page.

A rig.toml holds the mechanism, its driven joints, the gear and gravity, and nothing else.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray, Rig, parse_rig
from daq.runs import write_csv
from estimator import fit
from evidence.frame import Lines, heard, new_folder, program, table
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.session import load_runs, setup_of, with_choices
from experiments.workflows import fit_runs, tune_runs
from legid import cli
from tests.support.mujoco_leg import random_leg, record
from tests.support.paths import REAL

ARM = '[mechanism]\nmodel = "leg2"\nactuated = [1, 2]\ngravity_mps2 = 9.81\n[motor]\ngear_ratio = 6.0\n'
JOINT = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'
LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'
DEGREES = 180 / np.pi
ENDS = ("sin_sin", "up_and_down", "sin_time_square", "lift_and_drop")


class Record(NamedTuple):
    """Runs of one rig, what is published of it, and under what model."""

    title: str
    runs: tuple[str, ...]
    rig: str
    published: tuple[float, ...]
    """The first parameters."""


RECORDS = {
    "dfki_c0": Record("two-link arm, design C.0", ("00", "01", "02", "03", "04", "05", "06"), ARM,
                      (0.05354, 0.05328, 0.03623, 0.24113, 0.18117)),
    "dfki_a0": Record("two-link arm, design A.0", ("00", "01", "02", "03", "12"), ARM,
                      (0.11116, 0.02346, 0.03332, 0.34912, 0.11106)),
    "emps": Record("prismatic axis", ("estimation",), JOINT + "gravity_mps2 = 0.0\n",
                   (95.1089, 203.5034, 20.3935)),
    # R / kt = 14.74 V/(N m) times (m l^2 + armature, m l, friction), and kt: the authors' model m1, without Stribeck's
    "bam_xl330": Record("servo and pendulum, volts (the authors' Coulomb and viscous model)",
                        tuple(f"kp{k}_{end}" for k in (100, 400) for end in ENDS),
                        JOINT + 'input = "voltage"\n', (0.0964, 0.7222, 0.4779, 0.1027)),
}


def paths_of(folder: str) -> list[Path]:
    return [REAL / folder / f"{run}.csv.gz" for run in RECORDS[folder].runs]


def departures(beta: FloatArray, published: Sequence[float]) -> str:
    return " ".join(f"{100 * (b / p - 1):+.1f}" for b, p in zip(beta, published))


@kept
def accuracy(folder: str) -> tuple[str, ...]:
    """One row: departure from what is published, as before, by `fit` alone, and after `tune`."""
    known = RECORDS[folder]
    silent = parse_rig(known.rig)
    runs = load_runs(paths_of(folder), silent)
    setup = setup_of(runs, silent)
    before = fit(setup.datasets, setup.mechanism, setup.options)
    after = fit_runs(runs, silent)
    tuned = with_choices(silent, tune_runs(paths_of(folder), silent).choices)
    last = fit_runs(load_runs(paths_of(folder), tuned), tuned)
    cells = [departures(found.beta, known.published) for found in (before, after.result, last.result)]
    return known.title, *cells


Spoil = Callable[[Dataset], Mapping[str, FloatArray]]


def negated(*columns: str) -> Spoil:
    return lambda d: {c: -d[c] for c in columns}


def times(factor: float, *columns: str) -> Spoil:
    return lambda d: {c: factor * d[c] for c in columns}


def swapped(a: str, b: str) -> Spoil:
    return lambda d: {a: d[b], b: d[a]}


ARM_SPOILS: dict[str, tuple[Spoil, str]] = {
    "torque of joint 2 negated": (negated("tau2_nm"), "tau2_nm looks negated"),
    "torque of joint 1 negated": (negated("tau1_nm"), "tau1_nm looks negated"),
    "both torques negated": (negated("tau1_nm", "tau2_nm"), "tau1_nm and tau2_nm look negated"),
    "q2 negated": (negated("q2_rad"), "q2_rad looks negated"),
    "q1 negated": (negated("q1_rad"), "q1_rad looks negated"),
    "q2 and its torque negated": (negated("q2_rad", "tau2_nm"), "tau2_nm and q2_rad look negated"),
    "degrees for radians, both": (times(DEGREES, "q1_rad", "q2_rad"), "q1_rad and q2_rad look in degrees"),
    "degrees for radians, q2": (times(DEGREES, "q2_rad"), "q2_rad looks in degrees"),
    "q2 of the motor's side": (times(6.0, "q2_rad"), "q2_rad looks of the motor's side"),
    "q2 by the gear twice": (times(1 / 6.0, "q2_rad"), "q2_rad looks divided by the gear ratio twice"),
    "q2 by a gear of 4 for 6": (times(1.5, "q2_rad"), "times too large"),
    "angles interchanged": (swapped("q1_rad", "q2_rad"), "q1_rad and q2_rad look interchanged"),
    "torques interchanged": (swapped("tau1_nm", "tau2_nm"), "tau1_nm and tau2_nm look interchanged"),
    "gravity upside down": (lambda d: {"q1_rad": d["q1_rad"] + np.pi}, "upside down"),
    "q2 absolute": (lambda d: {"q2_rad": d["q1_rad"] + d["q2_rad"]}, "look absolute"),
}
IMU_SPOILS: dict[str, tuple[Spoil, str]] = {
    "accelerometer's x negated": (negated("accel_x_mps2"), "accel_x_mps2 looks negated"),
    "accelerometer's y negated": (negated("accel_y_mps2"), "accel_y_mps2 looks negated"),
    "accelerometer's axes interchanged": (swapped("accel_x_mps2", "accel_y_mps2"), "accel_x_mps2 looks like"),
    "gyro negated": (negated("gyro_radps"), "gyro_radps looks negated"),
    "gyro in degrees": (times(DEGREES, "gyro_radps"), "gyro_radps looks in degrees"),
    "accelerometer in g": (times(1 / 9.80665, "accel_x_mps2", "accel_y_mps2"), "look in g"),
    "knee's torque negated": (negated("tau2_nm"), "tau2_nm looks negated"),
    "knee in degrees": (times(DEGREES, "q2_rad"), "q2_rad looks in degrees"),
}


def spoilt(run: Dataset, by: Spoil) -> Dataset:
    return replace(run, columns={**run.columns, **by(run)})


Case = tuple[str, str, str, list[Dataset], str]
"""Record, what was done to it, rig, runs, words that must be said."""


def raw(folder: str, names: Sequence[str], rig: Rig) -> list[Dataset]:
    return list(load_runs([REAL / folder / f"{name}.csv.gz" for name in names], rig))


def cases() -> Iterator[Case]:
    """Every spoilt variant."""
    arm, servo = parse_rig(ARM), RECORDS["bam_xl330"].rig
    c0 = raw("dfki_c0", ("00", "01", "02", "05"), arm)
    a0 = raw("dfki_a0", ("00", "01", "02", "03"), arm)
    for what, (by, said) in ARM_SPOILS.items():
        yield "arm C.0", what, ARM, [spoilt(run, by) for run in c0], said
    for what in ("torque of joint 2 negated", "q1 negated", "gravity upside down", "q2 by a gear of 4 for 6"):
        by, said = ARM_SPOILS[what]
        yield "arm A.0", what, ARM, [spoilt(run, by) for run in a0], said
    yield "arm A.0", "a file of the other arm", ARM, [*a0, replace(c0[0], name="other.csv")], "other.csv is set aside"
    last = a0[3].name
    in_one: tuple[tuple[str, Spoil, str], ...] = (
        ("q2 stuck", lambda d: {"q2_rad": np.full(len(d), 0.3)}, f"{last} is set aside: joint 2 never moves"),
        ("a torque stuck", lambda d: {"tau1_nm": np.full(len(d), 0.4)}, "tau1_nm never changes"),
        ("torque negated", negated("tau2_nm"), f"{last} is set aside"))
    for what, by, said in in_one:
        yield "arm A.0", f"{what} in one run", ARM, [*a0[:3], spoilt(a0[3], by)], said
    emps = raw("emps", ("estimation",), parse_rig(RECORDS["emps"].rig))
    yield "axis", "force negated", RECORDS["emps"].rig, [spoilt(emps[0], negated("tau1_n"))], "tau1_n looks negated"
    bam = raw("bam_xl330", ("kp100_sin_sin", "kp400_up_and_down"), parse_rig(servo))
    for what, by, said in (("volts negated", negated("voltage1_v"), "duty looks negated"),
                           ("degrees for radians", times(DEGREES, "q1_rad"), "q1_rad looks in degrees"),
                           ("gravity upside down", lambda d: {"q1_rad": d["q1_rad"] + np.pi}, "upside down")):
        yield "servo", what, servo, [spoilt(run, by) for run in bam], said
    rng = np.random.default_rng(5)
    body = random_leg(rng)
    legs = [record(body, rng, seconds=10.0, amplitude=a, name=f"leg{k}.csv") for k, a in enumerate((1.2, 0.8))]
    for what, (by, said) in IMU_SPOILS.items():
        yield "simulated leg, IMU", what, LEG, [spoilt(run, by) for run in legs], said
    yield "simulated leg, IMU", "lever arm 0.1 m for 0.2", LEG.replace("0.2", "0.1"), legs, "lever_arm_m"


def fitted(runs: Sequence[Dataset], rig: str) -> tuple[int, str]:
    """Exit status of `legid fit` and all that it said."""
    with new_folder() as folder, heard() as out:
        files = []
        for run in runs:
            files.append(f"{folder}/{run.name.removesuffix('.gz')}")
            write_csv(run, files[-1])
        (folder / "rig.toml").write_text(rig)
        status = cli.main(["fit", *files, "--rig", f"{folder}/rig.toml"])
    return status, out.getvalue().replace(".csv.gz", ".csv")


@kept
def judged(case: Case) -> tuple[tuple[str, ...], bool]:
    """A row of the page, and whether the right thing was said."""
    where, what, rig, runs, words = case
    status, said = fitted(runs, rig)
    named = words.replace(".csv.gz", ".csv") in said
    silent = status == 0 and "warning:" not in said.lower()
    verdict = "SILENT" if silent else "named" if named else "not named"
    return (where, what, "refused" if status else "warned", verdict), named and not silent


def page(only: Sequence[str] = tuple(RECORDS)) -> Lines:
    if not REAL.is_dir():
        raise SystemExit(f"{REAL} is not there: the records are no part of the project")
    rows = [judged(case) for case in cases()]
    yield from [
        "# Real records without a specialist",
        "A rig.toml holds mechanism, driven joints, gear and gravity, nothing else."
        " Every figure is of one command without an option.",
        "## Departure from what is published [%]",
        "beta1, beta2, ... in the mechanism's order. Before: a fit that chooses nothing. `fit`: with its own "
        "choices for what rig.toml leaves open. `tune`: `legid tune --write`, then `legid fit`."]
    yield table("record | before | `fit` | `tune`, then `fit`", map(accuracy, only))
    yield from ["## Spoilt set-ups",
                f"{sum(ok for _, ok in rows)} of {len(rows)} variants are named with the right remedy or run; none may "
                "converge in silence."]
    yield table("record | spoilt by | `legid fit` | the cause is", (row for row, _ in rows))


EVIDENCE = Evidence(
    "Real records with minimal rig files, and records with an error put in", "make untuned", "untuned.md", 15,
    "every spoilt set-up named with its remedy, none converges silently",
    (r"\d+ of \d+ variants are named with the right remedy or run",))
main = program(page)
