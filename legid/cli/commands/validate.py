"""`legid validate`: free-run simulation of a model against runs."""

from __future__ import annotations

import argparse

import legid
from experiments.console import warn
from legid.cli.answer import answer, given_runs
from legid.cli.arguments import DAMAGED, FORCE, HORIZONS, HTML, MODEL, RIG, RUNS
from legid.cli.command import Command, argument, output

COMMAND = Command(
    "validate", "compare a model's free-run simulation with runs",
    "Simulate the model from each run's first state under its measured torque alone, and compare with what was "
    "measured. The model's smoother estimates that state; text and JSON (initial_state) have it. Use runs that the fit "
    "has not seen.", (
        MODEL, RUNS, RIG, DAMAGED,
        argument("--sensors", choices=("imu", "encoder"),
                 help="what the pivot's angle is compared with; default: imu where all runs have its columns"),
        argument("--against", metavar="MODEL.json",
                 help="another model, such as a published one, to compare the errors with"),
        argument("--simulator", choices=("legid", "mujoco"), default="legid",
                 help="what simulates: legid, or MuJoCo with what legid export --to mujoco writes"),
        HORIZONS,
        output("--json", "legid.validation/1", help="write the errors as JSON (schema legid.validation/1)"),
        HTML, FORCE))


def run(args: argparse.Namespace) -> int:
    """Simulate and compare."""
    from experiments.judge import Files

    runs, chosen = given_runs(args, args.runs)
    found = legid.validate(args.model, runs, chosen, args.sensors, args.against, args.horizons, args.simulator)
    for text in found.warnings:
        warn(text)
    files = Files(args.runs, chosen.file, args.model)
    return answer(args, found, found.text(files), files)
