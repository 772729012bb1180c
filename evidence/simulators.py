"""`make simulators`: do exported models move in MuJoCo as legid says, err alike on real records, and how fast?"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
from msgspec import structs

from evidence.frame import Lines, heard, new_folder, program, table
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.models import Model, load_model, save_model
from experiments.simulators import ExportedLeg, draw_models, write_samples
from legid.cli import main as legid
from tests.support.exported_models import EFFECTS, OPPOSITE, PAIRS, angle_error, model_of
from tests.support.paths import REAL

STEPS_S = (1e-3, 2.5e-4)
BROAD_RADPS = 0.1
BATCH = 256


class Record(NamedTuple):
    """Real runs to fit, one that is held out, and the rig."""

    fitted: tuple[str, ...]
    held: str
    rig: str = "rig.toml"


RECORDS = {"dfki_c0": Record(("00", "01", "04"), "02"), "dfki_a0": Record(("00", "01", "12"), "03"),
           "emps": Record(("estimation",), "estimation")}
"""Folder of the shared records; the last holds one run, which is fitted and simulated."""


@kept
def errors(names: Sequence[str], opposite: bool, smoothing: float, legs: int) -> list[float]:
    """Largest difference of an angle over 5 s at each step [rad], the worst of so many legs."""
    with new_folder() as folder:
        models = [model_of(folder, seed, names, OPPOSITE if opposite else EFFECTS, smoothing)
                  for seed in range(1, legs + 1)]
        return [max(angle_error(model, step) for model in models) for step in STEPS_S]


@kept
def record_errors(name: str) -> dict[str, tuple[float, float]]:
    """Channel -> rms error of legid's free runs and of the exported model's, over the held-out run."""
    record, folder = RECORDS[name], REAL / name
    rig = ["--rig", str(folder / record.rig)]
    with new_folder() as place, heard() as said:
        model = str(place / "m.json")
        runs = [str(folder / f"{run}.csv.gz") for run in record.fitted]
        if legid(["fit", *runs, *rig, "--model-out", model]):
            return {}
        if legid(["validate", model, str(folder / f"{record.held}.csv.gz"), *rig, "--simulator", "mujoco"]):
            return {}
    found = {}
    for line in said.getvalue().splitlines():
        if " against " in line and line.startswith("  q"):
            channel, rest = line.strip().split(": ")
            other, own = rest.split(" rms")[0].split(" against ")
            found[channel] = (float(own), float(other))
    return found


def speed(names: Sequence[str]) -> tuple[float, float]:
    """Times real time of one leg in steps of 1 ms, by module and by mj_step alone; seconds of the processor."""
    with new_folder() as folder:
        one = ExportedLeg(model_of(folder, 1, names), "m.json").leg
    one.set_step(1e-3)
    spent = []
    steps: tuple[Callable[[], object], ...] = (lambda: one.step((0.3,)), lambda: mujoco.mj_step(one.model, one.data))
    for step in steps:
        began = time.process_time()
        for _ in range(20_000):
            step()
        spent.append(time.process_time() - began)
    return 20.0 / spent[0], 20.0 / spent[1]


def batch() -> str:
    """What batch.py prints of 256 models."""
    with new_folder() as folder:
        model = _with_uncertainty(model_of(folder, 1, ("joint_stiffness", "torque_ripple")))
        write_samples(draw_models(model, "m.json", BATCH, 1), "m.json", folder, "legid export")
        save_model(model, folder / "m.json")
        assert load_model(folder / "m.json").effects
        done = subprocess.run([sys.executable, "-I", str(folder / "batch.py")], capture_output=True, text=True,
                              check=True)
        return done.stdout.splitlines()[0]


def _with_uncertainty(model: Model) -> Model:
    values = [*model.beta, *(v for e in model.effects for v in (*e.sizes.values(), *e.shapes.values()))]
    rows = tuple(tuple((0.02 * v) ** 2 if i == k and k < len(values) - 1 else 0.0 for i in range(len(values)))
                 for k, v in enumerate(values))
    return structs.replace(model, covariance=rows)


def page(legs: int = 3) -> Lines:
    yield from [
        "# Exported models in MuJoCo",
        f"MuJoCo {mujoco.__version__}, {legs} random legs (seeds 1 to {legs}), 5 s, from the same state and under the "
        "same measured torque. The table has the largest difference of an angle's reading between `legid simulate` and "
        "the folder of `legid export --to mujoco`. "
        "Target: below 1 mrad at both steps. The torque is such that no leg's motion is chaotic.",
        "![Knee of an emulated leg with a hidden spring: measured, plain MJCF, exported model](../mujoco.svg)",
        "*The knee of `legid demo` on a held-out run. MuJoCo simulates the nominal model as plain MJCF, and the "
        "extended model as exported.*"]
    cases: list[tuple[tuple[str, ...], bool, float]] = [((), False, 0.005), ((), False, BROAD_RADPS)]
    cases += [((name,), False, 0.005) for name in EFFECTS] + [(pair, False, 0.005) for pair in PAIRS]
    cases += [((name,), True, 0.005) for name in OPPOSITE] + [(tuple(OPPOSITE), True, 0.005)]
    worst, rows = 0.0, []
    for names, opposite, smoothing in cases:
        found = errors(names, opposite, smoothing, legs)
        worst = max(worst, *found)
        told = " and ".join(names) or "none" + (f", smoothing velocity {smoothing:g} rad/s" if smoothing > 0.01 else "")
        told += ", the other sign" if opposite else ""
        rows.append(f"{told} | {1e3 * found[0]:.2f} | {1e3 * found[1]:.2f}")
    yield table("effects | 1 ms [mrad] | 0.25 ms [mrad]", rows)
    yield from [f"Largest of all: {1e3 * worst:.2f} mrad.", "## Real records",
                "A model is fitted, exported and run over a whole run, from legid's first states, under the measured "
                "torque. Target: within 2 %."]
    yield table("record | channel | legid | MuJoCo | difference", (
        f"{name} | {channel} | {own:.4g} | {other:.4g} | {100 * (other / own - 1):+.2f} %" for name in RECORDS
        for channel, (own, other) in (record_errors(name) if REAL.is_dir() else {}).items()))
    yield from ["## Speed", "Steps of 1 ms, of one process. Target: 50 times real time."]
    yield table("effects | leg.py, times real time | leg.xml alone", (
        "{} | {:.0f} | {:.0f}".format(" and ".join(names) or "none", *speed(names))
        for names in ((), ("load_dependent_friction",), ("stribeck_friction", "torque_saturation"))))
    yield from [f"`mujoco.rollout`: {batch()}. Target: 1e5 on two processors.",
                f"Load of the machine meanwhile: {os.getloadavg()[0]:.0f} processes on {os.cpu_count()} processors.",
                "MJX is compared with MuJoCo by tests/experiments/simulators/test_mjx.py, where it is installed."]


EVIDENCE = Evidence(
    "Exported models in MuJoCo against `legid simulate`: each effect, ten pairs", "make simulators",
    "simulators.md", 8, "below 1 mrad in 5 s", (r"Largest of all: [\d.]+ mrad",))
main = program(page)
