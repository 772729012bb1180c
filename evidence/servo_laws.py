"""`make servo-laws`: friction laws of servos fitted to the same runs, free runs of runs that no fit has seen.

The laws are those of BAM (Duclusaud, Passault, Padois, Ly, ICRA 2025; bam/model.py of Rhoban/bam), from Coulomb and
viscous friction to friction by load. All are fitted alike, by the error of free runs under the command.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daq import Dataset, Rig, parse_rig
from estimator.free_runs import FittedModel
from estimator.likelihood import free_run
from estimator.loops import law_checks
from estimator.options import FitOptions
from estimator.prediction import smooth
from estimator.result import FitResult
from evidence import servo_bam, servo_sts3215
from evidence.page_file import write_page
from evidence.registry import Evidence
from evidence.servo_fits import LAWS, Run, Servo, fitted, published, rms, row, run_of, vector
from experiments.exchange import guess_map, read_imported
from experiments.models import build_mechanism, mechanism_settings
from experiments.session.inputs import driven
from experiments.workflows import fit_runs
from studies import machine
from tests.support.paths import REAL

COMMIT, FOLDER = "b53408c", "data_raw_feetech"
TRAIN = ("2024-10-26_12h23m27", "2024-10-26_12h27m27", "2024-10-26_12h23m42")
TEST = ("2024-10-26_12h24m55",)
RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[servo]\n'
NOT_REACHED = (
    "## Not reached", "",
    "- MX-64, MX-106 and eRob80: BAM publishes values. None of the 602 commits of its repository has a record of a "
    "pendulum with them, only PWM periods and speeds of the two Dynamixels. Its README links to a folder elsewhere.",
    "- XM430: no record with a pendulum and published values was found in public repositories.",
    "- HTD-45H: [leeygang/bam](https://github.com/leeygang/bam) has 24 records at 16 Hz and values of m1 and m6. "
    "Four of the six values of m1 lie at the limits of their search.",
    "- Records of SO-101 arms by LeRobot have no published values.")
NO_STS3215 = "Left out: give a copy of the repository kscalelabs/sysid by `SYSID=PATH`."
NO_REPOSITORY = "The STS3250 is left out: give a copy of the repository Rhoban/bam by `BAM=PATH`."


XL330 = Servo(0.49, 0.1, 0.0, np.ones(16))
STS3250 = Servo(1.13, 0.12, 4.9, np.array([600.0, 60.0] + [5.0, 1.0] + [10.0, 3.0, 10.0] + 8 * [1.0] + [1.0]))
"""Torque of 4.9 N m and m6's values by params/feetech of the same commit"""
STS_M6 = {"strength": 67.32087, "braking": 2.34513, "armature": 0.00099983, "base": 0.19851640, "viscous": 0.03485440,
          "stribeck": 0.04392450, "speed": 0.05865813, "alpha": 1.59283883, "motor": 9.09e-7, "external": 0.19573364,
          "motor_stribeck": 0.02953101, "external_stribeck": 0.41790076, "motor_quad": 0.00151238,
          "external_quad": 0.00941738}


def xl330(kinds: tuple[str, ...]) -> list[Run]:
    """Runs of the XL330 with the gains that its duty shows."""
    datasets, mechanism = servo_bam.records(kinds), build_mechanism(mechanism_settings(servo_bam.rig()))
    (check,) = law_checks(servo_bam.records(servo_bam.TEST), mechanism)
    gains = dict(zip(("kp100", "kp400"), map(float, check.after.gains)))
    return [run_of(d.time_s, d["q1_cmd_rad"], d["volts"], d["torque_enable"], d["q1_rad"], gains[d.name[:5]])
            for d in datasets]


def recorded(repository: str, name: str) -> str:
    """Text of one record of the STS3250."""
    return subprocess.run(["git", "-C", repository, "show", f"{COMMIT}:{FOLDER}/{name}.json"], check=True, text=True,
                          capture_output=True).stdout


def sts3250(repository: str, names: tuple[str, ...]) -> list[Run]:
    """Runs of the STS3250; BAM has its torque by the error of the angle, whatever the volts."""
    found = []
    for name in names:
        rows = json.loads(recorded(repository, name))["entries"]
        t, goal, on, angle = (np.array([float(row[key]) for row in rows]) for key in (
            "timestamp", "goal_position", "torque_enable", "position"))
        found.append(run_of(t, goal, np.ones(t.size), on, angle, 1.0))
    return found


def by_legid(repository: str) -> tuple[FitResult, Rig, list[float]]:
    """Our fit to the runs of TRAIN with the servo on, its rig, and the errors [rad] of its free runs of TEST."""
    with tempfile.TemporaryDirectory() as folder:
        runs = {}
        for name in (*TRAIN[:2], *TEST):
            path = Path(folder) / f"{name}.json"
            path.write_text(recorded(repository, name))
            runs[name] = replace(guess_map(read_imported(path)).run, name=name)
    found = fit_runs([runs[name] for name in TRAIN[:2]], parse_rig(RIG), fixed={"beta2": 1.13 * 0.12})
    model = FittedModel(found.result.mechanism, found.result.hold, found.result.beta)
    return found.result, found.rig, [_error(model, runs[name], found.rig) for name in TEST]


def _error(model: FittedModel, run: Dataset, rig: Rig) -> float:
    looped = driven(run, rig)
    one = smooth(model, looped, FitOptions(sensors="encoder", noise={"encoder_rad": 0.002}))
    found = free_run(one.problem, one.state, one.drive)
    return float("inf") if found is None else float(np.sqrt(np.mean((found.q[:, 0] - looped["q1_rad"]) ** 2)))


def page(bam: str, sysid: str) -> Iterator[str]:
    """The page, line by line."""
    yield from [
        "# Servos: friction laws fitted to the same runs", "",
        f"Made by `make servo-laws BAM=PATH SYSID=PATH`, {datetime.now(UTC):%Y-%m-%d}, {machine()}. "
        "Nothing is drawn.", "",
        "Runs of 6 s of a servo with a pendulum follow BAM's commands. All laws are fitted to the same runs by the "
        "error of free runs, so the laws alone differ. No fit has seen `sin_time_square`. Published values were found "
        "on other records, which may have these among them.", "", "## XL330", "",
        *(xl_section() if REAL.is_dir() else ["Left out: ../shared/realdata is not next to the checkout."]), "",
        "## STS3250", "", *(sts_section(bam) if bam else [NO_REPOSITORY]), "",
        "## STS3215", "", *(servo_sts3215.section(sysid) if sysid else [NO_STS3215]), "", *NOT_REACHED]


def xl_section() -> Iterator[str]:
    """Lines on the XL330."""
    train, test = xl330(servo_bam.TRAIN), xl330(servo_bam.TEST)
    yield from ["| law | held out, kp 100 | held out, kp 400 | fitted runs |", "| --- | ---: | ---: | ---: |"]
    for name, count in LAWS.items():
        yield row(f"fitted: {name}", fitted(train, XL330, count), train, test, XL330)
    for name, values in servo_bam.PUBLISHED.items():
        both = [published(values, sign) for sign in (1.0, -1.0)]
        yield row(f"published {name}", min(both, key=lambda p: sum(rms(p, test, XL330))), train, test, XL330)
    for name, errors_of in servo_bam.errors().items():
        if name.startswith("legid"):
            yield f"| {name} | {' | '.join(f'{1e3 * one:.3g} mrad' for one in errors_of)} | - |"
    yield from ["", *servo_bam.parameters(), "",
                "| share of the torque that is friction | legid, directional_load_friction | published m6 |",
                "| --- | --- | ---: |"]
    for name, (low, value, high, theirs) in servo_bam.shares().items():
        yield f"| {name} | {value:.3g} [{low:.3g}, {high:.3g}] | {theirs:.3g} |"
    verdict, causes, error = servo_bam.diagnosis()
    before, after = error or (np.nan, np.nan)
    yield from ["", f"`legid diagnose` of the six fitted runs: `{verdict}`, {', '.join(causes) or 'nothing'}. The "
                f"error is {before:.3g} times noise before and {after:.3g} after. The samples of "
                "`lift_and_drop` with the motor off have no input: an open motor has no back-EMF."]


def sts_section(repository: str) -> Iterator[str]:
    """Lines on the STS3250."""
    train, test = sts3250(repository, TRAIN), sts3250(repository, TEST)
    result, rig, held_out = by_legid(repository)
    yield from [f"Four records of [Rhoban/bam](https://github.com/Rhoban/bam) at `{COMMIT}`, `{FOLDER}`, kp 32, 48 Hz. "
                "legid has the two runs with the servo on, and the first moment by the file's mass and length.", "",
                "| law | held out | fitted runs |", "| --- | ---: | ---: |"]
    for name, count in LAWS.items():
        yield row(f"fitted: {name}", fitted(train, STS3250, count), train, test, STS3250)
    yield row("published m6", vector(STS_M6), train, test, STS3250)
    yield from [f"| legid, mle: Coulomb and viscous, delay | {1e3 * held_out[0]:.3g} mrad | - |", "",
                "| value | legid, 95 % interval | published m6 |", "| --- | --- | ---: |"]
    theirs = {"beta1": 1.13 * 0.12**2 + STS_M6["armature"], "beta3": STS_M6["viscous"] + STS_M6["braking"],
              "beta4": STS_M6["base"]}
    words = {"beta1": "inertia [kg m^2]", "beta3": "viscous friction with the loop's damping [N m s/rad]",
             "beta4": "Coulomb friction [N m]"}
    ci = result.ci95()
    for k, p in enumerate(result.mechanism.parameters):
        if p.name in theirs:
            yield f"| {words[p.name]} | {result.beta[k]:.3g} [{ci[k, 0]:.3g}, {ci[k, 1]:.3g}] | {theirs[p.name]:.3g} |"
    for one in result.loop:
        low, high = one.value - one.half, one.value + one.half
        yield f"| {one.key}{'' if one.found else ', not shown'} | {one.value:.3g} [{low:.3g}, {high:.3g}] | - |"
    assert rig.servo is not None
    yield f"| gain [N m/rad] | {rig.servo.gain:.3g} | {STS_M6['strength']:.3g} |"


EVIDENCE = (Evidence(
    "Friction laws of servos, fitted to the same runs: what do they leave on runs that none has seen?",
    "make servo-laws BAM=PATH SYSID=PATH", "servo-laws.md", 4,
    "at most that of BAM's best law, fitted to the same runs",
    (r"(fitted: and by load \(m6\) \| [^|]*\| [^|]*)\|", r"(legid, mle: and directional[^|]*\| [^|]*\| [^|]*)\|")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, bam=("", "a copy of the repository Rhoban/bam"),
               sysid=("", "a copy of the repository kscalelabs/sysid"))
