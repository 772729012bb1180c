"""`legid validate`: free-run simulation of a model against runs."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_horizons, add_output, add_rig, chosen_rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "validate", help="compare a model's free-run simulation with runs",
        description="Simulate the model from each run's first state under its measured torque alone, and compare "
                    "with what was measured. The model's smoother estimates that state; text and JSON "
                    "(initial_state) have it. Use runs that the fit has not seen.")
    parser.add_argument("model", metavar="MODEL.json", help="a model written by legid fit --model-out")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    add_rig(parser)
    parser.add_argument("--sensors", choices=("imu", "encoder"),
                        help="what the pivot's angle is compared with; default: imu where all runs have its columns")
    parser.add_argument("--against", metavar="MODEL.json",
                        help="another model, such as a published one, to compare the errors with")
    parser.add_argument("--simulator", choices=("legid", "mujoco"), default="legid",
                        help="what simulates: legid, or MuJoCo with what legid export --to mujoco writes")
    add_horizons(parser)
    add_output(parser, "--json", "legid.validation/1", help="write the errors as JSON (schema legid.validation/1)")
    add_output(parser, "--html", "page", help="write a report page")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, compare, print, write what was asked for."""
    from experiments.console import command_line, warn
    from experiments.provenance import origin_of
    from legid import load, validate

    rig = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, rig.source, args.model, command=command_line())
    runs = load(args.runs, rig.rig, args.damaged)
    found = validate(args.model, runs, rig.rig, args.sensors, args.against, args.horizons, args.simulator)
    for text in found.warnings:
        warn(text)
    print(found.text())
    found.provenance = origin
    if args.json:
        found.to_json(args.json)
    if args.html:
        found.page(args.html)
    return 0
