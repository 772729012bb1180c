"""legid's own fit: time, memory, and its floor."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from estimator.fitting.fit import fit
from estimator.likelihood.assembly_numpy import accelerometer_rows, motion_rows
from estimator.likelihood.trajectory_likelihood import PIECE, TIGHT
from estimator.numerics import jit
from tests.bench.record import OPTIONS, Posed, Recorded, Watch, pose


def best_of(action: Callable[[], object], times: int) -> float:
    """Least seconds of a few runs: what others do on the machine only ever adds."""
    found = np.inf
    for _ in range(times):
        watch = Watch()
        action()
        found = min(found, watch.seconds())
    return float(found)


def peak_memory_mb() -> float:
    """Of this process so far; Linux's own rusage also counts what was there before the process became Python."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return float(status.split("VmHWM:")[1].split()[0]) / 1024


def evaluate(posed: Posed) -> Callable[[], None]:
    """One evaluation of all residuals and their Jacobian, nothing made of them."""
    p, x, beta, noise = posed.problem, posed.end.x, posed.end.beta, posed.end.noise
    weight = 1.0 / (TIGHT * noise.torque)

    def run() -> None:
        for intervals, left in p._pieces(p.left):
            motion_rows(p.collocation, x, beta, weight, intervals, left)
        for start in range(0, p.total, PIECE):
            here = slice(start, min(start + PIECE, p.total))
            accelerometer_rows(p.collocation, x, beta, p.accel, here)

    return run


def solve(recorded: Recorded) -> dict:
    """Whole fit from measurements to intervals: a process's first, with its peak memory, then the best of several."""
    times = max(5, min(25, 60_000 // len(recorded.data.time_s)))

    def whole() -> object:
        return fit([recorded.data], recorded.mechanism, OPTIONS)

    watch = Watch()
    result = fit([recorded.data], recorded.mechanism, OPTIONS)
    first = watch.seconds()
    memory = peak_memory_mb()
    with kernels(False):
        plain = best_of(whole, times)
    with kernels(True):
        load = Watch()
        whole()  # fetches them
        loaded = load.seconds()
        fast = best_of(whole, times)
        posed = pose(recorded)
        at = (posed.end.x, posed.end.beta, posed.end.noise)
        evaluation = best_of(evaluate(posed), times + 3)
        linearise = best_of(lambda: posed.problem.linearise(*at), times + 3)
    return {"seconds": fast if jit.at_hand() else plain, "plain_s": plain, "first_s": first,
            "load_s": loaded - fast if jit.at_hand() else None, "iterations": result.iterations,
            "beta": result.beta.tolist(), "memory_mb": memory, "evaluation_s": evaluation,
            "linearise_s": linearise}


@contextlib.contextmanager
def kernels(wanted: bool) -> Iterator[None]:
    """With compiled kernels from the first step on, or without them; where they are not at hand always without."""
    worth = jit.LOAD_WORTH
    jit.LOAD_WORTH = -1 if wanted else 10**15
    try:
        yield
    finally:
        jit.LOAD_WORTH = worth


def solve_free(recorded: Recorded) -> dict:
    """The paper's free latents, by legid's own derivatives: `--latent free`."""
    from dataclasses import replace

    options = replace(OPTIONS, latent="free")
    watch = Watch()
    result = fit([recorded.data], recorded.mechanism, options)
    return {"seconds": watch.seconds(), "iterations": result.iterations, "beta": result.beta.tolist()}
