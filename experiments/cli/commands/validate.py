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
    import numpy as np

    from daq import InputError
    from estimator.prediction import HORIZONS_S
    from experiments.console import command_line, warn, write_json
    from experiments.models import load_model
    from experiments.provenance import origin_of
    from experiments.reports import (
        horizons_text,
        validation_text,
        walk_text,
        with_origin,
    )
    from experiments.session import prepare
    from experiments.workflows import seen_in_fit, validate_prepared

    model = load_model(args.model)
    against = load_model(args.against) if args.against else None
    rig = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, rig.source, args.model, command=command_line())
    prepared = prepare(args.runs, rig.rig, sensors=args.sensors, beta=np.array(model.beta), damaged=args.damaged)
    setup = prepared.setup
    if against is not None and against.mechanism.model != model.mechanism.model:
        raise InputError(args.against, f"is a {against.mechanism.model}, not a {model.mechanism.model}",
                         "give a model of the same mechanism")
    for text in prepared.warnings:
        warn(text)
    seen = seen_in_fit(model, origin.runs)
    if seen:
        warn(f"{args.model} was fitted to {', '.join(seen)}, which therefore do not validate it; give other runs")
    found = validate_prepared(model, prepared, args.model, origin.runs, against, args.horizons or HORIZONS_S, True)
    if args.simulator == "mujoco":
        from experiments.workflows import compared_text, validate_in_mujoco

        own, found = found, validate_in_mujoco(model, found, args.model)
        print(compared_text(own, found) + "\n")
    table, steps, trust = found.table, found.steps, found.trust
    print("\n".join([trust.sentence, *trust.reasons, "", validation_text(table), horizons_text(table)]))
    if steps is not None:
        print(walk_text(steps))
    if args.json:
        told = {"simulator": args.simulator} if args.simulator != "legid" else {}
        write_json(args.json, with_origin(found.document | told, origin, setup.datasets))
    if args.html:
        from experiments.workflows import write_validation

        write_validation(args.html, found, model, args.model, origin)
    return 0
