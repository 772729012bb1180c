"""The whole loop on the emulated rig: excite, record, fit, validate, diagnose, extend, report."""

from __future__ import annotations

import time
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

from daq import InputError, Rig, WorkError, parse_rig
from daq.recording import write_plan
from daq.runs import read_run
from estimator import cores, worker_pool
from estimator.fitting import fit
from experiments.console import busy, make_directory, progress, stages, write_text
from experiments.emulation import DEFAULT, EFFECTS, NOTHING, REMARK, Hidden, LegBody, record_emulated, rig_with_drive
from experiments.excite import random_multisine
from experiments.judge import diagnosed_model
from experiments.session import prepare
from experiments.workflows.demo_files import write_results
from experiments.workflows.demo_result import Demo
from experiments.workflows.diagnose import diagnose_prepared
from experiments.workflows.fit import with_uses
from experiments.workflows.validate import model_of_fit, predict_setup, validate_model

RUNS, SECONDS = 8, 10.0
PEAK_NM = 0.7
HALL_CUTOFF_HZ = 2.0
"""Low pass of the benchmark: the Hall sensor's coarse steps, differenced twice, drown everything above."""
RIG_FILE = "demo_rig.toml"
WORKERS = 2


def run_demo(out: Path, seconds: float = SECONDS, seed: int = 1, effect: str = DEFAULT, runs: int = RUNS,
             drive: str = "legid") -> Demo:
    """Record `runs` runs of `seconds` [s] on a leg that hides `effect`, fit, diagnose; everything goes into `out`.

    `drive`: the kind that turns its knee.

    Files of an earlier demo in `out` are replaced. Raises `WorkError` when the fit does not converge or no diagnosis
    is possible.
    """
    started = time.monotonic()
    make_directory(out)
    rig_text = rig_with_drive((files(__package__) / RIG_FILE).read_text(encoding="utf-8"), drive)
    rig = parse_rig(rig_text, RIG_FILE)
    remove_earlier_runs(out)
    write_text(out / "rig.toml", rig_text)
    body = LegBody(gravity=rig.mechanism.gravity_mps2)
    hidden = EFFECTS.get(effect, NOTHING)
    prepared = prepare(record_runs(out, rig, rig_text, runs, seconds, seed, body, hidden), rig)
    setup = prepared.setup
    with stages("diagnosing") as show:
        diagnosis = diagnose_prepared(prepared, seed, progress=show)
    if diagnosis.verdict == "fit_failed":
        raise WorkError(diagnosis.sentence)
    confirm = set(diagnosis.runs["confirm"])
    training = replace(setup, datasets=tuple(d for d in setup.datasets if d.name not in confirm))
    held = replace(setup, datasets=tuple(d for d in setup.datasets if d.name in confirm))
    with busy("fitting"):
        result = with_uses(training, fit(training.datasets, setup.mechanism, setup.options))
        hall = replace(setup.options, sensors="encoder", cutoff_hz=HALL_CUTOFF_HZ)
        seen = all("q1_rad" in d for d in training.datasets)  # a drive reads no hip
        benchmark = fit(training.datasets, setup.mechanism, hall, "wls") if seen else None
        model = diagnosed_model(diagnosis, setup, rig.motor.gear_ratio)
    before = predict_setup([model_of_fit(result)], held)
    after = validate_model(model, held, "the extended model").table if model.effects else before
    truth = dict(zip(setup.mechanism.names, body.beta()))
    written = {"rig": out / "rig.toml", "runs": out / "demo-run*.mcap"}
    demo = Demo(hidden, training, result, diagnosis, model, replace(prepared, setup=held), before, after, truth,
                written, 0.0)
    written |= write_results(out, demo, benchmark)
    if not result.converged:
        raise WorkError(f"the fit did not converge; see {written['fit report']}")
    return replace(demo, wall_s=time.monotonic() - started)


def remove_earlier_runs(out: Path) -> None:
    """Runs of an earlier demo. Raises `InputError` for one that does not say of itself that it is emulated."""
    earlier = sorted(out.glob("demo-run*.mcap"))
    for path in earlier:
        if not any(note.kind == "remark" and note.text == REMARK for note in read_run(path).events):
            raise InputError(str(path), "is not of an earlier demo, and a run is never overwritten",
                             "give another folder with --out")
    for path in earlier:
        path.unlink()


def record_runs(out: Path, rig: Rig, rig_text: str, runs: int, seconds: float, seed: int, body: LegBody,
                hidden: Hidden) -> list[Path]:
    """All runs, on as many cores as there are, up to `WORKERS`. Returns the run files in order."""
    jobs = [(out, rig, rig_text, k, seconds, seed, body, hidden.effect) for k in range(runs)]
    try:
        with worker_pool(min(WORKERS, cores())) as pool:
            waiting = [pool.submit(record_demo_run, *job) for job in jobs]
            for done in progress(as_completed(waiting), "recording", len(jobs), "run"):
                done.result()
    except BrokenProcessPool:
        raise WorkError("a process that recorded was killed (out of memory?); run it again") from None
    return [job.result() for job in waiting]


def record_demo_run(out: Path, rig: Rig, rig_text: str, number: int, seconds: float, seed: int, body: LegBody,
                    effect: str) -> Path:
    """Run number `number` (from 0), with random phases of its own. Returns the run file."""
    path = out / f"demo-run{number + 1}.mcap"
    plan = random_multisine(1000 * seed + number, seconds, PEAK_NM)
    write_plan(plan, out / f"demo-plan{number + 1}.csv")
    record_emulated(path, rig, rig_text, plan, 1000 * seed + number, body, EFFECTS.get(effect, NOTHING))
    return path
