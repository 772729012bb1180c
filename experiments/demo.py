"""The whole loop on the emulated rig: excite, record, identify, validate, report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from daq.errors import WorkError
from daq.plan import write_plan
from daq.rig import Rig, parse_rig
from estimator.fit import fit
from estimator.result import FitResult
from estimator.validation import Validation
from experiments.emulated_rig import record_emulated
from experiments.excitation import random_multisine
from experiments.figures import standalone
from experiments.fit_json import fit_document, model_of
from experiments.fit_report import fit_sections, fit_summary, truth_section
from experiments.model_file import save_model
from experiments.output import busy, make_directory, progress_to, write_json, write_text
from experiments.plant import LegBody
from experiments.report import write_page
from experiments.rigs import Setup, load_setup
from experiments.validation import validate_setup
from experiments.validation_report import validation_document, validation_picture, validation_section

RUNS = 3
PEAK_NM = 0.7
HALL_CUTOFF_HZ = 2.0
"""Low pass of the benchmark: the Hall sensor's coarse steps, differenced twice, drown everything above."""
RIG_FILE = "demo_rig.toml"


@dataclass(frozen=True)
class Demo:
    """What the demo found and where it put it."""

    setup: Setup
    result: FitResult
    validations: Sequence[Validation]
    truth: dict[str, float]
    files: dict[str, Path]
    """What -> path, in the order in which they were written."""
    wall_s: float

    def inside(self) -> int:
        """How many parameters lie inside their 95 % interval of the truth."""
        return sum(low <= self.truth[p.name] <= high
                   for p, (low, high) in zip(self.result.mechanism.parameters, self.result.ci95()))


def run_demo(out: Path, seconds: float = 20.0, seed: int = 1, body: LegBody | None = None) -> Demo:
    """Record `RUNS` runs of `seconds` [s], fit all but the last, validate on the last; everything goes into `out`.

    Files of an earlier demo in `out` are replaced. Raises `WorkError` when the fit does not converge.
    """
    started = time.monotonic()
    make_directory(out)
    rig_text = (files("experiments") / RIG_FILE).read_text(encoding="utf-8")
    rig = parse_rig(rig_text, RIG_FILE)
    written = {"rig": out / "rig.toml"}
    write_text(written["rig"], rig_text)
    body = body or LegBody(gravity=rig.mechanism.gravity_mps2)
    runs = [record_demo_run(out, rig, rig_text, k, seconds, seed, body) for k in range(RUNS)]
    written["runs to fit"] = out / "demo-run*.mcap"
    setup = load_setup(runs, rig)
    training = replace(setup, datasets=setup.datasets[:-1])
    with busy("fitting"):
        result = fit(training.datasets, setup.mechanism, setup.options)
        hall = replace(setup.options, sensors="encoder", cutoff_hz=HALL_CUTOFF_HZ)
        benchmark = fit(training.datasets, setup.mechanism, hall, "wls")
    validations = validate_setup(replace(setup, datasets=setup.datasets[-1:]), result.beta)
    truth = dict(zip(setup.mechanism.names, body.beta()))
    written |= _write_results(out, training, result, benchmark, validations, truth)
    if not result.converged:
        raise WorkError(f"the fit did not converge; see {written['report']}")
    return Demo(setup, result, validations, truth, written, time.monotonic() - started)


def record_demo_run(out: Path, rig: Rig, rig_text: str, number: int, seconds: float, seed: int,
                    body: LegBody) -> Path:
    """Run number `number` (from 0), with random phases of its own. Returns the run file."""
    path = out / f"demo-run{number + 1}.mcap"
    path.unlink(missing_ok=True)
    plan = random_multisine(1000 * seed + number, seconds, PEAK_NM)
    write_plan(plan, out / f"demo-plan{number + 1}.csv")
    with progress_to(f"recording run {number + 1} of {RUNS}") as show:
        record_emulated(path, rig, rig_text, plan, 1000 * seed + number, body, progress=show)
    return path


def _write_results(out: Path, setup: Setup, result: FitResult, benchmark: FitResult,
                   validations: Sequence[Validation], truth: dict[str, float]) -> dict[str, Path]:
    written = {"model": out / "model.json", "fit": out / "fit.json", "validation": out / "validation.json",
               "report": out / "report.html"}
    save_model(model_of(result, setup.settings, setup.options.hold, [d.name for d in setup.datasets]),
               written["model"])
    write_json(written["fit"], fit_document(result, setup.settings))
    write_json(written["validation"], validation_document(validations, setup.options.sensors))
    sections = fit_sections(result, benchmark)
    sections[1:1] = [truth_section(result, truth)]
    sections[-2:-2] = [validation_section(validations)]
    written["picture"] = out / "picture.svg"
    write_text(written["picture"], standalone(validation_picture(validations[0])))
    write_page(written["report"], "The emulated leg: what the demo found",
               fit_summary(result, setup.settings.model), sections)
    return written
