"""The STS3215 of kscalelabs/sysid: BAM's laws and ours, fitted to some of its records, and what its authors publish.

The repository has a hundred records a second of 960 runs with a pendulum, and BAM's parameters of m1 to m6. Its README
says how the duty follows the error: 0.1649 a unit of kp and rad.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from daq import Dataset, parse_rig
from estimator.free_runs import FittedModel
from estimator.likelihood import free_run
from estimator.options import FitOptions
from estimator.prediction import smooth
from evidence.servo_fits import LAWS, Run, Servo, fitted, published, rms, row, run_of
from experiments.session.inputs import driven
from experiments.workflows import fit_runs

COMMIT, FOLDER = "ca1ecb1", "data/feetech/STS_3215_12V_20250317/raw"
VALUES = "f4739df:feetech/sts3215-12v/params/id004-params"
TRAIN = ("sin_sin_2025-03-17_183411", "sin_sin_2025-03-17_183542", "up_and_down_2025-03-17_183843",
         "up_and_down_2025-03-17_184014", "lift_and_drop_2025-03-17_182936", "lift_and_drop_2025-03-17_183108")
TEST = ("sin_time_square_2025-03-17_184316", "sin_time_square_2025-03-17_184447")
OURS = ("sin_sin_2025-03-17_183542", "sin_sin_2025-03-17_183553", "up_and_down_2025-03-17_184014",
        "up_and_down_2025-03-17_184026")
"""Of kp 16, to which our law of the loop is stated"""
DUTY = 0.164890901
LOST_RAD = 3.1
"""Readings beyond are -pi, register 0"""
STS3215 = Servo(0.553, 0.1, 0.0, np.array([4.0, 40.0, 10.0, 1.0, 10.0, 6.0, 20.0, 0.2, 1.0] + 7 * [1.0]))
"""Half of the arm's 36 g added to the weight of 535 g"""
RIG = f"""[mechanism]
model = "joint1"
actuated = [1]
input = "voltage"
[terms]
friction_velocity_radps = 0.05
[servo]
gain = {16 * DUTY}
damping = 0.0
integral = 0.0
"""
LATE_S = 0.034


def _shown(repository: str, what: str) -> Any:
    return json.loads(subprocess.run(["git", "-C", repository, "show", what], check=True, text=True,
                                     capture_output=True).stdout)


def _rows(repository: str, name: str) -> tuple[float, dict[str, np.ndarray]]:
    """kp of one record, and its columns where the angle was read."""
    record = _shown(repository, f"{COMMIT}:{FOLDER}/sysid_sts3215_{name}.json")
    rows = [one for one in record["entries"] if abs(one["position"]) < LOST_RAD]
    return float(record["kp"]), {key: np.array([float(one[key]) for one in rows]) for key in (
        "timestamp", "goal_position", "position", "input_volts", "torque_enable")}


def runs(repository: str, names: Sequence[str]) -> list[Run]:
    """Records as the laws take them."""
    found = []
    for name in names:
        kp, c = _rows(repository, name)
        found.append(run_of(c["timestamp"], c["goal_position"], c["input_volts"], c["torque_enable"], c["position"],
                            DUTY * kp))
    return found


def dataset(repository: str, name: str) -> Dataset:
    """One record as legid takes it, on its grid of 100 Hz."""
    _, c = _rows(repository, name)
    t = c["timestamp"] - c["timestamp"][0]
    grid = np.arange(int(100.0 * t[-1])) / 100.0
    columns = {"q1_rad": "position", "q1_cmd_rad": "goal_position", "supply_v": "input_volts"}
    return Dataset(name, 100.0, grid, {to: np.interp(grid, t, c[of]) for to, of in columns.items()})


def by_legid(repository: str, more: str) -> tuple[list[str], float]:
    """Values with their intervals in volts, and the error [rad] of the free run of the last of TEST."""
    train, test = [dataset(repository, name) for name in OURS], dataset(repository, TEST[-1])
    found = fit_runs(train, parse_rig(RIG + more))
    result = found.result
    model = FittedModel(result.mechanism, result.hold, result.beta)
    one = smooth(model, driven(test, found.rig), FitOptions(sensors="encoder", noise={"encoder_rad": 0.002}))
    moved = free_run(one.problem, one.state, one.drive)
    error = np.inf if moved is None else float(np.sqrt(np.mean((moved.q[:, 0] - test["q1_rad"]) ** 2)))
    told = [f"{value:.3g} [{low:.3g}, {high:.3g}]" for value, (low, high) in zip(result.beta, result.ci95())]
    late = [f"{1e3 * one.value:.3g} ms" for one in result.loop if one.key == "delay_s"] or [f"{1e3 * LATE_S:g} ms"]
    return [*told[:3], *late], error


def section(repository: str) -> Iterator[str]:
    """Lines of the page."""
    train, test = runs(repository, TRAIN), runs(repository, TEST)
    yield from [
        f"Records of [kscalelabs/sysid](https://github.com/kscalelabs/sysid) at `{COMMIT}`, `{FOLDER}`: 0.535 kg on an "
        "arm of 0.1 m, kp 8 and 16, 100 Hz. Fitted to one each of `sin_sin`, `up_and_down` and `lift_and_drop` of both "
        "gains. Published values are the README's, id004. The held-out runs ask for up to 12 rad/s. This servo limits "
        "its speed, at 4.4 rad/s by its authors' later fits; no law here has that. legid has two runs each of "
        "`sin_sin` and `up_and_down`, kp 16. The delay that is stated is that of the fitted law.", "",
        "| law | held out, kp 8 | held out, kp 16 | fitted runs |", "| --- | ---: | ---: | ---: |"]
    best = {name: fitted(train, STS3215, count) for name, count in LAWS.items()}
    for name, p in best.items():
        yield row(f"fitted: {name}", p, train, test, STS3215)
    theirs = {m: [published(_shown(repository, f"{VALUES}/{m}.json"), sign) for sign in (1.0, -1.0)]
              for m in ("m1", "m2", "m6")}
    for name, both in theirs.items():
        p = min(both, key=lambda p: sum(rms(p, test, STS3215)))
        yield row(f"published {name}", p, train, test, STS3215)
    ours = {"delay stated": by_legid(repository, f"delay_s = {LATE_S}\n"), "delay sought": by_legid(repository, "")}
    for name, (_, error) in ours.items():
        yield f"| legid, mle: Coulomb and viscous, {name} | - | {1e3 * error:.3g} mrad | - |"
    yield from ["", "| in volts | inertia | first moment | viscous, back-EMF included | delay |",
                "| --- | --- | --- | --- | --- |"]
    for name, (values, _) in ours.items():
        yield f"| legid, {name} | {' | '.join(values)} |"
    for name, p in {"fitted m6, and delay": best["and delay"], "published m1": theirs["m1"][0],
                    "published m6": theirs["m6"][0]}.items():
        size = (STS3215.mass_kg * STS3215.arm_m**2 + p[2], STS3215.mass_kg * STS3215.arm_m, p[1] + p[5])
        yield f"| {name} | {' | '.join(f'{one / p[0]:.3g}' for one in size)} | {1e3 * p[15]:.3g} ms |"
