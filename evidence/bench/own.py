"""legid's own fit: time, memory, and its floor."""

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from daq import FloatArray
from daq.runs import write_csv
from estimator import FitResult, fit
from estimator.likelihood import slack_of
from estimator.likelihood.latent_problem import PIECE
from estimator.likelihood.memory import pieces
from estimator.model import Collocation, Motion
from evidence.bench.record import OPTIONS, Posed, Recorded, Watch, pose
from evidence.frame import new_folder
from tests.support.assembly_numpy import accelerometer_rows, motion_rows

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {lever}\n'


def best_of(action: Callable[[], object], times: int) -> float:
    """Least seconds of a few runs: what others do on the machine only ever adds."""
    def once() -> float:
        watch = Watch()
        action()
        return watch.seconds()

    return min(once() for _ in range(times))


def peak_memory_mb() -> float:
    """Of this process so far; Linux's own rusage also counts what was there before the process became Python."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return float(status.split("VmHWM:")[1].split()[0]) / 1024


def by_kernels(c: Collocation, motion: Motion, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Regressor and slopes as the fit has them."""
    return c.fast(*motion, beta)


def evaluate(posed: Posed) -> Callable[[], None]:
    """One evaluation of all residuals and their Jacobian, nothing made of them."""
    p, x, beta, noise = posed.problem, posed.end.x, posed.end.beta, posed.end.noise
    weight = 1.0 / (slack_of(p.mechanism) * noise.torque)

    def run() -> None:
        for intervals, left in pieces(p.left, PIECE):
            motion_rows(p.collocation, x, beta, weight, intervals, left, by=by_kernels)
        for start in range(0, p.total, PIECE):
            here = slice(start, min(start + PIECE, p.total))
            accelerometer_rows(p.collocation, x, beta, p.accel[0], here, by=by_kernels)

    return run


def solve(recorded: Recorded) -> dict[str, Any]:
    """Whole fit from measurements to intervals: a process's first, with its peak memory, then the best of several."""
    times = max(5, min(25, 60_000 // len(recorded.data.time_s)))

    def whole() -> FitResult:
        return fit([recorded.data], recorded.mechanism, OPTIONS)

    watch = Watch()
    result = whole()
    first = watch.seconds()
    memory = peak_memory_mb()
    seconds = best_of(whole, times)
    posed = pose(recorded)
    at = (posed.end.x, posed.end.beta, posed.end.noise)
    evaluation = best_of(evaluate(posed), times + 3)
    linearise = best_of(lambda: posed.problem.linearise(*at), times + 3)
    return {"seconds": seconds, "first_s": first, "typed_s": typed(recorded), "iterations": result.iterations,
            "beta": result.beta.tolist(), "memory_mb": memory, "evaluation_s": evaluation, "linearise_s": linearise}


def typed(recorded: Recorded) -> float:
    """Least seconds of `legid fit` as a command, from a CSV file, its children's processor seconds where fewer."""
    with new_folder() as folder:
        run, rig = folder / "run.csv", folder / "rig.toml"
        write_csv(recorded.data, run)
        rig.write_text(RIG.format(lever=recorded.mechanism.lever_arm))
        found, bytecode = np.inf, "PYTHONDONTWRITEBYTECODE"  # an installation keeps it, as that of the peers does
        kept = {name: value for name, value in os.environ.items() if name != bytecode}
        for _ in range(5):
            clock, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, "-m", "legid.cli", "fit", str(run), "--rig", str(rig)], check=True,
                           capture_output=True, env=kept)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            found = min(found, time.perf_counter() - clock, busy)
    return float(found)


def solve_free(recorded: Recorded) -> dict[str, Any]:
    """The paper's free latents, by legid's own derivatives: `--latent free`."""
    watch = Watch()
    result = fit([recorded.data], recorded.mechanism, replace(OPTIONS, latent="free"))
    return {"seconds": watch.seconds(), "iterations": result.iterations, "beta": result.beta.tolist()}
