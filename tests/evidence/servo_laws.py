"""`make servo-laws`: friction laws of servos fitted to the same runs, free runs of runs that no fit has seen.

The laws are those of BAM (Duclusaud, Passault, Padois, Ly, ICRA 2025; bam/model.py of Rhoban/bam), from Coulomb and
viscous friction to friction by load. All are fitted alike, by the error of free runs under the command.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from daq import Dataset, FloatArray, Rig, parse_rig
from estimator.free_runs import FittedModel
from estimator.likelihood import free_run
from estimator.loops import law_checks
from estimator.options import FitOptions
from estimator.prediction import smooth
from estimator.result import FitResult
from experiments.exchange import guess_map, read_imported
from experiments.models import build_mechanism, mechanism_settings
from experiments.session.inputs import driven
from experiments.workflows import fit_runs
from studies import machine
from tests.evidence import servo_bam
from tests.evidence.page_file import write_page
from tests.evidence.registry import Evidence
from tests.support.paths import REAL

STEP_S, EVERY, G = 1e-3, 5, 9.81
COMMIT, FOLDER = "b53408c", "data_raw_feetech"
TRAIN = ("2024-10-26_12h23m27", "2024-10-26_12h27m27", "2024-10-26_12h23m42")
TEST = ("2024-10-26_12h24m55",)
NAMES = ("strength", "braking", "armature", "offset", "base", "viscous", "stribeck", "speed", "alpha", "motor",
         "external", "motor_stribeck", "external_stribeck", "motor_quad", "external_quad", "delay")
LAWS = {"Coulomb, viscous (m1)": 6, "and Stribeck (m2)": 9, "and by load (m6)": 15, "and delay": 16}
"""Law -> how many of NAMES it has."""
BEGIN = np.array([0.09, 0.03, 0.002, 0.02, 0.005, 0.01, 0.004, 1.0, 1.5, 0.2, 0.1, 0.02, 0.05, 0.005, 0.005, 0.003])
MOST = np.array([1.0, 1.0, 0.02, 0.2, 0.2, 0.2, 0.2, 10.0, 10.0, 0.9, 0.9, 0.9, 0.9, 0.1, 0.1, 0.05])
RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[servo]\n'
NO_REPOSITORY = "The STS3250 is left out: give a copy of the repository Rhoban/bam by `BAM=PATH`."


class Servo(NamedTuple):
    """A servo with a pendulum."""

    mass_kg: float
    arm_m: float
    limit_nm: float
    """Of the torque, damping included; 0: full duty, before back-EMF"""
    unit: FloatArray
    """(16,) of NAMES, over BEGIN and MOST"""


class Run(NamedTuple):
    """One record on a grid of STEP_S."""

    goal: FloatArray
    volts: FloatArray
    on: FloatArray
    gain: float
    angle: FloatArray
    """At each EVERY-th step"""


XL330 = Servo(0.49, 0.1, 0.0, np.ones(16))
STS3250 = Servo(1.13, 0.12, 4.9, np.array([600.0, 60.0] + [5.0, 1.0] + [10.0, 3.0, 10.0] + 8 * [1.0] + [1.0]))
"""Torque of 4.9 N m and m6's values by params/feetech of the same commit"""
STS_M6 = {"strength": 67.32087, "braking": 2.34513, "armature": 0.00099983, "base": 0.19851640, "viscous": 0.03485440,
          "stribeck": 0.04392450, "speed": 0.05865813, "alpha": 1.59283883, "motor": 9.09e-7, "external": 0.19573364,
          "motor_stribeck": 0.02953101, "external_stribeck": 0.41790076, "motor_quad": 0.00151238,
          "external_quad": 0.00941738}


@njit
def _simulated(p, goal, volts, on, gain, q, mass, arm, limit):  # type: ignore[no-untyped-def]
    out, v, inertia, late = np.empty(-(-goal.size // EVERY)), 0.0, mass * arm**2 + p[2], p[15] / STEP_S
    for k in range(goal.size):
        if k % EVERY == 0:
            out[k // EVERY] = q
        at = max(k - late, 0.0)
        first, motor = int(at), 0.0
        told = goal[first] + (at - first) * (goal[min(first + 1, goal.size - 1)] - goal[first])
        if on[k] > 0.5:
            wanted = p[0] * volts[k] * gain * (told - q)
            if limit > 0.0:
                motor = min(max(wanted - p[1] * v, -limit), limit)
            else:
                motor = min(max(wanted, -p[0] * volts[k]), p[0] * volts[k]) - p[1] * v
        load = -mass * G * arm * np.sin(q + p[3])
        near = np.exp(-((abs(v) / p[7]) ** p[8]))
        loss = p[4] + near * p[6] + abs(load * p[10] - motor * p[9]) + near * abs(load * p[12] - motor * p[11])
        if load * motor < 0.0:
            loss += near * (p[14] * load**2 if abs(load) < abs(motor) else p[13] * motor**2)
        loss += p[5] * abs(v)
        net = motor + load
        stop = -(inertia * v / STEP_S + net)
        v += STEP_S / inertia * (net + min(max(stop, -loss), loss))
        q += STEP_S * v
    return out


def errors(p: FloatArray, run: Run, servo: Servo) -> FloatArray:
    """(N,) error [rad] of a free run from the first reading at rest."""
    found = _simulated(p, run.goal, run.volts, run.on, run.gain, run.angle[0], servo.mass_kg, servo.arm_m,
                       servo.limit_nm)
    return np.clip(np.nan_to_num(found[: run.angle.size] - run.angle, nan=2.0), -2.0, 2.0)


def rms(p: FloatArray, runs: Sequence[Run], servo: Servo) -> list[float]:
    """Root mean square of the errors of each run [rad]."""
    return [float(np.sqrt(np.mean(errors(p, run, servo) ** 2))) for run in runs]


def fitted(runs: Sequence[Run], servo: Servo, count: int) -> FloatArray:
    """(16,) values of NAMES by the least error of free runs, the first `count` of them free."""
    best, found = np.inf, BEGIN
    scale = servo.unit
    for sign in (1.0, -1.0):
        base = np.where(np.arange(16) < count, BEGIN * scale, 0.0)
        base[7:9] = base[7:9] if count > 8 else 1.0
        base[3] *= sign

        def left(x: FloatArray, base: FloatArray = base) -> FloatArray:
            return np.concatenate([errors(np.append(x, base[count:]), run, servo) for run in runs])

        low = np.where(np.arange(count) == 3, -0.2, np.where(np.isin(np.arange(count), (7, 8)), 0.01, 0.0))
        low[0] = 1e-3
        one = least_squares(left, base[:count], bounds=(low, (MOST * scale)[:count]), loss="soft_l1", f_scale=0.1,
                            x_scale=np.maximum(0.5 * np.abs(base[:count]), 1e-4), max_nfev=60, diff_step=[1e-3])
        if one.cost < best:
            best, found = float(one.cost), np.append(one.x, base[count:])
    return found


def run_of(time_s: FloatArray, goal: FloatArray, volts: FloatArray, on: FloatArray, angle: FloatArray, gain: float
           ) -> Run:
    """One record on the grid."""
    t = time_s - time_s[0]
    fine = np.arange(int(t[-1] / STEP_S)) * STEP_S
    return Run(np.interp(fine, t, goal), np.interp(fine, t, volts), np.interp(fine, t, on), gain,
               np.interp(fine[::EVERY], t, angle))


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


def vector(values: Mapping[str, float]) -> FloatArray:
    """(16,) values by NAMES."""
    return np.array([values.get(name, 1.0 if name in ("speed", "alpha") else 0.0) for name in NAMES])


def published(values: Mapping[str, float], sign: float) -> FloatArray:
    """(16,) values of the XL330 as BAM publishes them."""
    strength = values["kt"] / values["R"]
    same = {"armature": "armature", "base": "friction_base", "viscous": "friction_viscous",
            "stribeck": "friction_stribeck", "speed": "dtheta_stribeck", "alpha": "alpha",
            "motor": "load_friction_motor", "external": "load_friction_external",
            "motor_stribeck": "load_friction_motor_stribeck", "external_stribeck": "load_friction_external_stribeck",
            "motor_quad": "load_friction_motor_quad", "external_quad": "load_friction_external_quad"}
    own = {name: values[key] for name, key in same.items() if key in values}
    return vector({"strength": strength, "braking": strength * values["kt"], "offset": sign * values["q_offset"],
                   **own})


def page(bam: str) -> Iterator[str]:
    """The page, line by line."""
    yield from [
        "# Servos: friction laws fitted to the same runs", "",
        f"Made by `make servo-laws BAM=PATH`, {datetime.now(UTC):%Y-%m-%d}, {machine()}. Nothing is drawn.", "",
        "Runs of 6 s of a servo with a pendulum follow BAM's commands. All laws are fitted to the same runs by the "
        "error of free runs, so the laws alone differ. No fit has seen `sin_time_square`. Published values were found "
        "on other records, which may have these among them.", "", "## XL330", "",
        *(xl_section() if REAL.is_dir() else ["Left out: ../shared/realdata is not next to the checkout."]), "",
        "## STS3250", "", *(sts_section(bam) if bam else [NO_REPOSITORY]), "", "## Not reached", "",
        "- MX-64 and MX-106: BAM publishes values. Its repository has no record of a pendulum with them.",
        "- STS3215: BAM has values of `m1`, and no record. Records of SO-101 arms by LeRobot have no published values."]


def xl_section() -> Iterator[str]:
    """Lines on the XL330."""
    train, test = xl330(servo_bam.TRAIN), xl330(servo_bam.TEST)
    yield from ["| law | held out, kp 100 | held out, kp 400 | fitted runs |", "| --- | ---: | ---: | ---: |"]
    for name, count in LAWS.items():
        yield _row(f"fitted: {name}", fitted(train, XL330, count), train, test, XL330)
    for name, values in servo_bam.PUBLISHED.items():
        both = [published(values, sign) for sign in (1.0, -1.0)]
        yield _row(f"published {name}", min(both, key=lambda p: sum(rms(p, test, XL330))), train, test, XL330)
    for name, errors_of in servo_bam.errors().items():
        if name.startswith("legid"):
            yield f"| {name} | {' | '.join(f'{1e3 * one:.3g} mrad' for one in errors_of)} | - |"


def _row(name: str, p: FloatArray, train: Sequence[Run], test: Sequence[Run], servo: Servo) -> str:
    own = float(np.sqrt(np.mean(np.square(rms(p, train, servo)))))
    return f"| {name} | {' | '.join(f'{1e3 * one:.3g} mrad' for one in rms(p, test, servo))} | {1e3 * own:.3g} mrad |"


def sts_section(repository: str) -> Iterator[str]:
    """Lines on the STS3250."""
    train, test = sts3250(repository, TRAIN), sts3250(repository, TEST)
    result, rig, held_out = by_legid(repository)
    yield from [f"Four records of [Rhoban/bam](https://github.com/Rhoban/bam) at `{COMMIT}`, `{FOLDER}`, kp 32, 48 Hz. "
                "legid has the two runs with the servo on, and the first moment by the file's mass and length.", "",
                "| law | held out | fitted runs |", "| --- | ---: | ---: |"]
    for name, count in LAWS.items():
        yield _row(f"fitted: {name}", fitted(train, STS3250, count), train, test, STS3250)
    yield _row("published m6", vector(STS_M6), train, test, STS3250)
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
    "make servo-laws BAM=PATH", "servo-laws.md", 3, "at most that of BAM's best law, fitted to the same runs",
    (r"(fitted: and by load \(m6\) \| [^|]*\| [^|]*)\|", r"(legid, mle: [^|]*\| [^|]*\| [^|]*)\|")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, bam=("", "a copy of the repository Rhoban/bam"))
